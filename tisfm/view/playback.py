"""Playing a sequence: which frame is due at a time."""

import time


class Playback:
    """Steps through frames at a rate; frames that there is no time for are skipped."""

    def __init__(self) -> None:
        self._begin: tuple[float, int] | None = None  # time, s, and number of the first frame

    @property
    def is_on(self) -> bool:
        """Whether frames advance."""
        return self._begin is not None

    def toggle(self, number: int) -> None:
        """Begin at a frame, or stop."""
        self._begin = None if self.is_on else (time.monotonic(), number)

    def restart(self, number: int) -> None:
        """Go on from another frame, if playing."""
        if self.is_on:
            self._begin = time.monotonic(), number

    def due(self, frames_per_second: float, count: int) -> int | None:
        """Return the number of the frame that is due, of `count` in a loop; None if stopped."""
        if self._begin is None:
            return None
        begin, number = self._begin
        return (number + int((time.monotonic() - begin) * frames_per_second)) % count
