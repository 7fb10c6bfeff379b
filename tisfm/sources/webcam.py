"""A webcam as a source of frames without end."""

import re
import time
from collections.abc import Iterator
from pathlib import Path

import cv2

from tisfm.formats.images import silence_opencv
from tisfm.sources.frame_reader import RawFrame, is_selected

_WEBCAM = re.compile(r"webcam(?::(\d+))?", re.IGNORECASE)
# Set by hand.
# Time until a frame arrives, over the frame interval: sooner frames were in the driver's queue.
_MIN_WAIT_RATIO = 0.25
_DEFAULT_RATE = 30.0  # frames/s, if the driver states no rate
_MAX_QUEUED_FRAMES = 16  # frames that a driver may queue


def webcam_number(source: str) -> int | None:
    """Return the camera number in ``"webcam"`` (0) or ``"webcam:1"``; None for other strings."""
    match = _WEBCAM.fullmatch(source)
    return None if match is None else int(match.group(1) or 0)


class Webcam:
    """A camera. Each frame is taken at the moment when the consumer needs it.

    Frames that the driver queued before this moment are dropped and get no number.

    Raises OSError if the camera cannot be opened.
    """

    files: tuple[Path, ...] = ()
    names: tuple[str, ...] | None = None
    prefix = "webcam"
    count: int | None = None
    stated_count: int | None = None
    times: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    can_read_ahead = False  # frames that are read ahead are too old when they are used

    def __init__(
        self,
        number: int,  # number of the camera, from 0
    ) -> None:
        self.title, self._number = f"webcam:{number}", number
        self._open().release()

    def read(self, selection: slice) -> Iterator[RawFrame]:
        """Take frames until `selection.stop`, or without end if it is None."""
        capture = self._open()
        rate = capture.get(cv2.CAP_PROP_FPS)
        min_wait = _MIN_WAIT_RATIO / (rate if rate > 0 else _DEFAULT_RATE)
        index, first_time = 0, None
        try:
            while index != selection.stop:
                self._grab(capture, min_wait)
                now = time.monotonic()
                first_time = now if first_time is None else first_time
                if is_selected(index, selection):
                    is_read, frame = capture.retrieve()
                    if not is_read:
                        raise self._end_error()
                    yield RawFrame(
                        index=index,
                        name=f"{self.prefix}_{index:06d}",
                        image=cv2.cvtColor(frame, cv2.COLOR_BGR2RGB),
                        time=now - first_time,
                    )
                    del frame
                index += 1
        finally:
            capture.release()

    def _grab(self, capture: cv2.VideoCapture, min_wait: float) -> None:
        """Drop queued frames: grab frames until one arrives after `min_wait` seconds or more."""
        for _ in range(_MAX_QUEUED_FRAMES):
            begin = time.monotonic()
            if not capture.grab():
                raise self._end_error()
            if time.monotonic() - begin >= min_wait:
                return

    def _end_error(self) -> OSError:
        return OSError(f"{self.title} gives no more frames: check that it is still plugged in")

    def _open(self) -> cv2.VideoCapture:
        with silence_opencv():
            capture = cv2.VideoCapture(self._number)
            if capture.isOpened():
                return capture
        raise OSError(
            f"there is no {self.title} that can be opened: check that it is plugged in and that no "
            "other program uses it"
        )
