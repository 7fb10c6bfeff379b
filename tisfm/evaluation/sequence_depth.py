"""Depth of the frames of a sequence compared with the true depth, in one scale."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean, median

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.datasets import LoadedSequence
from tisfm.datasets.pose_files import motion_between
from tisfm.evaluation.sequence_result import SequenceResult
from tisfm.lens import undistort_depth
from tisfm.metrics.depth_outlines import (
    RegionErrors,
    outlines,
    outlines_of_blurred_depth,
    region_errors,
)
from tisfm.metrics.depth_sequence import (
    LogMedian,
    certain_error,
    depth_ratios,
    estimated_share,
    flicker,
    limited_error,
)

ERROR_WITHOUT_DEPTH = 1.0  # limited error of a frame without depth


@dataclass(frozen=True, kw_only=True)
class FrameDepthErrors:
    """Errors of the depth of one frame, in the scale of the sequence."""

    frame: int
    error: float  # as `tisfm.metrics.limited_error`; 1 for a frame without depth
    # as `tisfm.metrics.certain_error`, over the 40 % of the pixels with the smallest
    # relative deviation; 1 for a frame without depth, None for a frame without deviations
    certain: float | None
    # shares of the pixels with depth and a finite deviation whose error is within one and two
    # standard deviations; None for a frame without such pixels
    within: tuple[float, float] | None
    share: float  # share of the pixels of known depth that have depth
    scale: float | None  # best scale for this frame alone: the median of d*/d; None without depth
    # as `tisfm.metrics.flicker`, from this frame to the next; None if a depth map is missing
    flicker: float | None
    # Over the whole frame, and near outlines of the true depth; None for a frame without depth. The
    # second is None in a frame without outlines, too.
    whole: RegionErrors | None
    outline: RegionErrors | None


@dataclass(frozen=True, kw_only=True)
class FrameGroupErrors:
    """Errors of the keyframes of a sequence, or of the frames between them.

    Attributes
    ----------
    frames : int
        Frames with depth and with a true depth.
    error, wrong : float
        Means over these frames: relative error, and share of the pixels with an error above 10 %,
        see `tisfm.metrics.RegionErrors`.
    outline_error, outline_wrong : float or None
        The same near outlines of the true depth; None if no frame has outlines.

    Examples
    --------
    >>> from tisfm.evaluation import FrameGroupErrors
    >>> group = FrameGroupErrors(
    ...     frames=3, error=0.02, wrong=0.03, outline_error=0.1, outline_wrong=0.2
    ... )
    >>> group.outline_error > group.error
    True
    """

    frames: int
    error: float
    wrong: float
    outline_error: float | None
    outline_wrong: float | None


@dataclass(frozen=True, kw_only=True)
class SequenceDepthErrors:
    """Errors of the depth of a sequence, over the frames with a true depth.

    Attributes
    ----------
    frames : int
        Frames with a true depth.
    without : int
        Frames among these without depth.
    scale : float
        Factor for all depth: the median of d*/d over the pixels of all frames, or 1 if the poses
        were given. d is the estimated depth, d* the true depth.
    error : float
        Median over frames, see `FrameDepthErrors`.
    certain : float or None
        Median over frames; None if a frame with depth has no deviations.
    within : (float, float) or None
        Means over frames: shares of the pixels with depth and a finite deviation whose error of
        inverse depth is within one and two standard deviations, 0.68 and 0.95 for normal errors.
        None without such pixels.
    mean_error : float
        Mean over frames.
    share : float
        Mean over frames.
    scale_spread : float or None
        Standard deviation, over frames, of the logarithm of the best scale of a frame.
    flicker : float or None
        Mean over pairs of consecutive frames.
    per_frame : tuple of FrameDepthErrors
    keyframes, between : FrameGroupErrors or None
        Errors of keyframes and of frames between them; None if there are none, or if the result
        does not tell them apart.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.datasets import find_sequences
    >>> from tisfm.evaluation import compare_sequence
    >>> (sequence,) = find_sequences("calibrated")
    >>> result = tisfm.Reconstruction.load("walk")
    >>> errors = compare_sequence(sequence, sequence.load(), result, camera=result.camera)
    >>> errors.depth.frames, errors.depth.certain <= errors.depth.error
    (9, True)
    """

    frames: int
    without: int
    scale: float
    error: float
    certain: float | None
    within: tuple[float, float] | None
    mean_error: float
    share: float
    scale_spread: float | None
    flicker: float | None
    per_frame: tuple[FrameDepthErrors, ...]
    keyframes: FrameGroupErrors | None = None
    between: FrameGroupErrors | None = None


def sequence_depth_errors(
    loaded: LoadedSequence,
    result: SequenceResult,  # result of the same frames, without distortion
    *,
    camera: Camera,  # camera of the original frames: true depth is resampled like these
    scale: float | None = None,  # factor of the depth; by default the median of d*/d of all frames
    max_depth: float | None = None,  # larger true depth counts as unknown
    is_truth_blurred: bool = False,  # whether the sensor of the true depth blurs outlines
) -> SequenceDepthErrors | None:  # none if no frame has a true depth
    """Compare the depth of a sequence with the true depth.

    Raises ValueError if the size of a map differs from the true map.

    Raises FormatError, OSError if a true map cannot be read.
    """
    ratios, best_scales = LogMedian(), dict[int, float | None]()
    for index in range(len(loaded.frames)):
        true_depth = _true_depth(loaded, index, camera, max_depth)
        if true_depth is not None:
            frame_ratios = depth_ratios(result.inverse_depth(index), true_depth)
            ratios.add(frame_ratios)
            best_scales[index] = float(np.median(frame_ratios)) if len(frame_ratios) else None
    if not best_scales:
        return None
    if scale is None:
        scale = ratios.median() or 1.0
    find_outlines = outlines_of_blurred_depth if is_truth_blurred else outlines
    frames = _compare_frames(loaded, result, camera, max_depth, scale, best_scales, find_outlines)
    scales = [frame.scale for frame in frames if frame.scale is not None]
    certain = [frame.certain for frame in frames if frame.certain is not None]
    has_deviations = len(certain) == len(frames)
    within = [frame.within for frame in frames if frame.within is not None]
    flickers = [frame.flicker for frame in frames if frame.flicker is not None]
    return SequenceDepthErrors(
        frames=len(frames),
        without=len(frames) - len(scales),
        scale=scale,
        error=median(frame.error for frame in frames),
        certain=median(certain) if has_deviations else None,
        within=(fmean(s for s, _ in within), fmean(s for _, s in within)) if within else None,
        mean_error=fmean(frame.error for frame in frames),
        share=fmean(frame.share for frame in frames),
        scale_spread=float(np.std(np.log(scales))) if scales else None,
        flicker=fmean(flickers) if flickers else None,
        per_frame=tuple(frames),
        **_group_frames(frames, getattr(result, "keyframes", None)),
    )


def _group_frames(
    frames: Sequence[FrameDepthErrors],
    keyframes: Sequence[int] | None,  # numbers of the keyframes; None if they are unknown
) -> dict[str, FrameGroupErrors | None]:
    """Return the errors of the keyframes and of the frames between them."""
    if keyframes is None:
        return {}
    keys = set(keyframes)
    return {
        "keyframes": _mean_errors([frame for frame in frames if frame.frame in keys]),
        "between": _mean_errors([frame for frame in frames if frame.frame not in keys]),
    }


def _mean_errors(frames: Sequence[FrameDepthErrors]) -> FrameGroupErrors | None:
    """Return the means of the errors of frames; None if no frame has depth."""
    whole = [frame.whole for frame in frames if frame.whole is not None]
    if not whole:
        return None
    outline = [frame.outline for frame in frames if frame.outline is not None]
    return FrameGroupErrors(
        frames=len(whole),
        error=fmean(errors.error for errors in whole),
        wrong=fmean(errors.wrong for errors in whole),
        outline_error=fmean(errors.error for errors in outline) if outline else None,
        outline_wrong=fmean(errors.wrong for errors in outline) if outline else None,
    )


def _compare_frames(
    loaded: LoadedSequence,
    result: SequenceResult,
    camera: Camera,
    max_depth: float | None,
    scale: float,
    best_scales: dict[int, float | None],
    find_outlines: Callable[[NDArray], NDArray[np.bool_]],  # true depth → pixels near outlines
) -> list[FrameDepthErrors]:
    """Compare every frame with a true depth; each map is read once."""
    frames: list[FrameDepthErrors] = []
    # Number, inverse depth and true depth of the frame after this one: the last frame comes first.
    next_frame: tuple[int, NDArray, NDArray] | None = None
    for index in sorted(best_scales, reverse=True):
        true_depth = _true_depth(loaded, index, camera, max_depth)
        assert true_depth is not None
        inverse = result.inverse_depth(index)
        flicker_to_next = None
        if (
            next_frame is not None
            and next_frame[0] == index + 1
            and loaded.posed[index : index + 2].all()
        ):
            flicker_to_next = flicker(
                (inverse, true_depth),
                next_frame[1:],
                motion_between(loaded.poses[index], loaded.poses[index + 1]),
                focal=camera.focal,
                center=camera.center_for(*true_depth.shape),
                scale=scale,
            )
        error: float = ERROR_WITHOUT_DEPTH
        certain: float | None = ERROR_WITHOUT_DEPTH
        within, whole, outline = None, None, None
        if best_scales[index] is not None:
            error = limited_error(inverse, true_depth, scale=scale)
            deviation = result.inverse_depth_std(index)
            certain = _certain_error(inverse, deviation, true_depth, scale)
            within = _shares_within(inverse, deviation, true_depth, scale)
            everywhere, near = np.ones(true_depth.shape, bool), find_outlines(true_depth)
            whole = region_errors(inverse, true_depth, everywhere, scale=scale)
            outline = region_errors(inverse, true_depth, near, scale=scale)
        frames.append(
            FrameDepthErrors(
                frame=index,
                error=error,
                certain=certain,
                within=within,
                share=estimated_share(inverse, true_depth),
                scale=best_scales[index],
                flicker=flicker_to_next,
                whole=whole,
                outline=outline,
            )
        )
        next_frame = index, inverse, true_depth
    return frames[::-1]


def _certain_error(
    inverse: NDArray, deviation: NDArray, true_depth: NDArray, scale: float
) -> float | None:
    if not np.isfinite(deviation).any():
        return None
    return certain_error(inverse, deviation, true_depth, scale=scale)


def _shares_within(
    inverse: NDArray, deviation: NDArray, true_depth: NDArray, scale: float
) -> tuple[float, float] | None:
    """Return the shares of the pixels with a finite deviation within one and two deviations."""
    is_compared = (true_depth > 0) & np.isfinite(inverse) & (inverse > 0)
    is_compared &= np.isfinite(deviation) & (deviation >= 0)
    if not is_compared.any():
        return None
    error = np.abs(inverse[is_compared] - scale / true_depth[is_compared])
    within = [error <= count * deviation[is_compared] for count in (1, 2)]
    return float(within[0].mean()), float(within[1].mean())


def _true_depth(
    loaded: LoadedSequence, index: int, camera: Camera, max_depth: float | None
) -> NDArray | None:
    """Return the true depth of a frame, without distortion; None if it is unknown."""
    depth = loaded.depth(index)
    if depth is None:
        return None
    depth = undistort_depth(depth, camera)
    if max_depth is not None:
        depth = np.where(depth <= max_depth, depth, np.float32(np.nan))
    return depth if (depth > 0).any() else None
