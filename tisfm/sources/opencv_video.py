"""Videos that OpenCV decodes."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2

from tisfm.formats.reading import opencv_memory
from tisfm.sources.containers import video_streams
from tisfm.sources.cut_off import cut_off, ends_early, misses_frames
from tisfm.sources.frame_size import refuse_large_frames
from tisfm.sources.reading import BadFrame, RawFrame, is_chosen
from tisfm.sources.square_pixels import resampling_note, square_size, with_square_pixels


class OpenCvVideo:
    """A video that OpenCV decodes.

    Of several video streams OpenCV reads the first. Frames get square pixels.

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
    times: tuple[float, ...] | None = None
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
            self._aspect = _aspect(capture)
            refuse_large_frames(path, *square_size(width, height, self._aspect))
            readable = capture.isOpened() and capture.grab()
            announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if readable else 0
            rate = capture.get(cv2.CAP_PROP_FPS) if readable else 0
        finally:
            capture.release()
        if not readable:
            raise ValueError(
                f"{path} is not an image or a video that OpenCV can read: it is damaged or of an "
                "unknown format; copy or record it again, or convert it to MP4 with H.264"
            )
        notes = (_streams_note(path), resampling_note(path, width, height, self._aspect))
        self.notes = tuple(filter(None, notes))
        self.announced: int | None = announced if announced > 0 else None
        self._end = announced / rate if announced > 0 and rate > 0 else None

    def read(self, chosen: slice) -> Iterator[RawFrame | BadFrame]:
        """Decode the frames of these numbers."""
        capture = cv2.VideoCapture(self.title)
        index, time = 0, None
        try:
            while index != chosen.stop and self._call(capture.grab):
                time = _finite(self._call(capture.get, cv2.CAP_PROP_POS_MSEC) / 1000)
                if is_chosen(index, chosen):
                    read, frame = self._call(capture.retrieve)
                    if not read:
                        break
                    image = cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
                    yield RawFrame(
                        index=index,
                        name=f"{self.prefix}_{index:06d}",
                        image=with_square_pixels(image, self._aspect),
                        time=time,
                    )
                    del frame, image  # to free it before the next one is decoded
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


def _aspect(capture: cv2.VideoCapture) -> float:
    """Return the width of a pixel over its height, of frames as they are read, upright."""
    across, down = capture.get(cv2.CAP_PROP_SAR_NUM), capture.get(cv2.CAP_PROP_SAR_DEN)
    if not (across > 0 and down > 0):
        return 1.0
    is_turned = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 180 == 90
    return float(down / across if is_turned else across / down)


def _streams_note(path: str) -> str:
    """Return a note that only the first video stream is read, "" if no more are known."""
    count = video_streams(path) or 1
    if count < 2:
        return ""
    return (
        f"{path} has {count} video streams, and OpenCV reads the first; `pip install "
        "'tisfm[video]'` installs PyAV, with which the one marked as default or the largest is read"
    )


def _finite(time: float) -> float | None:
    return time if math.isfinite(time) else None
