"""What several keyframes say of one view: how far they are apart, what they say together, the rest.

Inverse depth is (H, W) float32, NaN where a keyframe shows nothing.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from tisfm.kernels.rigid.merging import merged
from tisfm.reconstruction.depth.window_depth import FAR_SHARE, MAX_DEPTH_FACTOR, second_order
from tisfm.solver.sampling import enlarged, reduced
from tisfm.solver.second_order import fill

# Values without a stated source were set by hand.

# Share of the inverse depth: rendered surfaces that differ by more are different surfaces.
MAX_DIFFERENCE = 0.1
# Share of a value: neighbours that differ by more lie on different surfaces.
MAX_SMOOTH_STEP = 0.05
# Share of the longer side: side of the window that differences are averaged in.
WINDOW_SHARE = 0.05
# Share of the inverse depth: a single difference counts for no more.
DIFFERENCE_LIMIT = 0.5
# Weight of the median of all differences, in pixels per pixel of the window.
MEDIAN_WEIGHT = 0.02
# Relative standard deviation of inverse depth that no keyframe shows, where a hole is filled.
FILLED_DEVIATION = 0.5
# Cells of the grid that holes are filled on.
MAX_FILL_CELLS = 2**13
# Median inverse depth on this grid, in sides of a cell.
FILL_MEDIAN = 20.0


View = tuple[np.ndarray, np.ndarray]  # inverse depth and its deviation, (H, W) float32 each


def relative_difference(inverse_depth: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
    """Return how far others are from an inverse depth around every pixel.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        Positive, or NaN: there it is not compared.
    others : sequence of (H, W) float32

    Returns
    -------
    (H, W) float32
        A share of the inverse depth; 0 where there are no others.
    """
    total, count = np.zeros((2, *inverse_depth.shape), np.float32)
    for other in others:
        share = np.abs(other - inverse_depth) / inverse_depth
        shown = np.isfinite(share)
        total += np.where(shown, np.minimum(share, np.float32(DIFFERENCE_LIMIT)), 0)
        count += shown
    seen = count > 0
    if not seen.any():
        return total
    usual = np.float32(MEDIAN_WEIGHT) * np.median(total[seen] / count[seen])
    side = 2 * round(WINDOW_SHARE * max(inverse_depth.shape) / 2) + 1
    around = cv2.blur(np.dstack([total, count]), (side, side))
    apart: np.ndarray = (around[..., 0] + usual) / (around[..., 1] + np.float32(MEDIAN_WEIGHT))
    return apart


def raise_deviation_where_different(views: Sequence[View], times: float) -> list[View]:
    """Return views as unsure as the others contradict each: `times` how far they are from it."""
    depths = [depth for depth, _ in views]
    unsure = []
    for number, (depth, deviation) in enumerate(views):
        apart = np.float32(times) * relative_difference(
            depth, depths[:number] + depths[number + 1 :]
        )
        unsure.append((depth, np.hypot(deviation, apart * depth)))
    return unsure


def fuse_views(views: Sequence[View]) -> View:
    """Return what several keyframes say of the same pixels: the mean of those that agree most.

    Parameters
    ----------
    views : sequence of View
        NaN where there is none.

    Returns
    -------
    inverse_depth, deviation : (H, W) float32
        The same. Keyframes are of overlapping sets of images: their mean is no surer than they are.
    """
    depths, spreads = map(np.stack, zip(*views, strict=True))
    known = np.isfinite(depths) & np.isfinite(spreads)
    depths, spreads = (np.where(known, each, np.float32(0)) for each in (depths, spreads))
    out, deviation = np.empty((2, *depths.shape[1:]), np.float32)
    merged(depths, spreads, out, deviation, alike=MAX_DIFFERENCE)
    return np.where(out > 0, out, np.nan), np.where(out > 0, deviation, np.nan)


def fill_holes(
    inverse_depth: np.ndarray, deviation: np.ndarray, frame: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Carry inverse depth to where no keyframe shows any, and say how unsure that is.

    Slopes are carried as well, up to the edges of the frame (`tisfm.solver.second_order`).

    Parameters
    ----------
    inverse_depth, deviation, frame : (H, W) float32
        The frame has grey levels.
    """
    known = np.isfinite(inverse_depth)
    if known.all() or not known.any():
        return inverse_depth, np.where(known, deviation, np.inf).astype(np.float32)
    level = 0
    while frame.size >> 2 * level > MAX_FILL_CELLS:
        level += 1
    side = 2**level
    height, width = (-(-length // side) for length in frame.shape)
    least = np.float32(np.quantile(inverse_depth[known], FAR_SHARE) / MAX_DEPTH_FACTOR)
    scale = np.float32(FILL_MEDIAN / np.median(inverse_depth[known]))
    images = np.stack([known, np.where(known, scale * inverse_depth, 0), frame])
    share, target, small = reduced(images.astype(np.float32), side, height, width)
    target = np.divide(target, share, out=np.zeros_like(target), where=share > 0)
    carried, _ = fill(target, share, small, second_order(level), iterations=1)
    value = np.maximum(enlarged(carried[None] / scale, side, *frame.shape)[0], least)
    return (
        np.where(known, inverse_depth, value).astype(np.float32),
        np.where(known, deviation, FILLED_DEVIATION * value).astype(np.float32),
    )


def upsample(image: np.ndarray, stride: int, shape: tuple[int, int]) -> np.ndarray:
    """Return an image of some pixels at all of them: between two that are alike, their mean.

    Where they are not, the image has an edge, and the one before stands for both.

    Parameters
    ----------
    image : (h, w) float32
        Of every pixel in `stride` rows and columns, from 0; positive, or NaN.
    stride : int
        A power of 2.
    shape : (int, int)
        H and W.

    Returns
    -------
    (H, W) float32
    """
    while stride > 1:
        image = _twice_the_rows(_twice_the_rows(image).T).T
        stride //= 2
    return np.ascontiguousarray(image[: shape[0], : shape[1]])


def _twice_the_rows(image: np.ndarray) -> np.ndarray:
    out = image.repeat(2, axis=0)
    before, after = image[:-1], image[1:]
    alike = np.abs(after - before) < MAX_SMOOTH_STEP * np.minimum(before, after)
    out[1:-1:2] = np.where(alike, (before + after) / 2, before)
    return out
