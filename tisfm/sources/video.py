"""Videos: decoded by PyAV if it is installed, else by OpenCV.

Both use FFmpeg, apply the rotation stated in the file, resample frames to square pixels, and give
the same pixels and, within a millisecond, the same times. PyAV also marks damaged frames, and
continues after a frame that cannot be decoded. OpenCV does not mark damaged frames, and stops at a
frame that it cannot decode. Of several video streams PyAV reads the one marked as default, or else
the largest; OpenCV reads the first.
"""

import math
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cv2

from tisfm.errors import InputError
from tisfm.formats import FormatError
from tisfm.formats.reading import open_file, opencv_memory_errors
from tisfm.sources.frame_reader import BadFrame, FrameReader, RawFrame, is_selected
from tisfm.sources.video_checks import (
    cut_off_error,
    ends_early,
    lacks_frames,
    refuse_large_frames,
    resample_to_square_pixels,
    resampling_note,
    square_size,
)
from tisfm.sources.video_containers import video_streams, why_without_frames

# First bytes of playlists: HLS, FFmpeg's, XML such as DASH, and ID3 tags before HLS. Playlists only
# name other files or URLs, which FFmpeg would open, wherever they are.
_PLAYLIST_SIGNATURES = (b"#EXTM3U", b"ffconcat", b"<?xml", b"<MPD", b"ID3")
MIN_AV_VERSION = 17  # major version of PyAV; older versions give other pixels than OpenCV


class OpenCvVideo:
    """A video that OpenCV decodes.

    Of several video streams OpenCV reads the first. Frames are resampled to square pixels.

    Raises ValueError if OpenCV cannot decode it, or its frames are larger than `MAX_FRAME_PIXELS`.
    """

    names: tuple[str, ...] | None = None
    count: int | None = None  # only reading tells: a video may state a frame or two too many
    times: tuple[float, ...] | None = None
    ahead = True

    def __init__(
        self,
        path: str,  # path of the file
    ) -> None:
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
            raise InputError(
                f"{path} is not an image or a video that OpenCV can read: it is damaged or of an "
                "unknown format; copy or record it again, or convert it to MP4 with H.264"
            )
        notes = (_streams_note(path), resampling_note(path, width, height, self._aspect))
        self.notes = tuple(filter(None, notes))
        self.announced: int | None = announced if announced > 0 else None
        self._end = announced / rate if announced > 0 and rate > 0 else None

    def read(self, chosen: slice) -> Iterator[RawFrame | BadFrame]:
        """Decode the frames with these numbers."""
        capture = cv2.VideoCapture(self.title)
        index, time = 0, None
        try:
            while index != chosen.stop and self._call(capture.grab):
                time = _finite(self._call(capture.get, cv2.CAP_PROP_POS_MSEC) / 1000)
                if is_selected(index, chosen):
                    read, frame = self._call(capture.retrieve)
                    if not read:
                        break
                    image = cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
                    yield RawFrame(
                        index=index,
                        name=f"{self.prefix}_{index:06d}",
                        image=resample_to_square_pixels(image, self._aspect),
                        time=time,
                    )
                    del frame, image  # free their memory before the next frame is decoded
                index += 1
        finally:
            capture.release()
        # If the file states no count, OpenCV guesses one from the duration: a video counts as cut
        # off only if both the count and the time of the last frame are too small.
        early = ends_early(index, time, self._end) is not False
        if index != chosen.stop and lacks_frames(index, self.announced) and early:
            raise cut_off_error(self.title, f"{index}", f"{self.announced} frames")

    def _call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of OpenCV; MemoryError if memory does not suffice."""
        with opencv_memory_errors(self.title):
            return function(*arguments)


def _aspect(capture: cv2.VideoCapture) -> float:
    """Return width over height of a pixel, in the frames that OpenCV reads, which are upright."""
    across, down = capture.get(cv2.CAP_PROP_SAR_NUM), capture.get(cv2.CAP_PROP_SAR_DEN)
    if not (across > 0 and down > 0):
        return 1.0
    is_turned = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 180 == 90
    return float(down / across if is_turned else across / down)


def _streams_note(path: str) -> str:
    """Return a note that only the first video stream is read; "" if no other is known."""
    count = video_streams(path) or 1
    if count < 2:
        return ""
    return (
        f"{path} has {count} video streams, and OpenCV reads the first; `pip install "
        "'tisfm[video]'` installs PyAV, with which the one marked as default or the largest is read"
    )


def _finite(time: float) -> float | None:
    return time if math.isfinite(time) else None


def open_video(
    path: str,  # its file
) -> FrameReader:
    """Open a video.

    Raises ValueError if the file is not a video that can be decoded, or is a playlist.

    Raises OSError if the file cannot be read.
    """
    with open_file(path) as file:
        beginning = file.read(max(map(len, _PLAYLIST_SIGNATURES)))
    if beginning.startswith(_PLAYLIST_SIGNATURES):
        raise FormatError(f"{path} is a list of other files, not a video: give one of those files")
    if not beginning:
        raise FormatError(f"{path} is empty (0 bytes): copy or record it again")
    if reason := why_without_frames(path):
        raise FormatError(
            f"{path} cannot be read: {reason}; copy it again, record it again, or rebuild its "
            "table of frames with a tool for that, such as untrunc"
        )
    if has_av():
        from tisfm.sources.av_video import AvVideo

        try:
            return AvVideo(path)
        except FormatError:
            raise
        except ValueError:  # OpenCV reads a few formats more, and else raises the same error
            pass
    return OpenCvVideo(path)


def has_av() -> bool:
    """Return whether PyAV is installed, in a version that gives the same pixels as OpenCV."""
    try:
        return int(version("av").partition(".")[0]) >= MIN_AV_VERSION
    except (PackageNotFoundError, ValueError):
        return False
