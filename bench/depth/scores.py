"""Errors of an estimate of depth and motion."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.depth.methods import Estimate
from bench.depth.pairs import DepthPair
from tisfm.evaluation.pair_errors import LITTLE_PARALLAX_STATUSES
from tisfm.metrics import certain_error, depth_errors, pose_errors
from tisfm.metrics.valid_pixels import is_known

MAX_RELATIVE_DEPTH = 10.0  # limit of depth, in medians of the depth of its pair; set by hand


@dataclass(frozen=True, kw_only=True)
class Score:
    """Errors of a method on a pair; None if the truth or the method does not give an error."""

    method: str
    pair: str
    group: str
    threshold: float | None = None  # of the essential matrix, px
    status: str = ""
    failure: str = ""
    # Medians of the wall time: of the call, and of the flow that it starts from.
    seconds: float | None = None
    flow_seconds: float | None = None
    # As in `tisfm.metrics.DepthErrors`, after scaling by the median.
    abs_rel: float | None = None
    # The same after `limit_depth`: every pixel counts, and a few pixels cannot dominate.
    abs_rel_limited: float | None = None
    abs_rel_raw: float | None = None  # `abs_rel` against the unregistered map of the depth camera
    # Of the static pixels, and of the moving objects, each scaled by its own median.
    abs_rel_rest: float | None = None
    abs_rel_movers: float | None = None
    # As in `tisfm.metrics.DepthErrors`, over all pixels. 1 if the method reports no depth.
    abs_rel_all: float | None = None
    # As `tisfm.metrics.certain_error`, in the unit of the given pose; None without deviations.
    abs_rel_certain: float | None = None
    # Median length, px, of the displacement minus that of the rotation, over known depth.
    parallax: float | None = None
    delta1: float | None = None
    density: float | None = None
    # Share of the visible pixels with an error of inverse depth below the standard deviation.
    within: float | None = None
    direction: float | None = None  # degrees, as in `tisfm.metrics.PoseErrors`
    rotation: float | None = None

    @property
    def without_depth(self) -> bool:
        """Whether the method itself reports too little parallax for depth."""
        return self.status in LITTLE_PARALLAX_STATUSES


def score(estimate: Estimate, pair: DepthPair) -> Score:
    result = Score(
        method=estimate.method,
        pair=pair.name,
        group=pair.group,
        threshold=estimate.threshold,
        status=estimate.status,
        failure=estimate.failure,
        seconds=estimate.seconds,
        flow_seconds=estimate.flow_seconds,
    )
    if estimate.pose is not None and pair.pose is not None and not pair.pose_given:
        errors = pose_errors(estimate.pose, pair.pose)
        has_depth = estimate.inverse_depth is not None
        direction = errors.direction if has_depth else None
        result = replace(result, direction=direction, rotation=errors.rotation)
    result = replace(result, parallax=parallax_of(pair))
    if pair.depth is None:
        return result
    if estimate.inverse_depth is None:
        return replace(result, abs_rel_all=1.0)
    depth, inverse_depth = depth_of(estimate.inverse_depth), estimate.inverse_depth
    if not (known_depth(pair.depth) & np.isfinite(depth)).any():
        return replace(result, failure="it has no depth where the true depth is known")
    errors_of_depth = depth_errors(depth, pair.depth)
    raw = None if pair.raw_depth is None else depth_errors(depth, pair.raw_depth).abs_rel
    return replace(
        result,
        abs_rel=errors_of_depth.abs_rel,
        abs_rel_limited=depth_errors(limit_depth(depth), pair.depth).abs_rel,
        abs_rel_raw=raw,
        abs_rel_all=errors_of_depth.abs_rel_all,
        abs_rel_certain=_certain_error(estimate, pair),
        abs_rel_rest=_error_of_parts(depth, pair, at_rest=True),
        abs_rel_movers=_error_of_parts(depth, pair, at_rest=False),
        delta1=errors_of_depth.delta1,
        density=errors_of_depth.density,
        within=_share_within_deviation(inverse_depth, estimate, pair, errors_of_depth.scale),
    )


def depth_of(inverse_depth: NDArray) -> NDArray[np.float64]:
    """Return depth, (H, W), NaN where the inverse depth is not above 0."""
    depth = np.full(inverse_depth.shape, np.nan)
    np.divide(1, inverse_depth, out=depth, where=inverse_depth > 0)
    return depth


def known_depth(truth: NDArray) -> NDArray[np.bool_]:
    """Return the pixels with a known true depth, (H, W) bool, as in `depth_errors`."""
    return is_known(truth) & (truth > 0)


def limit_depth(depth: NDArray) -> NDArray[np.float64]:
    """Return depth, (H, W), limited to a multiple of its median; unknown depth is at the limit."""
    limit = MAX_RELATIVE_DEPTH * float(np.nanmedian(depth))
    return np.where(depth < limit, depth, limit)  # False for NaN


def parallax_of(pair: DepthPair) -> float | None:
    """Return the median length, px, of the true displacement minus that of its rotation alone."""
    if pair.depth is None or pair.pose is None:
        return None
    height, width = pair.depth.shape
    cx, cy = pair.camera.center_for(height, width)
    rows, columns = np.nonzero(known_depth(pair.depth))
    rays = np.stack([columns - cx, rows - cy, np.full(len(rows), pair.camera.focal)])
    rotated = pair.pose[:3, :3] @ rays / pair.camera.focal
    points = rotated + pair.pose[:3, 3:] / pair.depth[rows, columns]
    in_front = (rotated[2] > 0) & (points[2] > 0)
    if not in_front.any():
        return None
    parallax = (points[:2] / points[2] - rotated[:2] / rotated[2])[:, in_front]
    return float(pair.camera.focal * np.median(np.hypot(*parallax)))


def _certain_error(estimate: Estimate, pair: DepthPair) -> float | None:
    """Return the error of the pixels with the least relative deviation, in the unit of the pose."""
    if not pair.pose_given or estimate.deviation is None or estimate.inverse_depth is None:
        return None
    assert pair.depth is not None
    return certain_error(estimate.inverse_depth, estimate.deviation, pair.depth)


def _error_of_parts(depth: NDArray, pair: DepthPair, *, at_rest: bool) -> float | None:
    """Return abs-rel of the static pixels or of the moving objects, each in its own scale."""
    if pair.object_labels is None or pair.depth is None:
        return None
    parts = [part for part in np.unique(pair.object_labels) if (part == 0) == at_rest]
    total, pixels = 0.0, 0
    for part in parts:
        mask = pair.object_labels == part
        if not known_depth(pair.depth)[mask].any():
            return None
        error = depth_errors(limit_depth(depth), pair.depth, mask).abs_rel
        total, pixels = total + error * mask.sum(), pixels + int(mask.sum())
    return total / pixels if pixels else None


def _share_within_deviation(
    inverse_depth: NDArray, estimate: Estimate, pair: DepthPair, scale: float
) -> float | None:
    """Return the share of visible pixels off by less than their standard deviation."""
    if estimate.deviation is None or pair.depth is None:
        return None
    is_counted = known_depth(pair.depth)
    visible = estimate.visible if pair.visible is None else pair.visible
    if visible is not None:
        is_counted &= visible
    truth = 1 / pair.depth[is_counted]
    error = np.abs(inverse_depth[is_counted] / scale - truth)
    return float((error <= estimate.deviation[is_counted] / scale).mean()) if len(truth) else None
