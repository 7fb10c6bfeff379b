"""Videos that PyAV decodes, with exact times and with marks on damaged frames."""

import re
from collections.abc import Iterator
from heapq import heappop, heappush
from pathlib import Path

import av
import cv2
import numpy as np
from av.codec.context import ThreadType
from av.container import InputContainer
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from tisfm.errors import InputError
from tisfm.formats import FormatError
from tisfm.sources.frame_reader import BadFrame, RawFrame, is_selected
from tisfm.sources.video_checks import (
    MAX_FRAME_PIXELS,
    cut_off_error,
    ends_early,
    lacks_frames,
    refuse_large_frames,
    resample_to_square_pixels,
    resampling_note,
    square_size,
)

_TEXT_FORMAT = "tty"  # FFmpeg renders a text file as a video
_PLAYLIST_FORMATS = ("concat", "dash", "hls", "imf", "sdp")  # such files name other files
# The limit also holds for decoders: a stream may have frames of another size than its container
# states.
_DECODER_OPTIONS = {"max_pixels": str(MAX_FRAME_PIXELS)}
_STILL_IMAGES = Disposition.attached_pic | Disposition.timed_thumbnails  # such as cover images
_HOURS = re.compile(r"(\d+):(\d+):(\d+(?:\.\d+)?)")  # hours:minutes:seconds


