"""Video files for browsers and players: H.264 in MP4."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError, MissingPackageError
from tisfm.formats import atomic_write

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

_CODEC = "libx264"
_ENCODER_OPTIONS = {"crf": "18", "preset": "medium"}
_MAX_SIDE = 16384  # px, a limit of H.264
_BT709 = 1  # code of the colour space in FFmpeg
_LIMITED_RANGE = 1  # code of levels from 16 to 235 in FFmpeg
_MAX_DENOMINATOR = 1001  # of the frame rate, as in 30000/1001


def check_video() -> None:
    """Raise ImportError unless videos can be written."""
    try:
        import av
    except ImportError as error:
        raise MissingPackageError(
            "videos need the package av: pip install 'tisfm[video]'"
        ) from error
    if _CODEC not in av.codecs_available:
        raise MissingPackageError(
            f"the package av has no {_CODEC}, with which videos are written: pip install "
            "--force-reinstall --only-binary av av"
        )


class VideoWriter:
    """Encodes the frames of a video one after another.

    Attributes
    ----------
    frames : int
        Number of frames that were added.
    """

    def __init__(self, container: "OutputContainer", frames_per_second: float) -> None:
        self._container, self.frames = container, 0
        self._rate = Fraction(frames_per_second).limit_denominator(_MAX_DENOMINATOR)
        self._stream: VideoStream | None = None
        self._shape: tuple[int, int] = (0, 0)

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Add a frame, (H, W, 3) RGB. The last column or row is repeated if a side is odd.

        Raises ValueError if its size differs from the first frame, or is too large for H.264.
        """
        from av import VideoFrame

        if self._stream is None:
            self._stream = self._open_stream(*picture.shape[:2])
        elif picture.shape[:2] != self._shape:
            raise InputError(
                f"a frame is {picture.shape[:2]} but the first was {self._shape}: frames of a "
                "video must have the same size"
            )
        height, width = picture.shape[:2]
        padded = cv2.copyMakeBorder(picture, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        pixels = np.ascontiguousarray(padded, np.uint8)
        frame = VideoFrame.from_ndarray(pixels, format="rgb24")
        frame = frame.reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG",
            interpolation="BICUBIC",
        )  # fmt: skip
        frame.pts, frame.time_base = self.frames, 1 / self._rate
        self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def finish(self) -> None:
        """Write the frames that the encoder still holds."""
        if self._stream is not None:
            self._container.mux(self._stream.encode(None))

    def _open_stream(self, height: int, width: int) -> "VideoStream":
        if max(height, width) > _MAX_SIDE:
            raise InputError(
                f"frames of the video are {height} × {width} px: expected at most {_MAX_SIDE} px a "
                "side; run or reconstruct again with a smaller --size"
            )
        stream: Any = self._container.add_stream(
            _CODEC, rate=self._rate, options=dict(_ENCODER_OPTIONS)
        )
        stream.width, stream.height = width + width % 2, height + height % 2
        stream.pix_fmt = "yuv420p"
        stream.time_base = 1 / self._rate
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = _LIMITED_RANGE
        self._shape = (height, width)
        return stream


@contextmanager
def video_file(path: str | os.PathLike[str], frames_per_second: float) -> Iterator[VideoWriter]:
    """Yield a writer for a video, which exists only if the block ends without an exception.

    Raises ImportError if PyAV is not installed.

    Raises ValueError: at the end, if there is no frame.

    Raises OSError if the file cannot be written.
    """
    check_video()
    import av

    with atomic_write(path) as file:
        # Opened by name, because FFmpeg moves the index to the front at the end: browsers then play
        # a video before they have all of it.
        options = {"movflags": "+faststart"}
        with av.open(file.name, "w", format="mp4", options=options) as container:
            writer = VideoWriter(container, frames_per_second)
            yield writer
            if not writer.frames:
                raise InputError(f"{os.fspath(path)} would have no frame")
            writer.finish()
