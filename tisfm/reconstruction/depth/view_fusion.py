"""Fusion of the depth of one frame from several keyframes: deviation, filled holes, edges.

Inverse depth is (H, W) float32, and NaN where a keyframe has no depth.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from tisfm.kernels.rigid.depth_maps import VOTING_RADIUS, align_depth_edges, merge_depths
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.window_depth import min_inverse_depth, second_order
from tisfm.solver.sampling import enlarge, shrink
from tisfm.solver.second_order import extend_depth

View = tuple[np.ndarray, np.ndarray]  # inverse depth and its deviation, (H, W) float32 each


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
    depths = [depth for depth, _ in views]
    new_views = []
    for number, (depth, deviation) in enumerate(views):
        others = depths[:number] + depths[number + 1 :]
        difference = np.float32(factor) * relative_difference(depth, others)
        new_views.append((depth, np.hypot(deviation, difference * depth)))
    return new_views


def fuse_views(
    views: Sequence[View],  # NaN where a keyframe has no depth
) -> View:
    """Return the mean of the keyframes that agree most, at every pixel.

    Returns inverse depth and deviation, (H, W) float32, NaN without depth. The depths of the
    keyframes come from overlapping sets of images. For this reason the mean does not get a smaller
    deviation than the keyframes.
    """
    depths, deviations = map(np.stack, zip(*views, strict=True))
    valid = np.isfinite(depths) & np.isfinite(deviations)
    depths, deviations = (np.where(valid, values, np.float32(0)) for values in (depths, deviations))
    fused, fused_deviation = np.empty((2, *depths.shape[1:]), np.float32)
    merge_depths(depths, deviations, fused, fused_deviation, max_difference=DEPTH.max_difference)
    return np.where(fused > 0, fused, np.nan), np.where(fused > 0, fused_deviation, np.nan)


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
