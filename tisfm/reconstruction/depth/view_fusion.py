"""Fusion of the depth of one frame from several keyframes: deviation, filled holes, edges.

Inverse depth is (H, W) float32, and NaN where a keyframe has no depth.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.kernels.rigid.depth_edges import VOTING_RADIUS, align_depth_edges
from tisfm.kernels.rigid.depth_maps import render_depth
from tisfm.kernels.rigid.depth_votes import merge_depths
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.window_depth import min_inverse_depth, second_order
from tisfm.solver.sampling import enlarge, shrink
from tisfm.solver.second_order import extend_depth


@dataclass(frozen=True, kw_only=True)
class Projection:
    """Pinhole projection of all views: focal length and principal point, px."""

    focal: float
    center: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Keyframe:
    """A keyframe that another frame sees; images are (H, W) float32."""

    inverse_depth: np.ndarray  # 0 where unknown
    deviation: np.ndarray  # finite
    grey: np.ndarray  # grey levels
    motion: np.ndarray  # (3, 4) float64: R and t from the keyframe to the frame


@dataclass(frozen=True, kw_only=True)
class View:
    """The depth of a keyframe, rendered in a frame; images are (H, W) float32."""

    inverse_depth: np.ndarray  # NaN where the keyframe shows no surface
    deviation: np.ndarray  # its standard deviation; NaN at the same pixels
    keyframe: Keyframe


def relative_difference(
    inverse_depth: np.ndarray,  # (H, W) float32: positive, or NaN where it is not compared
    others: Sequence[np.ndarray],  # sequence of (H, W) float32: other inverse depths
) -> np.ndarray:  # (H, W) float32: a share of the inverse depth; 0 without other depth
    """Return the mean relative difference of others from an inverse depth, around every pixel."""
    total, count = np.zeros((2, *inverse_depth.shape), np.float32)
    for other in others:
        difference = np.abs(other - inverse_depth) / inverse_depth
        valid = np.isfinite(difference)
        total += np.where(valid, np.minimum(difference, np.float32(DEPTH.difference_limit)), 0)
        count += valid
    is_known = count > 0
    if not is_known.any():
        return total
    prior = np.float32(DEPTH.median_weight) * np.median(total[is_known] / count[is_known])
    side = 2 * round(DEPTH.difference_window * max(inverse_depth.shape) / 2) + 1
    blurred = cv2.blur(np.dstack([total, count]), (side, side))
    weight = blurred[..., 1] + np.float32(DEPTH.median_weight)
    return np.asarray((blurred[..., 0] + prior) / weight)


def add_difference_to_deviation(views: Sequence[View], factor: float) -> list[View]:
    """Return views; `factor` times the difference from other views is added to the deviation."""
    depths = [view.inverse_depth for view in views]
    new_views = []
    for number, view in enumerate(views):
        others = depths[:number] + depths[number + 1 :]
        difference = np.float32(factor) * relative_difference(view.inverse_depth, others)
        deviation = np.hypot(view.deviation, difference * view.inverse_depth)
        new_views.append(replace(view, deviation=deviation))
    return new_views


def render_view(keyframe: Keyframe, projection: Projection, *, continued: bool = False) -> View:
    """Return the view of a keyframe in a frame.

    With `continued`, the farther surface at a jump goes on where the frame looks behind the nearer
    surface; it has the deviation of a filled hole.
    """
    out, deviation = (np.empty_like(keyframe.inverse_depth) for _ in range(2))
    render_depth(
        keyframe.inverse_depth,
        keyframe.deviation,
        keyframe.motion,
        out,
        deviation,
        center=projection.center,
        focal=projection.focal,
        continued_deviation=DEPTH.filled_deviation if continued else 0.0,
    )
    is_visible = out > 0
    return View(
        inverse_depth=np.where(is_visible, out, np.float32(np.nan)),
        deviation=np.where(is_visible, deviation, np.float32(np.nan)),
        keyframe=keyframe,
    )


def fuse_views(
    views: Sequence[View],
    grey: np.ndarray,  # (H, W) float32: grey levels of the frame
    projection: Projection,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of the keyframes that agree, on the surface that most votes are for.

    Returns inverse depth and deviation, (H, W) float32, NaN without depth. The depths of the
    keyframes come from overlapping sets of images. For this reason the mean does not get a smaller
    deviation than the keyframes.
    """
    valid = [np.isfinite(view.inverse_depth) & np.isfinite(view.deviation) for view in views]
    fused, fused_deviation = np.empty((2, *grey.shape), np.float32)
    merge_depths(
        _stack(np.where(v, view.inverse_depth, 0) for v, view in zip(valid, views, strict=True)),
        _stack(np.where(v, view.deviation, 0) for v, view in zip(valid, views, strict=True)),
        grey,
        _stack(view.keyframe.inverse_depth for view in views),
        _stack(view.keyframe.deviation for view in views),
        _stack(view.keyframe.grey for view in views),
        _stack(_inverse(view.keyframe.motion) for view in views),
        fused,
        fused_deviation,
        center=projection.center,
        focal=projection.focal,
        max_difference=DEPTH.max_difference,
        grey_decay=DEPTH.vote_grey_scale,
        border=DEPTH.view_border * max(grey.shape),
    )
    return np.where(fused > 0, fused, np.nan), np.where(fused > 0, fused_deviation, np.nan)


