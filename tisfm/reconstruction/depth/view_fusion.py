"""Fusion of the depth that several keyframes give one view: deviation, filled holes, edges.

Inverse depth is (H, W) float32, and NaN where a keyframe has none.
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
    others: Sequence[np.ndarray],  # sequence of (H, W) float32
) -> np.ndarray:  # (H, W) float32: a share of the inverse depth; 0 where there are no others
    """Return the mean relative difference of others from an inverse depth around every pixel."""
    total, count = np.zeros((2, *inverse_depth.shape), np.float32)
    for other in others:
        difference = np.abs(other - inverse_depth) / inverse_depth
        valid = np.isfinite(difference)
        total += np.where(valid, np.minimum(difference, np.float32(DEPTH.difference_limit)), 0)
        count += valid
    compared = count > 0
    if not compared.any():
        return total
    median_term = np.float32(DEPTH.median_weight) * np.median(total[compared] / count[compared])
    side = 2 * round(DEPTH.difference_window * max(inverse_depth.shape) / 2) + 1
    blurred = cv2.blur(np.dstack([total, count]), (side, side))
    weight = blurred[..., 1] + np.float32(DEPTH.median_weight)
    return np.asarray((blurred[..., 0] + median_term) / weight)


def add_difference_to_deviation(views: Sequence[View], factor: float) -> list[View]:
    """Return views whose deviation is raised by `factor` times their difference from the others."""
    depths = [depth for depth, _ in views]
    raised = []
    for number, (depth, deviation) in enumerate(views):
        others = depths[:number] + depths[number + 1 :]
        difference = np.float32(factor) * relative_difference(depth, others)
        raised.append((depth, np.hypot(deviation, difference * depth)))
    return raised


def fuse_views(
    views: Sequence[View],  # NaN where a keyframe has no depth
) -> View:
    """Return the mean of the keyframes that agree most, at every pixel.

    Returns inverse depth and deviation, (H, W) float32, NaN where there is none. The depths of the
    keyframes come from overlapping sets of images, so the mean has no smaller deviation than they
    have.
    """
    depths, deviations = map(np.stack, zip(*views, strict=True))
    valid = np.isfinite(depths) & np.isfinite(deviations)
    depths, deviations = (np.where(valid, each, np.float32(0)) for each in (depths, deviations))
    out, out_deviation = np.empty((2, *depths.shape[1:]), np.float32)
    merge_depths(depths, deviations, out, out_deviation, max_difference=DEPTH.max_difference)
    return np.where(out > 0, out, np.nan), np.where(out > 0, out_deviation, np.nan)


def fill_holes(
    # inverse_depth, deviation, frame: (H, W) float32, the frame has grey levels
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Fill holes of inverse depth, which no keyframe shows, and set their deviation.

    Slopes are continued as well, up to image edges (`tisfm.solver.second_order`).
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
    """Return an image at all pixels, from its values at some rows and columns.

    A pixel between two similar values has their mean. Where the two differ, the image has an edge,
    and the pixel repeats the value before it.
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
    # inverse_depth, deviation, frame: (H, W) float32, the frame has grey levels. If any inverse
    # depth is not finite, nothing changes.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse depth and its deviation, with edges moved to the image edges nearby."""
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
    nearest = cv2.dilate(inverse_depth, neighbours)
    edge = nearest - cv2.erode(inverse_depth, neighbours) > DEPTH.min_jump * nearest
    # Pixels so near to the edge that the window holds pixels of both surfaces.
    near_edge = (
        cv2.dilate(edge.astype(np.uint8), np.ones((2 * VOTING_RADIUS - 1,) * 2, np.uint8)) > 0
    )
    lowest, highest = cv2.erode(inverse_depth, window), cv2.dilate(inverse_depth, window)
    return np.where(near_edge, np.sqrt(lowest * highest), np.float32(0))