class AvVideo:
    """A video that PyAV decodes.

    If the file has several video streams, the stream that is marked as default is read, or else the
    largest. Frames are resampled to square pixels.

    Raises ValueError if the file has no frame that PyAV can decode.

    Raises tisfm.formats.FormatError, which is a ValueError, if the file is a playlist, or its
    frames are larger than `MAX_FRAME_PIXELS`.
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
        try:
            with _open_container(path) as container:
                if container.format.name in _PLAYLIST_FORMATS:
                    raise FormatError(
                        f"{path} is a list of other files, not a video: give one of those files"
                    )
                if not container.streams.video or container.format.name == _TEXT_FORMAT:
                    raise InputError(f"{path} is not a video")
                stream = _choose_stream(container)
                self._stream = stream.index
                self.stated_count: int | None = stream.frames or None
                self._stated_end = _stated_end(stream)
                # PyAV's types promise a codec context, but it is missing if FFmpeg does not know
                # the codec.
                if getattr(stream, "codec_context", None) is None:
                    raise InputError(f"{path} is of an unknown codec")
                self._aspect = float(stream.sample_aspect_ratio or 1)
                size = stream.width, stream.height, self._aspect
                refuse_large_frames(path, *square_size(*size))
                decoder = _FrameDecoder(container, stream)
                first_frame = next((item for item in decoder if isinstance(item, VideoFrame)), None)
                if first_frame is None:
                    raise InputError(f"{path} has no frame")
                if first_frame.rotation % 180 == 90:  # frames are rotated to be upright
                    size = stream.height, stream.width, 1 / self._aspect
                notes = (_streams_note(path, container, stream), resampling_note(path, *size))
                self.notes = tuple(filter(None, notes))
        except (av.FFmpegError, OSError) as error:
            raise InputError(f"{path} cannot be decoded: {error}") from error

    def read(self, selection: slice) -> Iterator[RawFrame | BadFrame]:
        """Decode the frames whose numbers the slice contains."""
        index, time, is_intact = 0, None, True
        with _open_container(self.title) as container:
            stream = container.streams[self._stream]
            decoder = _FrameDecoder(container, stream)
            frames = iter(decoder)
            try:
                while index != selection.stop and (frame := next(frames, None)) is not None:
                    # A damaged frame also damages the frames that are predicted from it, up to the
                    # next key frame.
                    if isinstance(frame, VideoFrame):
                        time = _time(frame, stream)
                        is_intact = not frame.is_corrupt and (is_intact or frame.key_frame)
                    else:
                        is_intact = False
                    if is_selected(index, selection):
                        yield self._make_frame(frame, index, time, is_intact)
                    index += 1
            except av.FFmpegError as error:
                raise FormatError(
                    f"{self.title} cannot be read beyond frame {index}: {error}"
                ) from error
        if index == selection.stop:
            return
        is_early = ends_early(index, time, self._stated_end)
        if self.stated_count is None:
            if is_early:
                raise cut_off_error(
                    self.title, f"{index} frames, {time:.2f}", f"{self._stated_end:.2f} s"
                )
        # A file may leave out frames that repeat the frame before. Then the time of the last frame
        # shows whether the file is cut off.
        elif lacks_frames(decoder.packet_count, self.stated_count) and is_early is not False:
            raise cut_off_error(self.title, f"{index}", f"{self.stated_count} frames")

    def _make_frame(
        self, frame: VideoFrame | av.FFmpegError, index: int, time: float | None, is_intact: bool
    ) -> RawFrame | BadFrame:
        name = f"{self.prefix}_{index:06d}"
        if not isinstance(frame, VideoFrame):
            fault = "cannot be decoded"
        elif frame.is_corrupt:
            fault = "is damaged"
        elif not is_intact:
            fault = "is predicted from a damaged one"
        else:
            return RawFrame(index=index, name=name, image=self._pixels(frame), time=time)
        error = FormatError(f"frame {index} of {self.title} {fault}: the file is damaged there")
        return BadFrame(index=index, name=name, error=error)

    def _pixels(self, frame: VideoFrame) -> np.ndarray:
        """Return an upright frame, (H, W, 3) uint8 RGB, with the same pixels as with OpenCV."""
        bgr = frame.to_ndarray(format="bgr24", interpolation="BICUBIC")
        image = resample_to_square_pixels(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), self._aspect)
        if frame.rotation % 90 == 0:
            image = np.rot90(image, frame.rotation // 90)
        return np.ascontiguousarray(image)


def _choose_stream(container: InputContainer) -> VideoStream:
    """Return the video stream to read: the stream marked as default, or else the largest."""
    streams = _video_streams(container)
    if not streams:
        return container.streams.video[0]
    default_streams = [stream for stream in streams if stream.disposition & Disposition.default]
    return (
        default_streams[0]
        if len(default_streams) == 1
        else max(default_streams or streams, key=_frame_pixels)
    )


def _video_streams(container: InputContainer) -> list[VideoStream]:
    """Return the video streams that can be decoded, without still images such as cover images."""
    decodable = [
        stream for stream in container.streams.video if getattr(stream, "codec_context", None)
    ]
    return [stream for stream in decodable if not stream.disposition & _STILL_IMAGES] or decodable


def _frame_pixels(stream: VideoStream) -> int:
    return int(stream.width * stream.height)


def _streams_note(path: str, container: InputContainer, used_stream: VideoStream) -> str:
    """Return a note on the stream that is read and the streams left out; "" for one stream."""
    streams = _video_streams(container)
    if len(streams) < 2:
        return ""
    other_streams = ", ".join(
        f"{number} ({stream.width} × {stream.height} px)"
        for number, stream in enumerate(container.streams.video)
        if stream in streams and stream.index != used_stream.index
    )
    number = [stream.index for stream in container.streams.video].index(used_stream.index)
    reason = (
        "is marked as default"
        if used_stream.disposition & Disposition.default
        else "is the largest"
    )
    return (
        f"{path} has {len(streams)} video streams: {number} "
        f"({used_stream.width} × {used_stream.height} px) is read, as it {reason}; left out: "
        f"{other_streams}, which `ffmpeg -i FILE -map 0:v:NUMBER -c copy OTHER` copies to a "
        "separate file"
    )


def _open_container(path: str) -> InputContainer:
    return av.open(path, options=_DECODER_OPTIONS)


class _FrameDecoder:
    """The frames of a video in the order of their times, with an error in place of a lost frame.

    Attributes
    ----------
    packet_count : int
        Number of packets that were read so far: one for each frame, also for frames that are
        never displayed.
    """

    def __init__(self, container: InputContainer, stream: VideoStream) -> None:
        # With threads over frames, an error would come too late to know its frame.
        stream.thread_type = ThreadType.SLICE
        stream.codec_context.options = _DECODER_OPTIONS
        self._container, self._stream = container, stream
        self.packet_count = 0

    def __iter__(self) -> Iterator[VideoFrame | av.FFmpegError]:
        lost_frames: list[tuple[int, int, av.FFmpegError]] = []  # time, number of the packet, error
        for packet in self._container.demux(self._stream):
            self.packet_count += packet.size > 0
            try:
                frames = packet.decode()
            except av.FFmpegError as error:
                if isinstance(error, MemoryError):
                    raise
                if packet.pts is None:
                    yield error
                else:
                    heappush(lost_frames, (packet.pts, self.packet_count, error))
                continue
            for frame in frames:
                while lost_frames and frame.pts is not None and lost_frames[0][0] < frame.pts:
                    yield heappop(lost_frames)[2]
                yield frame
        while lost_frames:
            yield heappop(lost_frames)[2]


def _time(frame: VideoFrame, stream: VideoStream) -> float | None:
    """Return the time of a frame, s from the beginning of the video."""
    if frame.pts is None or frame.time_base is None:
        return None
    return float((frame.pts - (stream.start_time or 0)) * frame.time_base)


def _stated_end(stream: VideoStream) -> float | None:
    """Return the stated end of a video, s from its beginning; None if no end is stated."""
    # The number of frames is more reliable: FFmpeg shortens the duration of an AVI that is cut off.
    if stream.frames and stream.average_rate:
        return float(stream.frames / stream.average_rate)
    if stream.duration is not None and stream.time_base is not None:
        return float(stream.duration * stream.time_base)
    duration = _HOURS.match(stream.metadata.get("DURATION", ""))  # in Matroska and WebM
    if duration is None:
        return None
    hours, minutes, seconds = map(float, duration.groups())
    return 3600 * hours + 60 * minutes + seconds