def _stack(images: Iterable[np.ndarray]) -> np.ndarray:
    return np.ascontiguousarray(np.stack(list(images)), np.float32)


def _inverse(motion: np.ndarray) -> np.ndarray:
    """Return the inverse of a motion, (3, 4)."""
    rotation = motion[:, :3].T
    return np.column_stack([rotation, -rotation @ motion[:, 3]])


def fill_holes(
    # inverse_depth, deviation, frame: (H, W) float32; the frame is in grey levels
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Fill holes of inverse depth, which no keyframe shows, and set their deviation.

    Depth is extrapolated with its slopes, up to image edges (`tisfm.solver.second_order`).
    """
    valid = np.isfinite(inverse_depth)
    if valid.all() or not valid.any():
        return inverse_depth, np.where(valid, deviation, np.inf).astype(np.float32)
    level = 0
    while frame.size >> 2 * level > DEPTH.max_fill_cells:
        level += 1
    side = 2**level
    height, width = (-(-length // side) for length in frame.shape)
    min_value = min_inverse_depth(inverse_depth[valid])
    scale = np.float32(DEPTH.fill_median / np.median(inverse_depth[valid]))
    images = np.stack([valid, np.where(valid, scale * inverse_depth, 0), frame])
    coverage, target, small_frame = shrink(images.astype(np.float32), side, height, width)
    target = np.divide(target, coverage, out=np.zeros_like(target), where=coverage > 0)
    filled, _ = extend_depth(target, coverage, small_frame, second_order(level), iterations=1)
    value = np.maximum(enlarge(filled[None] / scale, side, *frame.shape)[0], min_value)
    return (
        np.where(valid, inverse_depth, value).astype(np.float32),
        np.where(valid, deviation, DEPTH.filled_deviation * value).astype(np.float32),
    )


def upsample(
    image: np.ndarray,  # (h, w) float32: every `stride`-th row and column, from 0; positive, or NaN
    stride: int,  # a power of 2
    shape: tuple[int, int],  # H and W
) -> np.ndarray:  # (H, W) float32
    """Return an image at all pixels, from its values at every `stride`-th row and column.

    A pixel between two similar values gets their mean. Different values show an edge; then the
    pixel gets the value to its left or above.
    """
    while stride > 1:
        image = _double_rows(_double_rows(image).T).T
        stride //= 2
    return np.ascontiguousarray(image[: shape[0], : shape[1]])


def _double_rows(image: np.ndarray) -> np.ndarray:
    out = image.repeat(2, axis=0)
    previous, following = image[:-1], image[1:]
    limit = DEPTH.max_smooth_step * np.minimum(previous, following)
    is_smooth = np.abs(following - previous) < limit
    out[1:-1:2] = np.where(is_smooth, (previous + following) / 2, previous)
    return out


def align_edges(
    # inverse_depth, deviation, frame: (H, W) float32; the frame is in grey levels. If any inverse
    # depth is not finite, the function changes nothing.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse depth and its deviation, with depth edges moved to nearby image edges."""
    if not np.isfinite(inverse_depth).all():
        return inverse_depth, deviation
    depth, std = np.ascontiguousarray(inverse_depth), np.ascontiguousarray(deviation)
    out, out_deviation = np.empty((2, *depth.shape), np.float32)
    threshold = _surface_threshold(depth)
    align_depth_edges(depth, std, threshold, frame, out, out_deviation, grey_decay=DEPTH.grey_scale)
    return out, out_deviation


def _surface_threshold(inverse_depth: np.ndarray) -> np.ndarray:
    """Return the geometric mean of the extremes in a window around a depth edge; elsewhere 0."""
    neighbours, window = (np.ones((side, side), np.uint8) for side in (3, 2 * VOTING_RADIUS + 1))
    max_neighbour = cv2.dilate(inverse_depth, neighbours)
    is_edge = (
        max_neighbour - cv2.erode(inverse_depth, neighbours) > DEPTH.min_edge_step * max_neighbour
    )
    # These pixels are so near to the edge that their windows contain pixels of both surfaces.
    is_near_edge = (
        cv2.dilate(is_edge.astype(np.uint8), np.ones((2 * VOTING_RADIUS - 1,) * 2, np.uint8)) > 0
    )
    min_depth, max_depth = cv2.erode(inverse_depth, window), cv2.dilate(inverse_depth, window)
    return np.where(is_near_edge, np.sqrt(min_depth * max_depth), np.float32(0))
