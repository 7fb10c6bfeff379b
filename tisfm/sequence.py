"""The interpretation of all pairs of a sequence, with two frames in memory at a time."""

import math
import os
import warnings
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera, check_camera
from tisfm.errors import InputError
from tisfm.focal_guess import guess_camera
from tisfm.interpretation import Interpretation
from tisfm.motion.camera_settings import INTRINSICS
from tisfm.running.pair_chunks import check_sharable, interpret_with_workers, refuse_float_frames
from tisfm.running.pairs import FrameSelection, PairSource, attach_poses
from tisfm.running.pool import check_workers
from tisfm.settings import FixedPixels, FocalOrigin, Settings, check_fixed_pixels, check_settings
from tisfm.sources import BadFrames, FramePair, FrameSource, Source
from tisfm.sources.frame_reader import warn_notes
from tisfm.sources.masks import Mask
from tisfm.window import Window, WindowSize, make_window


def interpret_sequence(
    source: Source,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    step: int = 1,
    start: int = 0,
    stop: int | None = None,
    size: int | None = None,
    crop: tuple[int, int, int, int] | None = None,
    bad_frames: BadFrames = "raise",
    poses: Iterable[npt.ArrayLike] | None = None,
    mask: Mask | None = None,
    fixed_pixels: FixedPixels = "mask",
    window: WindowSize = 2,
    workers: int = 1,
) -> Iterator[Interpretation]:
    """Interpret every pair of consecutive frames, one at a time.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A folder of images, a glob pattern, a video, a list of image files, or any iterable of
        frames; or ``"webcam"``, ``"webcam:1"``, … for a camera. Two frames are in memory at a time.
        For files and videos a thread reads two more frames ahead.
    camera : Camera, optional
        As for `tisfm.interpret`; distortion is removed from every frame first. The argument belongs
        to the frames before cropping and shrinking, the camera of a result to the frames after. An
        unknown focal length is guessed once, from the first image file, or else from the size of
        the first frame, with one `GuessedFocalWarning`.
    settings : Settings, optional
        By default the preset ``"balanced"``.
    step : int
        Use every `step`-th frame, for slow motion.
    start, stop : int
        Number of the first frame to use, and of the frame before which to stop; the frames of the
        source count from 0. By default all are used.
    size : int, optional
        Longer side of the frames, px. Larger frames are shrunk by averaging over areas.
    crop : (int, int, int, int), optional
        Left, top, width and height of the part of the frames to use, px. It is cropped before
        shrinking.
    bad_frames : {"raise", "skip"}
        For a damaged frame: raise an error, or leave the frame out with a warning. A pair is then
        made of the frames before and after it.
    poses : iterable of (4, 4) or (3, 3) arrays, optional
        A known motion for every pair, as `pose` for `tisfm.interpret`: from the axes of its first
        frame to the axes of its second. The iterable may be a generator, and may be endless.
    mask : path, array, sequence of paths, or iterable of arrays, optional
        Pixels to use, as for `tisfm.interpret`: black, zero or False pixels are ignored. Either a
        picture or an (H, W) array for all frames, or one mask for every frame of the source,
        skipped frames included: a folder, a glob pattern, a list of files, an (N, H, W) array, or
        any iterable of (H, W) arrays. Masks have the size of the frames before cropping and
        shrinking.
    fixed_pixels : {"mask", "keep"}
        As for `tisfm.interpret`.
    window : {2, 3}
        Number of frames for one interpretation: the pair, or, for ``motion="field"``, also the
        previous frame. A point that is hidden in the second frame of a pair is mostly visible in
        the previous frame, with nearly the same motion. The data of the previous pair are dropped
        at cuts, after pairs that failed, and where frames are skipped. They take the memory of a
        third grey frame and a flow.
    workers : int
        Processes of this machine that share the pairs, each with its share of the cores. The
        number does not change results. With several workers, the source and the mask must be
        files, and `window` must be 2. As always when `multiprocessing` starts processes by
        ``"spawn"``, a script must make the call under ``if __name__ == "__main__":``.

    Returns
    -------
    iterator of Interpretation
        For frames (0, 1), (1, 2), …

    Warns
    -----
    UserWarning
        For each skipped frame, and for each note on how the source is read.

    Raises
    ------
    OSError, TypeError, ValueError
        At once if the source does not exist or has fewer than two frames; if poses are given for a
        motion that is not ``"camera"``, or together with ``bad_frames="skip"``, or their number is
        not that of the pairs; if masks do not exist, or their number is not that of the frames; if
        `fixed_pixels` is another word; if `window` is not 2 or 3, or is 3 for a motion that is not
        ``"field"``; or if several workers cannot share the source. While iterating, if a frame or
        its mask cannot be read, if poses or masks end too early, or as `tisfm.interpret`, with the
        names of the frames.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import two_blocks
    >>> scene = two_blocks(48, 64)
    >>> frames = [scene.frame0, scene.frame1, scene.frame0]  # or a folder, a video, "webcam:0"
    >>> settings = tisfm.Settings.preset("fast")
    >>> results = tisfm.interpret_sequence(frames, camera=scene.camera, settings=settings)
    >>> [result.flow.shape for result in results]  # a pair of neighbours each
    [(48, 64, 2), (48, 64, 2)]
    """
    camera, settings = None if camera is None else check_camera(camera), check_settings(settings)
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
    warn_notes(frames.notes)
    if poses is not None and settings.motion != "camera":
        raise InputError(
            f'poses are given, but motion="{settings.motion}" leaves the motion free: leave them '
            "out"
        )
    check_fixed_pixels(fixed_pixels)
    check_workers(workers)
    previous_pairs = make_window(window, settings)
    if workers == 1:
        return _interpret_pairs(
            frames, attach_poses(frames, poses), camera, settings, previous_pairs, fixed_pixels
        )
    if previous_pairs is not None:
        raise InputError(
            "window is 3, which needs the result of the previous pair: leave out workers"
        )
    if mask is not None and not isinstance(mask, (str, os.PathLike)):
        raise InputError(
            "mask is not a path, and workers need one: give a path, or leave out workers"
        )
    check_sharable(source, frames)
    pair_source = PairSource(
        source=source if isinstance(source, (str, os.PathLike)) else [*source],
        frames=FrameSelection(
            step=step, start=start, stop=stop, size=size, crop=crop, bad_frames=bad_frames
        ),
        settings=settings,
        mask=None if mask is None else os.fspath(mask),
        motions=None if poses is None else [np.asarray(pose) for pose in poses],
    )
    return _interpret_in_workers(pair_source, camera, workers, fixed_pixels)


