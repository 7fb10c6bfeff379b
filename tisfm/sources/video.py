"""Videos: decoded by PyAV if it is installed, else by OpenCV.

Both readers use FFmpeg, apply the rotation that the file states, and resample frames to square
pixels. Their pixels are the same, and their times agree within a millisecond. PyAV also marks
damaged frames, and continues after a frame that cannot be decoded. OpenCV does not mark damaged
frames, and stops at a frame that it cannot decode. If a file has several video streams, PyAV reads
the stream that is marked as default, or else the largest; OpenCV reads the first.
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
from tisfm.sources.video_containers import count_video_streams, reason_without_frames

# First bytes of playlists: HLS, FFmpeg concat, XML and DASH, and HLS after an ID3 tag. A playlist
# names other files or URLs, and FFmpeg would open them on any machine.
_PLAYLIST_SIGNATURES = (b"#EXTM3U", b"ffconcat", b"<?xml", b"<MPD", b"ID3")
MIN_AV_VERSION = 17  # major version of PyAV; with older versions pixels differ from OpenCV


class OpenCvVideo:
    """A video that OpenCV decodes.

    OpenCV reads the first video stream of a file. Frames are resampled to square pixels.

    Raises ValueError if OpenCV cannot decode the file, or frames are larger than
    `MAX_FRAME_PIXELS`.
    """

    names: tuple[str, ...] | None = None
    count: int | None = None  # unknown before reading: a video may state a frame or two too many
    times: tuple[float, ...] | None = None
    can_read_ahead = True

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
            is_readable = capture.isOpened() and capture.grab()
            stated_count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if is_readable else 0
            rate = capture.get(cv2.CAP_PROP_FPS) if is_readable else 0
        finally:
            capture.release()
        if not is_readable:
            raise InputError(
                f"{path} is not an image or a video that OpenCV can read: it is damaged or of an "
                "unknown format; copy or record it again, or convert it to MP4 with H.264"
            )
        notes = (_streams_note(path), resampling_note(path, width, height, self._aspect))
        self.notes = tuple(filter(None, notes))
        self.stated_count: int | None = stated_count if stated_count > 0 else None
        self._stated_end = stated_count / rate if stated_count > 0 and rate > 0 else None

    def read(self, selection: slice) -> Iterator[RawFrame | BadFrame]:
        """Decode the frames whose numbers the slice contains."""
        capture = cv2.VideoCapture(self.title)
        index, time = 0, None
        try:
            while index != selection.stop and self._call(capture.grab):
                time = _finite_or_none(self._call(capture.get, cv2.CAP_PROP_POS_MSEC) / 1000)
                if is_selected(index, selection):
                    is_read, frame = self._call(capture.retrieve)
                    if not is_read:
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
        # If the file does not state the number of frames, OpenCV guesses it from the duration. So a
        # video is cut off only if both the number of frames and the time of the last frame are too
        # small.
        is_early = ends_early(index, time, self._stated_end) is not False
        if index != selection.stop and lacks_frames(index, self.stated_count) and is_early:
            raise cut_off_error(self.title, f"{index}", f"{self.stated_count} frames")

    def _call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of OpenCV; raise MemoryError if there is not enough memory."""
        with opencv_memory_errors(self.title):
            return function(*arguments)


def _aspect(capture: cv2.VideoCapture) -> float:
    """Return width over height of a pixel in the upright frames that OpenCV reads."""
    width, height = capture.get(cv2.CAP_PROP_SAR_NUM), capture.get(cv2.CAP_PROP_SAR_DEN)
    if not (width > 0 and height > 0):
        return 1.0
    is_rotated = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 180 == 90
    return float(height / width if is_rotated else width / height)


def _streams_note(path: str) -> str:
    """Return a note that only the first video stream is read; "" if one or none is known."""
    count = count_video_streams(path) or 1
    if count < 2:
        return ""
    return (
        f"{path} has {count} video streams, and OpenCV reads the first; `pip install "
        "'tisfm[video]'` installs PyAV, which reads the stream marked as default or the largest"
    )


def _finite_or_none(time: float) -> float | None:
    return time if math.isfinite(time) else None


def open_video(
    path: str,  # path of the file
) -> FrameReader:
    """Open a video.

    Raises ValueError if the file is not a video that can be decoded, or is a playlist.

    Raises OSError if the file cannot be read.
    """
    with open_file(path) as file:
        first_bytes = file.read(max(map(len, _PLAYLIST_SIGNATURES)))
    if first_bytes.startswith(_PLAYLIST_SIGNATURES):
        raise FormatError(f"{path} is a list of other files, not a video: give one of those files")
    if not first_bytes:
        raise FormatError(f"{path} is empty (0 bytes): copy or record it again")
    if reason := reason_without_frames(path):
        raise FormatError(
            f"{path} cannot be read: {reason}; copy it again, record it again, or rebuild its "
            "table of frames with a tool such as untrunc"
        )
    if has_av():
        from tisfm.sources.av_video import AvVideo

        try:
            return AvVideo(path)
        except FormatError:
            raise
        except ValueError:  # OpenCV reads a few more formats, or raises a similar error
            pass
    return OpenCvVideo(path)


def has_av() -> bool:
    """Return whether PyAV is installed in a version whose pixels agree with OpenCV."""
    try:
        return int(version("av").partition(".")[0]) >= MIN_AV_VERSION
    except (PackageNotFoundError, ValueError):
        return False
