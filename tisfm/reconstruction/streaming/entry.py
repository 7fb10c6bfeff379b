"""`tisfm.reconstruct_stream`: endless sequences, frame by frame."""

import os
from collections.abc import Iterator
from pathlib import Path

from tisfm.camera import Camera
from tisfm.errors import InputError, InputTypeError
from tisfm.reconstruction.entry import resolve_calibrate, resolve_camera, resolve_settings
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.streaming.streamed_frame import StreamedFrame
from tisfm.settings import Settings
from tisfm.sources import BadFrames, FrameSource, Source
from tisfm.sources.frame_reader import is_integer
from tisfm.sources.masks import Mask

# Default delay: the number of later frames that are read before a frame is yielded. Set by hand.
DEFAULT_DELAY = 60
# The shortest delay, frames. Set by hand.
MIN_DELAY = 6


def reconstruct_stream(
    source: Source,
    *,
    camera: Camera | str | os.PathLike[str] | None = None,
    calibrate: Calibrate | None = None,
    settings: Settings | None = None,
    mask: Mask | None = None,
    delay: int = DEFAULT_DELAY,
    step: int = 1,
    start: int = 0,
    stop: int | None = None,
    size: int | None = None,
    crop: tuple[int, int, int, int] | None = None,
    bad_frames: BadFrames = "raise",
) -> Iterator[StreamedFrame]:
    """Reconstruct a sequence while it is read; it may be endless.

    Frames are yielded in order, each once, with final values. Memory and disk hold only the recent
    frames. The path begins like the path of `tisfm.reconstruct` for the first frames; later frames
    continue it in the same axes and scale. There are no loop closures for scenes that were seen
    long ago: errors grow along the path.

    Parameters
    ----------
    source, camera, calibrate, settings, mask, step, start, stop, size, crop
        As for `tisfm.reconstruct`, without ``motion="objects"``. The source may be ``"webcam"``,
        ``"webcam:1"``, … for a camera: its frames are dropped while others are processed. An
        unknown focal length and an unknown readout are estimated with the first path; if that path
        does not show them, the guess and 0 are used. Later frames do not change them, since earlier
        results are final. The readout is estimated after the focal length, and corrected from the
        first frame on.
    delay : int
        The largest number of later frames that are read before a frame is yielded, at least 6. A
        longer delay gives better results: a path needs views from different camera positions.
    bad_frames : {"raise", "skip"}
        Damaged frames raise an error, or are left out with a warning each.

    Returns
    -------
    iterator of StreamedFrame
        Close it, or read it to its end, to delete its temporary folder.

    Warns
    -----
    UserWarning
        For each frame that is skipped, and each note on how the source is read.
    GuessedFocalWarning
        If the focal length is a guess, or the motion hardly shows it.

    Raises
    ------
    FileNotFoundError, OSError, TypeError, ValueError
        At once if the source does not exist or is known to have fewer than two frames, or if the
        settings have ``motion="objects"``. While iterating, after the earlier frames, if the source
        ends after one frame or a frame cannot be read.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import room_film
    >>> path = [tisfm.rigid.pose_matrix([0.12 * k, 0, 0.05 * k, 0, 0.012 * k, 0]) for k in range(7)]
    >>> film = room_film(path, 180, 240, samples=2)
    >>> settings = tisfm.Settings.preset("fast", motion="camera")
    >>> stream = tisfm.reconstruct_stream(film.frames, camera=film.camera, settings=settings)
    >>> for frame in stream:
    ...     if frame.piece >= 0:
    ...         assert frame.pose.shape == (4, 4) and frame.depth.shape == (180, 240)
    >>> frame.index
    6
    """
    settings = resolve_settings(settings, ("camera",))
    calibrate = resolve_calibrate(calibrate, is_known=camera is not None)
    if calibrate == "radial":
        raise InputError(
            'calibrate is "radial": distortion is estimated from a whole sequence only: use '
            "tisfm.reconstruct"
        )
    camera, _ = resolve_camera(camera)
    if not is_integer(delay):
        raise InputTypeError(f"delay is {delay!r}: expected a whole number of frames")
    if delay < MIN_DELAY:
        raise InputError(f"delay is {delay}: expected at least {MIN_DELAY} frames")
    frames = FrameSource(
        source,
        step=step,
        start=start,
        stop=stop,
        size=size,
        crop=crop,
        mask=mask,
        bad_frames=bad_frames,
    )
    return _stream_frames(frames, camera, calibrate, settings, int(delay))


def _stream_frames(
    frames: FrameSource,
    camera: Camera | Path | None,
    calibrate: Calibrate,
    settings: Settings,
    delay: int,
) -> Iterator[StreamedFrame]:
    from tisfm import runtime
    from tisfm.reconstruction.streaming.stream import Stream

    runtime.start()
    yield from Stream(frames, camera, calibrate, settings, delay).frames()