def _interpret_pairs(
    source: FrameSource,
    pairs: Generator[FramePair, None, None],
    camera: Camera | None,
    settings: Settings,
    window: Window | None,
    fixed_pixels: FixedPixels,
) -> Iterator[Interpretation]:
    warned_count, is_first = 0, True
    origin = _focal_origin(camera, settings)
    with closing(pairs):
        for pair in pairs:
            warned_count = _warn_of_skipped(source, warned_count)
            if is_first:
                camera = _camera_of_prepared_frames(source, pair, camera, settings)
            result = pair.interpret(
                camera=camera,
                settings=settings,
                window=window,
                fixed_pixels=fixed_pixels,
                focal_origin=origin,
            )
            result = _with_origin(result, origin)
            if is_first and camera is None:  # the camera of the first pair is kept
                camera, origin = result.camera, _origin_after(result, origin)
            is_first = False
            del pair  # frees its first frame before the next frame is read
            yield result
            del result  # its frame may be the array of the source
    _warn_of_skipped(source, warned_count)


def _interpret_in_workers(
    source: PairSource, camera: Camera | None, workers: int, fixed_pixels: FixedPixels
) -> Iterator[Interpretation]:
    """Interpret the first pair in this process, to find the camera, and the others in workers."""
    frames, pairs = source.open()
    origin = _focal_origin(camera, source.settings)
    with closing(pairs):
        first_pair = next(pairs)
        refuse_float_frames(first_pair)
        warned_count = _warn_of_skipped(frames, 0)
        camera = _camera_of_prepared_frames(frames, first_pair, camera, source.settings)
        result = first_pair.interpret(
            camera=camera,
            settings=source.settings,
            fixed_pixels=fixed_pixels,
            focal_origin=origin,
        )
        number = source.number(first_pair) + 1
        if camera is None:
            camera, origin = result.camera, _origin_after(result, origin)
        del first_pair
        yield _with_origin(result, origin)
        del result
        if number >= len(frames):  # a video may have more frames than its header says
            for pair in pairs:
                result = pair.interpret(
                    camera=camera,
                    settings=source.settings,
                    fixed_pixels=fixed_pixels,
                    focal_origin=origin,
                )
                yield _with_origin(result, origin)
            _warn_of_skipped(frames, warned_count)
            return
    warned_reasons = {reason for _, reason in frames.skipped[:warned_count]}
    outcomes = interpret_with_workers(
        source,
        camera=camera,
        workers=workers,
        first=number,
        fixed_pixels=fixed_pixels,
        focal_origin=origin,
    )
    for outcome in outcomes:
        if isinstance(outcome, Interpretation):
            yield _with_origin(outcome, origin)
        elif outcome not in warned_reasons:
            warnings.warn(f"{outcome}; the frame is skipped", stacklevel=2)


def _focal_origin(camera: Camera | None, settings: Settings) -> FocalOrigin:
    """Return where the focal length of the pairs comes from."""
    return "guessed" if camera is None and settings.motion != "field" else "stated"


def _origin_after(first: Interpretation, origin: FocalOrigin) -> FocalOrigin:
    """Return where the focal length of later pairs comes from: perhaps from the first pair."""
    is_shown = origin == "guessed" and first.focal_spread < INTRINSICS.max_focal_deviation
    return "estimated" if is_shown else origin


def _with_origin(result: Interpretation, origin: FocalOrigin) -> Interpretation:
    """Return a result that says whether its focal length was stated."""
    return replace(result, focal_deviation=0.0 if origin == "stated" else math.inf)


def _warn_of_skipped(source: FrameSource, warned_count: int) -> int:
    """Warn about skipped frames after the first `warned_count`; return the new count."""
    for _, reason in source.skipped[warned_count:]:
        warnings.warn(f"{reason}; the frame is skipped", stacklevel=3)
    return len(source.skipped)


def _camera_of_prepared_frames(
    source: FrameSource, pair: FramePair, camera: Camera | None, settings: Settings
) -> Camera | None:
    """Return the camera of the cropped and shrunk frames; None if `interpret` is to choose it."""
    file_or_shape = source.first_file or pair.full_shape
    if camera is None and file_or_shape is not None and settings.motion != "field":
        camera = guess_camera(file_or_shape)
    return (
        camera
        if pair.full_shape is None
        else source.camera_after(check_camera(camera), pair.full_shape)
    )
