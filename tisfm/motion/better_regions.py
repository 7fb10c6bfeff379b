"""A choice between two depths of a pair, region by region, by what the frames show.

A search finds things that an estimate from coarse to fine loses, and is wrong on bare surfaces. One
choice for the whole frame would take its errors or lose its finds.
"""

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.matched_planes import noise_deviation
from tisfm.motion.moved_pixels import move_pixels
from tisfm.motion.settings import GLOBAL
from tisfm.motion.sparse_start import depth_flow
from tisfm.motion.window_statistics import correlation, window_variance
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.visibility.confidence import CONFIDENCE_WINDOW
from tisfm.visibility.occlusion import leaves_image


def better_regions(
    pyramid: ImagePyramid,
    motion: np.ndarray,  # (3, 4) array: R and t
    # found, candidate: (H, W) float32: D, px/frame
    found: np.ndarray,
    candidate: np.ndarray,
    is_matched: np.ndarray,  # (H, W) bool: pixels that the candidate matched in both directions
) -> np.ndarray:
    """Return the pixels at which the candidate is better, (H, W) bool.

    Where both depths differ, connected pixels form regions; matched pixels and others are apart. A
    region gets the candidate if the frames correlate better along it, on average over the region.
    Windows that vary no more than noise count little. Last, a pixel that is hidden in frame 1 gets
    the farther one of both depths.
    """
    frame = pyramid.frames0[0]
    variance = window_variance(frame, CONFIDENCE_WINDOW)  # the window of `correlation`
    valid = pyramid.valid_on(0)
    noise = noise_deviation(frame, valid=None if valid is None else valid[0])
    weight = variance / (variance + np.float32(noise**2))
    correlations = []
    for depth in (candidate, found):
        flow = depth_flow(depth, motion, pyramid.cameras[0])
        components = np.moveaxis(flow, -1, 0)
        if pyramid.masks is not None:
            weight = np.where(pyramid.masks.ignored_pixels(components, 0), 0, weight)
        seen = correlation(frame, pyramid.frames1[0], flow)
        correlations.append(np.where(leaves_image(components), np.float32(np.nan), seen))
    gain = weight * _difference_of_correlations(correlations[0], correlations[1])
    is_better = np.zeros(frame.shape, bool)
    for part in (is_matched, ~is_matched):
        for difference in (candidate - found, found - candidate):
            is_region = part & (difference > GLOBAL.region_difference)
            _, labels = cv2.connectedComponents(is_region.astype(np.uint8), connectivity=4)
            sizes = np.bincount(labels.ravel())
            mean_gain = np.bincount(labels.ravel(), gain.ravel()) / np.maximum(sizes, 1)
            mean_gain[0] = 0  # pixels outside all regions
            is_better |= mean_gain[labels] > GLOBAL.min_gain
    is_alike = np.abs(candidate - found) <= GLOBAL.region_difference
    is_better |= is_matched & is_alike
    joined = np.where(is_better, candidate, found)
    is_hidden = _hidden_pixels(joined, motion, pyramid.cameras[0])
    return np.where(is_hidden, candidate < found, is_better)


def _difference_of_correlations(
    # candidate, found: (H, W) float32: correlation along both depths, NaN outside frame 1
    candidate: np.ndarray,
    found: np.ndarray,
) -> np.ndarray:  # (H, W) float32
    """Return by how much the candidate correlates better.

    A depth that moves a pixel out of frame 1 can be neither confirmed nor refuted. It counts
    as the better depth of a usual pixel.
    """
    better = np.fmax(candidate, found)
    is_seen = np.isfinite(better)
    usual = np.median(better[is_seen]) if is_seen.any() else np.float32(0)
    first, second = (np.where(np.isnan(part), usual, part) for part in (candidate, found))
    difference: np.ndarray = first - second
    return difference


def _hidden_pixels(depth: np.ndarray, motion: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the pixels of frame 0 that a nearer one hides in frame 1, (H, W) bool."""
    moved = move_pixels(depth, motion, camera)
    nearest = np.full(depth.shape, -np.inf, np.float32)
    targets = moved.rows[moved.is_inside], moved.columns[moved.is_inside]
    np.maximum.at(nearest, targets, moved.depth[moved.is_inside].astype(np.float32))
    # A surface that comes nearer is sampled with gaps of a pixel.
    closed = np.asarray(cv2.morphologyEx(nearest, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)))
    excess = closed[moved.rows, moved.columns] - moved.depth
    is_hidden: np.ndarray = moved.is_inside & (excess > GLOBAL.min_hidden_distance)
    return is_hidden
