"""A camera at the computer, as a source without end."""

import re
import time
from collections.abc import Iterator
from pathlib import Path

import cv2

from tisfm.formats.images import opencv_silenced
from tisfm.sources.frame_reader import RawFrame, is_chosen

_WEBCAM = re.compile(r"webcam(?::(\d+))?", re.IGNORECASE)
_WAITED = 0.25  # of the time between two frames: what comes sooner had been waiting
_USUAL_RATE = 30.0  # frames/s, where the driver does not say
_MOST_WAITING = 16  # frames that a driver keeps


def webcam_number(source: str) -> int | None:
    """Return the number of the camera that ``"webcam"`` or ``"webcam:1"`` names, or None."""
    match = _WEBCAM.fullmatch(source)
    return None if match is None else int(match.group(1) or 0)


class Webcam:
    """A camera, read as fast as its frames are asked for.

    Frames that came while nobody asked are dropped and not counted: the next one is always new.

    Parameters
    ----------
    number : int
        Which camera, from 0.

    Raises
    ------
    OSError
        If it cannot be opened.
    """

    files: tuple[Path, ...] = ()
    names: tuple[str, ...] | None = None
    prefix = "webcam"
    count: int | None = None
    announced: int | None = None
    times: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    ahead = False  # what is read ahead would be old when it is used

    def __init__(self, number: int) -> None:
        self.title, self._number = f"webcam:{number}", number
        self._open().release()

    def read(self, chosen: slice) -> Iterator[RawFrame]:
        """Take frames until `chosen.stop`, or for ever."""
        capture = self._open()
        rate = capture.get(cv2.CAP_PROP_FPS)
        fresh = _WAITED / (rate if rate > 0 else _USUAL_RATE)
        index, first = 0, None
        try:
            while index != chosen.stop:
                self._grab(capture, fresh)
                now = time.monotonic()
                first = now if first is None else first
                if is_chosen(index, chosen):
                    read, frame = capture.retrieve()
                    if not read:
                        raise self._ended()
                    yield RawFrame(
                        index=index,
                        name=f"{self.prefix}_{index:06d}",
                        image=cv2.cvtColor(frame, cv2.COLOR_BGR2RGB),
                        time=now - first,
                    )
                    del frame
                index += 1
        finally:
            capture.release()

    def _grab(self, capture: cv2.VideoCapture, fresh: float) -> None:
        """Take a frame that it took at least `fresh` seconds to wait for."""
        for _ in range(_MOST_WAITING):
            begin = time.monotonic()
            if not capture.grab():
                raise self._ended()
            if time.monotonic() - begin >= fresh:
                return

    def _ended(self) -> OSError:
        return OSError(f"{self.title} gives no more frames: check that it is still plugged in")

    def _open(self) -> cv2.VideoCapture:
        with opencv_silenced():
            capture = cv2.VideoCapture(self._number)
            if capture.isOpened():
                return capture
        raise OSError(
            f"there is no {self.title} that can be opened: check that it is plugged in, and used "
            "by no other program"
        )
