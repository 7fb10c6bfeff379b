"""Videos that OpenCV decodes."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2

from tisfm.formats.reading import opencv_memory
from tisfm.sources.cut_off import cut_off, ends_early, misses_frames
from tisfm.sources.frame_size import refuse_large_frames
from tisfm.sources.reading import BadFrame, RawFrame, is_chosen


class OpenCvVideo:
    """A video that OpenCV decodes.

    Parameters
    ----------
    path : str
        Its file.

    Raises
    ------
    ValueError
        If OpenCV cannot decode it, or its frames are larger than `LARGEST_FRAME`.
    """

    names: tuple[str, ...] | None = None
    count: int | None = None  # only reading tells: a video may announce a frame or two too many
    ahead = True

    def __init__(self, path: str) -> None:
        self.title, self.prefix = path, Path(path).stem
        self.files: tuple[Path, ...] = (Path(path),)
        capture = cv2.VideoCapture(path)
        try:
            width, height = (
                int(capture.get(side))
                for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
            )
            refuse_large_frames(path, width, height)
            readable = capture.isOpened() and capture.grab()
            announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if readable else 0
            rate = capture.get(cv2.CAP_PROP_FPS) if readable else 0
        finally:
            capture.release()
        if not readable:
            raise ValueError(
                f"{path} is not an image or a video that OpenCV can read: it is damaged or of an "
                "unknown format; convert it, for instance to MP4"
            )
        self.announced: int | None = announced if announced > 0 else None
        self._end = announced / rate if announced > 0 and rate > 0 else None

    def read(self, chosen: slice) -> Iterator[RawFrame | BadFrame]:
        """Decode the frames of these numbers."""
        capture = cv2.VideoCapture(self.title)
        index, time = 0, None
        try:
            while index != chosen.stop and self._call(capture.grab):
                time = self._call(capture.get, cv2.CAP_PROP_POS_MSEC) / 1000
                if is_chosen(index, chosen):
                    read, frame = self._call(capture.retrieve)
                    if not read:
                        break
                    yield RawFrame(
                        index=index,
                        name=f"{self.prefix}_{index:06d}",
                        image=cv2.cvtColor(frame, cv2.COLOR_BGR2RGB),
                        time=time,
                    )
                    del frame  # or it would be held while the next one is decoded
                index += 1
        finally:
            capture.release()
        # The count is a guess from the duration where the file does not state it: both must say so.
        early = ends_early(index, time, self._end) is not False
        if index != chosen.stop and misses_frames(index, self.announced) and early:
            raise cut_off(self.title, f"{index}", f"{self.announced} frames")

    def _call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what OpenCV reads of the file."""
        with opencv_memory(self.title):
            return function(*arguments)
