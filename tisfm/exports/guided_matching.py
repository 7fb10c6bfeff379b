"""Where points of one frame are in another: predicted by depth and pose, measured in the images."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.checks import Floats
from tisfm.reconstruction.tracks.tracker import BORDER

# Of the search for the place where a point looks as before: pyramid levels above the frame itself.
WINDOW, LEVELS, ROUNDS, STEP = 13, 2, 20, 0.005
LEAST_GRADIENT = 1e-4  # of the window, in OpenCV's measure: below, nothing holds the point
RETURN = 0.3  # px: sought from there, a point comes back as near as this
FURTHEST = 10.0  # px, of 640 across, from where depth and pose lead: beyond is something else
ALIKE = 0.85  # correlation of what is around a point in both frames
PATCH = 11  # px across, of what is correlated
SMALL = 1e-6  # squared grey levels: there is nothing to correlate
LARGEST_STD = 0.15  # px: of a place, by what differs between the patches
BRIGHTNESS = 31  # px across, over which the mean brightness of both frames is made the same
SMOOTH, LARGEST_STEP = 9, 0.15  # px across, and the share by which depth there differs at most
NEAREST = 1e-6  # least Z, in depths of the point in the first frame, of what another frame sees


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A camera and where it stood.

    Attributes
    ----------
    camera : Camera
        A pinhole.
    matrix : (4, 4) float64
        Camera to world.
    """

    camera: Camera
    matrix: Floats


