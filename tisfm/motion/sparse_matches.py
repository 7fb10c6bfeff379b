"""Points of two frames that look alike, however far apart they lie: SIFT, matched."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm import runtime
from tisfm.second_thread import beside

# Of the detector: rooms have few points, and faint ones; matching leaves out what is not alike.
CONTRAST = 0.01
LARGEST = 2**20  # pixels: a larger frame is matched on a coarser level
CELLS = 16  # a side of the frame, by area: each keeps its strongest points
PER_CELL = 30
RATIO = 0.8  # of the distances of the nearest descriptor and of the next
RANGE = (0.5, 99.5)  # percentiles of frame 0 that become 0 and 255


@dataclass(frozen=True, kw_only=True)
class Matches:
    """Points of frame 0 and where they are in frame 1, px from the upper left pixel's centre.

    Attributes
    ----------
    before, after : (N, 2) float64
        (x, y).
    """

    before: np.ndarray
    after: np.ndarray


def sparse_matches(frame0: np.ndarray, frame1: np.ndarray) -> Matches:
    """Find points that look alike in two frames.

    Detected points are thinned out where they are dense, so that a textured corner does not
    outvote the rest. Descriptors are compared by the Hellinger distance (RootSIFT). A match is the
    nearest of each other, and clearly nearer than the next.

    Parameters
    ----------
    frame0, frame1 : (H, W) float32
        Grey levels on any scale.

    Returns
    -------
    Matches
        The same every time, and possibly none.

    References
    ----------
    Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004,
    doi 10.1023/B:VISI.0000029664.99615.94; Arandjelović and Zisserman, "Three things everyone
    should know to improve object retrieval", CVPR 2012, doi 10.1109/CVPR.2012.6248018.
    """
    low, high = np.percentile(frame0, RANGE)
    nothing = Matches(before=np.empty((0, 2)), after=np.empty((0, 2)))
    if not high > low:
        return nothing
    scaled = [np.clip((frame - low) * (255 / (high - low)), 0, 255) for frame in (frame0, frame1)]
    other = beside(_described, scaled[1]) if runtime.threads() > 1 else None
    points0, root0 = _described(scaled[0])
    points1, root1 = other() if other is not None else _described(scaled[1])
    if min(len(points0), len(points1)) < 2:
        return nothing
    alike = root0 @ root1.T
    forward, clear = _nearest(alike)
    backward, clear_back = _nearest(alike.T)
    index = np.arange(len(points0))
    taken = clear & clear_back[forward] & (backward[forward] == index)
    pairs = np.hstack([points0[taken], points1[forward[taken]]])
    pairs = np.unique(pairs, axis=0)  # a point has several descriptors if it has several directions
    return Matches(before=pairs[:, :2], after=pairs[:, 2:])


def _described(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points, (N, 2) float64, px, and the roots of their descriptors, (N, 128) float32."""
    detector = cv2.SIFT.create(contrastThreshold=CONTRAST)
    image = np.rint(frame).astype(np.uint8)
    # Descriptors of all take less time than a second pyramid for those that are kept.
    found, descriptors = detector.detectAndCompute(image, None)
    if not found:
        return np.empty((0, 2)), np.empty((0, 128), np.float32)
    points = np.array([point.pt for point in found])
    strength = np.array([point.response for point in found])
    kept = _spread(points, strength, side=(frame.size / CELLS**2) ** 0.5)
    descriptors = descriptors[kept]
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1)  # they have no negative entries
    return points[kept], np.sqrt(descriptors / total)


def _spread(points: np.ndarray, response: np.ndarray, *, side: float) -> np.ndarray:
    """Return the indices of the strongest points of every square of this side, in order."""
    column, row = (points // side).astype(np.int64).T
    cell = row * (column.max() + 1) + column
    order = np.lexsort((-response, cell))
    first = np.searchsorted(cell[order], cell[order])  # where the cell of each begins
    strongest = np.arange(len(order)) - first < PER_CELL
    return np.sort(order[strongest])


def _nearest(alike: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each row, the most alike column, and whether the next is clearly less alike."""
    rows = np.arange(len(alike))
    best = alike.argmax(axis=1)
    next_two = np.partition(alike, -2, axis=1)[:, -2:]
    # Of vectors of length 1, the squared distance is 2 − 2 cos.
    nearest, following = 1 - alike[rows, best], 1 - next_two[:, 0]
    return best, nearest < RATIO**2 * following
