"""Matched SIFT points of two frames, for displacements of any size."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm import runtime
from tisfm.motion.settings import SPARSE
from tisfm.threads import start_in_second_thread


@dataclass(frozen=True, kw_only=True)
class Matches:
    """Points of frame 0 and their matches in frame 1, px from the upper left pixel's centre."""

    # points0, points1: (N, 2) float64, (x, y)
    points0: np.ndarray
    points1: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Features:
    """Points of a frame and their descriptors."""

    points: np.ndarray  # (N, 2) float64: (x, y), px from the upper left pixel's centre
    # (N, 128) float32: square roots of the descriptors after their normalisation to sum 1
    roots: np.ndarray


def sparse_matches(
    # frame0, frame1: (H, W) float32, grey levels on any scale
    frame0: np.ndarray,
    frame1: np.ndarray,
    # tuple of two (H, W) bool: pixels of each frame whose points are matched, by default all
    valid: tuple[np.ndarray, np.ndarray] | None = None,
) -> Matches:  # always the same for the same frames; possibly none
    """Find points that look alike in two frames.

    Detected points are thinned out where they are dense, so a textured corner does not dominate.
    Descriptors are compared by the Hellinger distance (RootSIFT). The descriptors of the two
    points of a match are nearest to each other, and clearly nearer than the second nearest one.

    References
    ----------
    Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004,
    doi 10.1023/B:VISI.0000029664.99615.94; Arandjelović and Zisserman, "Three things everyone
    should know to improve object retrieval", CVPR 2012, doi 10.1109/CVPR.2012.6248018.
    """
    low, high = np.percentile(frame0, SPARSE.grey_percentiles)
    no_matches = Matches(points0=np.empty((0, 2)), points1=np.empty((0, 2)))
    if not high > low:
        return no_matches
    images = [np.clip((frame - low) * (255 / (high - low)), 0, 255) for frame in (frame0, frame1)]
    wait_for_second = (
        start_in_second_thread(detect_features, images[1]) if runtime.threads() > 1 else None
    )
    first = detect_features(images[0])
    second = wait_for_second() if wait_for_second is not None else detect_features(images[1])
    if valid is not None:
        first, second = map(_select_features, (first, second), valid)
    index0, index1 = match_features(first, second)
    pairs = np.hstack([first.points[index0], second.points[index1]])
    pairs = np.unique(pairs, axis=0)  # a point with several orientations has several descriptors
    return Matches(points0=pairs[:, :2], points1=pairs[:, 2:])


def match_features(first: Features, second: Features) -> tuple[np.ndarray, np.ndarray]:
    """Return indices of points of two frames that look alike, (N,) and (N,), in order."""
    if min(len(first.points), len(second.points)) < 2:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    products = first.roots @ second.roots.T
    forward, is_clear = _nearest_descriptors(products)
    backward, is_clear_back = _nearest_descriptors(products.T)
    index = np.arange(len(first.points))
    is_match = is_clear & is_clear_back[forward] & (backward[forward] == index)
    return index[is_match], forward[is_match]


def detect_features(frame: np.ndarray, *, per_cell: int = SPARSE.points_per_cell) -> Features:
    """Detect and describe points of a frame, (H, W) float32 with grey levels in [0, 255]."""
    detector = cv2.SIFT.create(contrastThreshold=SPARSE.min_contrast)
    image = np.rint(frame).astype(np.uint8)
    # Describing all points is faster than building a second pyramid for the kept points.
    keypoints, descriptors = detector.detectAndCompute(image, None)
    if not keypoints:
        return Features(points=np.empty((0, 2)), roots=np.empty((0, 128), np.float32))
    points = np.array([point.pt for point in keypoints])
    strength = np.array([point.response for point in keypoints])
    side = (frame.size / SPARSE.cells**2) ** 0.5
    strongest = _strongest_per_cell(points, strength, side=side, max_per_cell=per_cell)
    descriptors = descriptors[strongest]
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1)  # entries are not negative
    return Features(points=points[strongest], roots=np.sqrt(descriptors / total))


def _select_features(features: Features, valid: np.ndarray) -> Features:
    """Return the features at used pixels."""
    column, row = np.rint(features.points).astype(np.intp).T
    height, width = valid.shape
    is_valid = valid[row.clip(0, height - 1), column.clip(0, width - 1)]
    return Features(points=features.points[is_valid], roots=features.roots[is_valid])


def _strongest_per_cell(
    points: np.ndarray, response: np.ndarray, *, side: float, max_per_cell: int
) -> np.ndarray:
    """Return the indices of the strongest points of every square with this side, in order."""
    column, row = (points // side).astype(np.int64).T
    cell = row * (column.max() + 1) + column
    order = np.lexsort((-response, cell))
    first = np.searchsorted(cell[order], cell[order])  # start of each point's cell
    is_strong = np.arange(len(order)) - first < max_per_cell
    return np.sort(order[is_strong])


def _nearest_descriptors(similarities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the most similar column of each row, and whether the next is clearly less similar."""
    values = np.array(similarities, order="C")
    rows = np.arange(len(values))
    nearest = values.argmax(axis=1)
    # The squared distance of vectors of length 1 is 2 − 2 cos.
    distance = 1 - values[rows, nearest]
    values[rows, nearest] = -np.inf
    second_distance = 1 - values.max(axis=1)
    return nearest, distance < SPARSE.max_descriptor_ratio**2 * second_distance
