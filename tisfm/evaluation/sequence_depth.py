"""Depth of the frames of a sequence compared with the true depth, in one scale."""

from dataclasses import dataclass
from statistics import fmean, median

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.datasets import LoadedSequence
from tisfm.datasets.pose_files import motion_between
from tisfm.evaluation.sequence_result import SequenceResult
from tisfm.lens import undistort_depth
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
    share: float  # share of the pixels of known depth that have depth
    scale: float | None  # best scale for this frame alone: the median of d*/d; None without depth
    # as `tisfm.metrics.flicker`, from this frame to the next; None if a depth map is missing
    flicker: float | None


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
    mean_error : float
        Mean over frames.
    share : float
        Mean over frames.
    scale_spread : float or None
        Standard deviation, over frames, of the logarithm of the best scale of a frame.
    flicker : float or None
        Mean over pairs of consecutive frames.
    per_frame : tuple of FrameDepthErrors

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
    mean_error: float
    share: float
    scale_spread: float | None
    flicker: float | None
    per_frame: tuple[FrameDepthErrors, ...]


def sequence_depth_errors(
    loaded: LoadedSequence,
    result: SequenceResult,  # result of the same frames, without distortion
    *,
    camera: Camera,  # camera of the original frames: true depth is resampled like these
    scale: float | None = None,  # factor of the depth; by default the median of d*/d of all frames
    max_depth: float | None = None,  # larger true depth counts as unknown
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
    frames = _compare_frames(loaded, result, camera, max_depth, scale, best_scales)
    scales = [frame.scale for frame in frames if frame.scale is not None]
    certain = [frame.certain for frame in frames if frame.certain is not None]
    has_deviations = len(certain) == len(frames)
    flickers = [frame.flicker for frame in frames if frame.flicker is not None]
    return SequenceDepthErrors(
        frames=len(frames),
        without=len(frames) - len(scales),
        scale=scale,
        error=median(frame.error for frame in frames),
        certain=median(certain) if has_deviations else None,
        mean_error=fmean(frame.error for frame in frames),
        share=fmean(frame.share for frame in frames),
        scale_spread=float(np.std(np.log(scales))) if scales else None,
        flicker=fmean(flickers) if flickers else None,
        per_frame=tuple(frames),
    )


def _compare_frames(
    loaded: LoadedSequence,
    result: SequenceResult,
    camera: Camera,
    max_depth: float | None,
    scale: float,
    best_scales: dict[int, float | None],
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
        if best_scales[index] is not None:
            error = limited_error(inverse, true_depth, scale=scale)
            certain = _certain_error(inverse, result.inverse_depth_std(index), true_depth, scale)
        frames.append(
            FrameDepthErrors(
                frame=index,
                error=error,
                certain=certain,
                share=estimated_share(inverse, true_depth),
                scale=best_scales[index],
                flicker=flicker_to_next,
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
