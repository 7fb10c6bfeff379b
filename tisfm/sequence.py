"""Frames in, interpretations out, two frames in memory at a time."""

import os
import warnings
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing

import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera, check_camera
from tisfm.errors import InputError
from tisfm.focal_guess import guess_camera
from tisfm.interpretation import Interpretation
from tisfm.running.pair_chunks import (
    check_sharable,
    check_whole_levels,
    interpret_with_workers,
)
from tisfm.running.pairs import FrameSelection, PairSource, with_poses
from tisfm.running.pool import check_workers
from tisfm.settings import Settings, check_settings
from tisfm.sources import BadFrames, FramePair, FrameSource, Source
from tisfm.sources.frame_reader import is_path, warn_notes
from tisfm.sources.masks import Mask
from tisfm.window import Window, WindowSize, window_of


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
    window: WindowSize = 2,
    workers: int = 1,
) -> Iterator[Interpretation]:
    """Interpret every pair of consecutive frames, one at a time.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A folder of images, a glob pattern, a video, a list of image files, or any iterable of
        frames; or ``"webcam"``, ``"webcam:1"``, … for a camera. Two frames are in memory at a time,
        and two more of files and videos, which are read ahead in a thread.
    camera : Camera, optional
        As for `tisfm.interpret`; distortion is removed from every frame first. It is that of the
        frames before they are cropped and shrunk; that of a result is the one after. A focal length
        that has to be guessed is guessed once, from the first image file, or else from the size of
        the first frame, with one `GuessedFocalWarning`.
    settings : Settings, optional
        By default the preset ``"balanced"``.
    step : int
        Take every `step`-th frame, for slow motion.
    start, stop : int
        The first frame that is taken, and the first that is not any more, by their numbers in the
        source, from 0. By default all.
    size : int, optional
        Longer side of the frames, px. Larger ones are shrunk by averaging over areas.
    crop : (int, int, int, int), optional
        Left, top, width and height of the part of the frames that is used, px, cut out before the
        rest is shrunk.
    bad_frames : {"raise", "skip"}
        What becomes of frames that are damaged: an error, or they are left out, with a warning
        each. A pair then is of the frames before and after.
    poses : iterable of (4, 4) or (3, 3) arrays, optional
        A known motion for every pair, as `pose` for `tisfm.interpret`: from the axes of its first
        frame to those of its second. It may be made as it goes, and need not end.
    mask : path, array, sequence of paths, or iterable of arrays, optional
        Pixels that count, as for `tisfm.interpret`: black, zero or False are ignored. A picture or
        an (H, W) array for all frames; or one for every frame of the source, those that are left
        out included: a folder, a glob pattern, a list of files, an (N, H, W) array, or any iterable
        of (H, W) arrays. They have the size of the frames before these are cropped and shrunk.
    window : {2, 3}
        How many frames an interpretation sees: the pair, or, for ``motion="field"``, the frame
        before it as well. What is hidden in the second frame of a pair is mostly seen in the one
        before the first, and its motion is nearly the same. What is known of the pair before is
        dropped at cuts, after pairs that failed, and where frames are skipped; until then a third
        frame, grey, and a flow are in memory.

    workers : int
        Processes of this machine that share the pairs, each with its share of the cores. Results
        do not depend on it. The source and the mask are files then, and `window` is 2. As always
        with processes that `multiprocessing` starts by ``"spawn"``, a script calls this under
        ``if __name__ == "__main__":``.

    Returns
    -------
    iterator of Interpretation
        For frames (0, 1), (1, 2), …

    Warns
    -----
    UserWarning
        For each frame that is skipped, and each note on how the source is read.

    Raises
    ------
    OSError, TypeError, ValueError
        At once if the source does not exist or has fewer than two frames, or if there are poses
        for a motion that is not ``"camera"``, or not as many as pairs, or though frames may be
        skipped, or if masks do not exist or are not as many as frames, or if `window` is not 2 or
        3, or is 3 for a motion that is not ``"field"``, or if several workers cannot share the
        source; while iterating if a frame or its mask
        cannot be read, if poses or masks end too early, or as `tisfm.interpret`, with the names of
        the frames.

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
    check_workers(workers)
    kept = window_of(window, settings)
    if workers == 1:
        return _interpret_pairs(frames, with_poses(frames, poses), camera, settings, kept)
    if kept is not None:
        raise InputError(
            "window is 3, which needs the result of the pair before: leave out workers"
        )
    if mask is not None and not is_path(mask):
        raise InputError("mask is no file, which several workers could read: leave out workers")
    check_sharable(source, frames)
    shared = PairSource(
        source=source if is_path(source) else list(source),
        frames=FrameSelection(
            step=step, start=start, stop=stop, size=size, crop=crop, bad_frames=bad_frames
        ),
        settings=settings,
        mask=None if mask is None else os.fspath(mask),
        motions=None if poses is None else [np.asarray(pose) for pose in poses],
    )
    return _interpret_shared(shared, camera, workers)


def _interpret_pairs(
    source: FrameSource,
    pairs: Generator[FramePair, None, None],
    camera: Camera | None,
    settings: Settings,
    window: Window | None,
) -> Iterator[Interpretation]:
    told, first = 0, True
    with closing(pairs):
        for pair in pairs:
            told = _warn_of_skipped(source, told)
            if first:
                camera = _camera_after(source, pair, camera, settings)
            result = pair.interpret(camera=camera, settings=settings, window=window)
            camera, first = camera or result.camera, False  # a guess is made once
            del pair  # or it would keep its first frame while the next one is read
            yield result
            del result  # of which the frame may be that of the source
    _warn_of_skipped(source, told)


def _interpret_shared(
    source: PairSource, camera: Camera | None, workers: int
) -> Iterator[Interpretation]:
    """Interpret the first pair here, which decides on the camera, and the others in processes."""
    frames, pairs = source.open()
    with closing(pairs):
        first = next(pairs)
        check_whole_levels(first)
        told = _warn_of_skipped(frames, 0)
        camera = _camera_after(frames, first, camera, source.settings)
        result = first.interpret(camera=camera, settings=source.settings)
        camera, number = camera or result.camera, source.number(first) + 1
        del first
        yield result
        del result
        if number >= len(frames):  # a video may have more frames than its header says
            for pair in pairs:
                yield pair.interpret(camera=camera, settings=source.settings)
            _warn_of_skipped(frames, told)
            return
    told_reasons = {reason for _, reason in frames.skipped[:told]}
    for one in interpret_with_workers(source, camera=camera, workers=workers, first=number):
        if isinstance(one, Interpretation):
            yield one
        elif one not in told_reasons:
            warnings.warn(f"{one}; the frame is skipped", stacklevel=2)


def _warn_of_skipped(source: FrameSource, told: int) -> int:
    """Warn of the frames that were skipped after the first `told`; return how many it now are."""
    for _, reason in source.skipped[told:]:
        warnings.warn(f"{reason}; the frame is skipped", stacklevel=3)
    return len(source.skipped)


def _camera_after(
    source: FrameSource, pair: FramePair, camera: Camera | None, settings: Settings
) -> Camera | None:
    """Return the camera of the frames as they are interpreted; None where the pair is to decide."""
    known = source.first_file or pair.full
    if camera is None and known is not None and settings.motion != "field":
        camera = guess_camera(known)
    return camera if pair.full is None else source.camera_after(check_camera(camera), pair.full)