def measured(
    grey0: np.ndarray,
    grey1: np.ndarray,
    points: np.ndarray,
    inverse_depth: np.ndarray,
    pose0: Pose,
    pose1: Pose,
) -> np.ndarray:
    """Return where points of frame 0 are in frame 1, (N, 2) float64, NaN where they are not found.

    Frame 1 is resampled to what frame 0 would see by the depth. What is left of the motion of a
    point between the two is measured in their pixels, forward and backward, and frame 1 is where
    the resampled pixel was taken from. So depth leads to the place, and shapes the window, but the
    position is that of the image: an error of depth is undone by the measurement.

    Parameters
    ----------
    grey0, grey1 : (H, W) uint8
    points : (N, 2) float64
        (x, y) in frame 0, px from the upper left pixel's centre.
    inverse_depth : (H, W) float32
        Of frame 0; NaN where there is none.
    pose0, pose1 : Pose

    References
    ----------
    Bouguet, "Pyramidal implementation of the affine Lucas Kanade feature tracker", Intel 2001.
    Kalal, Mikolajczyk and Matas, "Forward-backward error", ICPR 2010, doi 10.1109/ICPR.2010.675.
    """
    height, width = grey0.shape
    nowhere = np.full((len(points), 2), np.nan)
    places = _places(inverse_depth, pose0, pose1)
    led = _sampled(places, points)
    seen = _inside(led, grey1.shape)
    if not seen.any():
        return nowhere
    x, y = cv2.split(places)
    moved = cv2.remap(grey1, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    moved = _as_bright(moved, grey0)
    begun = points[seen]
    near, found = _sought(grey0, moved, begun)
    back, returned = _sought(moved, grey0, near)
    limit = FURTHEST * max(height, width) / 640
    found &= returned & (np.hypot(*(back - begun).T) < RETURN)
    found &= np.hypot(*(near - begun).T) < limit
    found &= _inside(near, grey0.shape)
    there = np.full_like(near, np.nan)
    there[found] = _sampled(places, near[found])
    found &= _inside(there, grey1.shape)
    found[found] = are_held(grey0, moved, begun[found], near[found])
    there[~found] = np.nan
    nowhere[seen] = there
    return nowhere


def are_held(
    grey0: np.ndarray, grey1: np.ndarray, points0: np.ndarray, points1: np.ndarray
) -> np.ndarray:
    """Return of which points two frames show the same, and hold it in both directions, (N,) bool.

    What differs between the patches is taken for noise. Along the direction in which the frame
    changes least, it moves a point by its deviation over the length of the gradient there: beside
    an edge that is far, however alike the patches are.

    Parameters
    ----------
    grey0, grey1 : (H, W) uint8
    points0, points1 : (N, 2) float64
        The same points in both, px.
    """
    if not len(points0):
        return np.zeros(0, bool)
    first, second = _patches(grey0, points0), _patches(grey1, points1)
    power = (first**2).sum(axis=(1, 2))
    size = np.sqrt(power * (second**2).sum(axis=(1, 2)))
    correlation = (first * second).sum(axis=(1, 2)) / np.maximum(size, SMALL)
    noise = 2 * (1 - correlation) * power / PATCH**2  # of both together, contrast made the same
    down, across = np.gradient(first, axis=(1, 2))
    xx, xy, yy = ((a * b).sum(axis=(1, 2)) for a, b in ((across,) * 2, (across, down), (down,) * 2))
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    least -= PATCH**2 * noise / 4  # what noise adds to the squares of central differences
    return np.asarray((correlation > ALIKE) & (noise < LARGEST_STD**2 * least))


def is_smooth(inverse_depth: np.ndarray) -> np.ndarray:
    """Return where depth around a pixel is that of one surface, (H, W) bool."""
    known = np.nan_to_num(inverse_depth, nan=0.0, posinf=0.0, neginf=0.0)
    box = np.ones((SMOOTH, SMOOTH), np.uint8)
    most, least = cv2.dilate(known, box), cv2.erode(known, box)
    return np.asarray(most - least <= LARGEST_STEP * known)


def positions_of(
    points: np.ndarray, inverse_depth: np.ndarray, pose: Pose, shape: tuple[int, int]
) -> Floats:
    """Return the points of the world at pixels of a frame, (N, 3), by their inverse depth, (N,)."""
    rays = (points - pose.camera.center_for(*shape)) / pose.camera.focal
    local = np.column_stack([rays, np.ones(len(points))]) / inverse_depth[:, None]
    return np.asarray(local @ pose.matrix[:3, :3].T + pose.matrix[:3, 3])


def _places(inverse_depth: np.ndarray, pose0: Pose, pose1: Pose) -> np.ndarray:
    """Return where frame 1 sees the pixels of frame 0, (H, W, 2) float32; far outside if nowhere.

    Pixels without depth are taken to be at infinity.
    """
    height, width = inverse_depth.shape
    motion = np.linalg.inv(pose1.matrix) @ pose0.matrix
    cx, cy = pose0.camera.center_for(height, width)
    x = ((np.arange(width) - cx) / pose0.camera.focal).astype(np.float32)[None, :]
    y = ((np.arange(height) - cy) / pose0.camera.focal).astype(np.float32)[:, None]
    inverse = np.nan_to_num(inverse_depth, nan=0.0, posinf=0.0, neginf=0.0)
    rows = motion[:3].astype(np.float32)
    far = np.float32(-4 * (height + width))
    seen_x, seen_y, z = (row[0] * x + row[1] * y + row[2] + row[3] * inverse for row in rows)
    before = z > NEAREST
    z = np.where(before, z, 1)
    cx, cy = pose1.camera.center_for(height, width)
    focal = np.float32(pose1.camera.focal)
    places = [
        np.where(before, seen * (focal / z) + np.float32(center), far)
        for seen, center in ((seen_x, cx), (seen_y, cy))
    ]
    return np.asarray(cv2.merge([np.clip(place, far, -far) for place in places]))  # as OpenCV can


def _as_bright(moved: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return a frame with the mean brightness of another around every pixel, (H, W) uint8."""
    size = (BRIGHTNESS, BRIGHTNESS)
    first, second = (image.astype(np.float32) for image in (moved, grey))
    first += cv2.blur(second, size) - cv2.blur(first, size)
    return np.asarray(np.rint(first).clip(0, 255).astype(np.uint8))


def _sought(
    grey0: np.ndarray, grey1: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where points of frame 0 look as before in frame 1, near by, and whether any do."""
    if not len(points):
        return points, np.zeros(0, bool)
    begun = points.astype(np.float32)
    found, seen, _ = cv2.calcOpticalFlowPyrLK(
        grey0,
        grey1,
        begun,
        begun.copy(),
        winSize=(WINDOW, WINDOW),
        maxLevel=LEVELS,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ROUNDS, STEP),
        minEigThreshold=LEAST_GRADIENT,
    )
    return found.astype(np.float64), seen[:, 0] > 0


def _inside(points: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return which points lie in a frame, away from its border."""
    last = np.array([shape[1], shape[0]]) - 1 - BORDER
    return np.asarray(((points >= BORDER) & (points <= last)).all(axis=1))


def _patches(grey: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return what is around points, less its mean, (N, PATCH, PATCH) float32."""
    offsets = np.arange(PATCH, dtype=np.float32) - PATCH // 2
    dx, dy = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    x, y = (points[:, k, None].astype(np.float32) + d for k, d in enumerate((dx, dy)))
    patches = _remapped(grey, x, y).astype(np.float32)
    patches -= patches.mean(axis=1, keepdims=True)
    return np.asarray(patches.reshape(-1, PATCH, PATCH))


def _sampled(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (H, W, 2) values at points, bilinearly, (N, 2) float64."""
    if not len(points):
        return np.empty((0, 2))
    # OpenCV would round positions to 1/32 px, by which places far apart would be off.
    first = np.clip(np.floor(points), 0, (places.shape[1] - 2, places.shape[0] - 2)).astype(np.intp)
    (column, row), (x, y) = first.T, (points - first).T[..., None]
    above = (1 - x) * places[row, column] + x * places[row, column + 1]
    below = (1 - x) * places[row + 1, column] + x * places[row + 1, column + 1]
    return np.asarray((1 - y) * above + y * below)


def _remapped(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return an image at (N, M) positions, of any N: OpenCV takes 32767 rows at most."""
    few = 2**14
    parts = [
        cv2.remap(
            image, x[k : k + few], y[k : k + few], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        for k in range(0, len(x), few)
    ]
    return np.concatenate(parts)
