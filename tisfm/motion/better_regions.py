"""The frames choose between two depths of a pair, region by region.

A search finds things that an estimate from coarse to fine loses, and is wrong on bare surfaces. One
choice for the whole frame would take the errors of the search, or lose the things it finds.
"""

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.moved_pixels import move_pixels
from tisfm.motion.settings import GLOBAL
from tisfm.motion.sparse_start import depth_flow
from tisfm.motion.textureless_depth import texture_weight
from tisfm.motion.window_statistics import correlation
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.visibility.occlusion import leaves_image


def better_regions(
    pyramid: ImagePyramid,
    motion: np.ndarray,  # (3, 4) array: R and t
    # found, candidate: (H, W) float32: D, px/frame; the candidate is finite
    found: np.ndarray,
    candidate: np.ndarray,
    is_matched: np.ndarray,  # (H, W) bool: pixels that the candidate matched in both directions
) -> np.ndarray:
    """Return the pixels at which the candidate is better, (H, W) bool.

    Where the candidate is nearer or farther, connected pixels form regions; matched pixels and
    others are apart. A region gets the candidate if the frames correlate better along it, on
    average over the region. Windows that vary no more than noise count little. A pixel without a
    match that better matches hide in frame 1 counts as a usual pixel there.

    If a region gets the candidate, matched pixels of equal depth get it, too, since it is more
    exact there. A pixel that is hidden in frame 1 gets the farther one of both depths. A found
    depth that is not finite, behind the camera, or moves a pixel by more than the longer side is
    always replaced.
    """
    frame, camera = pyramid.frames0[0], pyramid.cameras[0]
    limit = GLOBAL.region_difference
    is_possible = (found >= -limit) & (found <= max(frame.shape))  # False for NaN
    found = np.where(is_possible, found, candidate)
    change = candidate - found
    valid = pyramid.valid0(0)
    weight = texture_weight(frame, half_variance=1.0, valid=valid)
    correlations = []
    for depth in (candidate, found):
        flow = depth_flow(depth, motion, camera)
        components = np.moveaxis(flow, -1, 0)
        if pyramid.masks is not None:
            weight = np.where(pyramid.masks.ignored_pixels(components, 0), 0, weight)
        seen = correlation(frame, pyramid.frames1[0], flow)
        correlations.append(np.where(leaves_image(components), np.float32(np.nan), seen))
    along_candidate, along_found = correlations
    gain = weight * _difference_of_correlations(along_candidate, along_found)
    is_better = _regions_with_gain(is_matched, change, gain)
    can_hide = is_matched & (is_better | (np.abs(change) <= limit))
    if valid is not None:
        can_hide &= valid
    is_behind = _hidden_pixels(candidate, motion, camera, can_hide)
    along_candidate = np.where(is_behind, np.float32(np.nan), along_candidate)
    gain = weight * _difference_of_correlations(along_candidate, along_found)
    is_better |= _regions_with_gain(~is_matched, change, gain)
    if is_better.any():
        is_better |= is_matched & (np.abs(change) <= limit)
        is_hidden = _hidden_pixels(np.where(is_better, candidate, found), motion, camera, valid)
        is_better = np.where(is_hidden, (candidate < found) & (candidate >= 0), is_better)
    return is_better | ~is_possible


def _regions_with_gain(
    part: np.ndarray,  # (H, W) bool: the pixels that may belong to a region
    change: np.ndarray,  # (H, W) float32: D of the candidate less D that was found
    gain: np.ndarray,  # (H, W) float32: of correlation
) -> np.ndarray:
    """Return the regions of nearer, and of farther, pixels with enough mean gain, (H, W) bool."""
    has_gain = np.zeros(part.shape, bool)
    for difference in (change, -change):
        is_region = part & (difference > GLOBAL.region_difference)
        _, labels = cv2.connectedComponents(is_region.astype(np.uint8), connectivity=4)
        sizes = np.bincount(labels.ravel())
        mean_gain = np.bincount(labels.ravel(), gain.ravel()) / np.maximum(sizes, 1)
        mean_gain[0] = 0  # pixels outside all regions
        has_gain |= mean_gain[labels] > GLOBAL.min_gain
    return has_gain


def _difference_of_correlations(
    # candidate, found: (H, W) float32: correlation along both depths, NaN outside frame 1, and
    # where a candidate is hidden there
    candidate: np.ndarray,
    found: np.ndarray,
) -> np.ndarray:  # (H, W) float32
    """Return by how much the candidate correlates better.

    A depth without a correlation can be neither confirmed nor refuted. It counts as the better
    depth of a usual pixel.
    """
    better = np.fmax(candidate, found)
    is_seen = np.isfinite(better)
    usual = np.median(better[is_seen]) if is_seen.any() else np.float32(0)
    first, second = (np.where(np.isnan(part), usual, part) for part in (candidate, found))
    difference: np.ndarray = first - second
    return difference


def _hidden_pixels(
    depth: np.ndarray,  # (H, W) float32: D
    motion: np.ndarray,
    camera: Camera,
    can_hide: np.ndarray | None,  # (H, W) bool: pixels that hide others; None for all
) -> np.ndarray:
    """Return the pixels of frame 0 that a nearer one hides in frame 1, (H, W) bool."""
    moved = move_pixels(depth, motion, camera)
    width = depth.shape[1]
    targets = moved.rows * width + moved.columns
    hides = moved.is_inside if can_hide is None else moved.is_inside & can_hide
    nearest = np.full(depth.size, -np.inf, np.float32)
    np.maximum.at(nearest, targets[hides], moved.depth[hides].astype(np.float32))
    # A surface that comes nearer is sampled with gaps of a pixel.
    closed = cv2.morphologyEx(
        nearest.reshape(depth.shape), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)
    )
    excess = np.asarray(closed).ravel()[targets] - moved.depth
    is_hidden: np.ndarray = moved.is_inside & (excess > GLOBAL.min_hidden_distance)
    return is_hidden
