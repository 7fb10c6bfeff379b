"""Positions of points of one frame in another: predicted by depth and pose, measured in images.

The tracker of the reconstruction cannot replace this module: it follows points from frame to frame,
and its tracks end within tens of frames. Here depth and poses predict a point in distant keyframes.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.checks import Floats
from tisfm.reconstruction.tracks.settings import TRACKS

# Set by hand. The first five are parameters of the Lucas-Kanade search of OpenCV.
WINDOW_WIDTH = 13  # px, width of the window
PYRAMID_LEVELS = 2  # pyramid levels above the frame itself
MAX_ITERATIONS = 20
MIN_STEP = 0.005  # px: the search ends with a smaller step
MIN_EIGENVALUE = 1e-4  # bound of the smaller eigenvalue of the window, in the unit of OpenCV
MAX_RETURN_ERROR = 0.3  # px between a point and the match of its match in the first frame
MAX_CORRECTION = 10.0  # px between prediction and match, in frames of 640 px
MIN_CORRELATION = 0.85  # of the two patches around a match
PATCH_WIDTH = 11  # px, width of a patch
MIN_PATCH_POWER = 1e-6  # squared grey levels: a patch with less has no texture
MAX_MATCH_STD = 0.15  # px: standard deviation of a match, from the difference of the patches
BRIGHTNESS_WINDOW = 31  # px: within this window both frames get the same mean brightness
SURFACE_WINDOW = 9  # px: window around a point in which all pixels show one surface
MAX_DEPTH_STEP = 0.15  # relative difference of inverse depth in this window
MIN_DEPTH = 1e-6  # bound of Z of a visible point, as a share of its depth in the first frame


@dataclass(frozen=True, kw_only=True)
class PosedCamera:
    """A camera and its pose."""

    camera: Camera  # a pinhole
    matrix: Floats  # (4, 4) float64: camera to world


def measure_points(
    # grey0, grey1: (H, W) uint8
    grey0: np.ndarray,
    grey1: np.ndarray,
    # (N, 2) float64: (x, y) in frame 0, px from the centre of the upper left pixel
    points: np.ndarray,
    inverse_depth: np.ndarray,  # (H, W) float32: inverse depth of frame 0; NaN if unknown
    pose0: PosedCamera,
    pose1: PosedCamera,
) -> np.ndarray:
    """Return the positions in frame 1 of points of frame 0, (N, 2) float64; NaN if not found.

    Frame 1 is warped to frame 0 by depth and poses. The remaining motion of a point is measured
    between frame 0 and the warped frame, forward and backward; the warp then gives the position in
    frame 1. So depth predicts the position and shapes the window, but the result is measured in the
    images: the measurement corrects errors of depth.

    References
    ----------
    Bouguet, "Pyramidal implementation of the affine Lucas Kanade feature tracker", Intel 2001.
    Kalal, Mikolajczyk and Matas, "Forward-backward error", ICPR 2010, doi 10.1109/ICPR.2010.675.
    """
    height, width = grey0.shape
    result = np.full((len(points), 2), np.nan)
    warp = _warp(inverse_depth, pose0, pose1)
    predictions = _interpolate(warp, points)
    is_visible = _are_inside(predictions, grey1.shape)
    if not is_visible.any():
        return result
    x, y = cv2.split(warp)
    warped_frame = cv2.remap(grey1, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    warped_frame = _match_brightness(warped_frame, grey0)
    start = points[is_visible]
    matches, is_found = _match(grey0, warped_frame, start)
    returned_points, is_returned = _match(warped_frame, grey0, matches)
    limit = MAX_CORRECTION * max(height, width) / 640
    is_found &= is_returned & (np.hypot(*(returned_points - start).T) < MAX_RETURN_ERROR)
    is_found &= np.hypot(*(matches - start).T) < limit
    is_found &= _are_inside(matches, grey0.shape)
    positions = np.full_like(matches, np.nan)
    positions[is_found] = _interpolate(warp, matches[is_found])
    is_found &= _are_inside(positions, grey1.shape)
    is_found[is_found] = are_reliable(grey0, warped_frame, start[is_found], matches[is_found])
    positions[~is_found] = np.nan
    result[is_visible] = positions
    return result


def are_reliable(
    # grey0, grey1: (H, W) uint8
    grey0: np.ndarray,
    grey1: np.ndarray,
    # points0, points1: (N, 2) float64, the same points in both, px
    points0: np.ndarray,
    points1: np.ndarray,
) -> np.ndarray:
    """Return which matches have similar patches and an accurate position in both directions, (N,).

    The difference of the patches counts as noise. Noise moves a match by its standard deviation
    over the gradient. Along an edge the gradient is small: a match may be far off although the
    patches are similar.
    """
    if not len(points0):
        return np.zeros(0, bool)
    patches0, patches1 = _patches(grey0, points0), _patches(grey1, points1)
    power = (patches0**2).sum(axis=(1, 2))
    norm = np.sqrt(power * (patches1**2).sum(axis=(1, 2)))
    correlation = (patches0 * patches1).sum(axis=(1, 2)) / np.maximum(norm, MIN_PATCH_POWER)
    noise = 2 * (1 - correlation) * power / PATCH_WIDTH**2  # of both patches, after equal contrast
    down, across = np.gradient(patches0, axis=(1, 2))
    xx, xy, yy = ((a * b).sum(axis=(1, 2)) for a, b in ((across,) * 2, (across, down), (down,) * 2))
    min_eigenvalue = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    # minus the part that noise adds to the squares of central differences
    min_eigenvalue -= PATCH_WIDTH**2 * noise / 4
    return np.asarray((correlation > MIN_CORRELATION) & (noise < MAX_MATCH_STD**2 * min_eigenvalue))


def smooth_pixels(inverse_depth: np.ndarray) -> np.ndarray:
    """Return the pixels whose neighbourhood is one surface, (H, W) bool."""
    finite_inverse = np.nan_to_num(inverse_depth, nan=0.0, posinf=0.0, neginf=0.0)
    box = np.ones((SURFACE_WINDOW, SURFACE_WINDOW), np.uint8)
    largest, smallest = cv2.dilate(finite_inverse, box), cv2.erode(finite_inverse, box)
    return np.asarray(largest - smallest <= MAX_DEPTH_STEP * finite_inverse)


def points_in_world(
    points: np.ndarray, inverse_depth: np.ndarray, pose: PosedCamera, shape: tuple[int, int]
) -> Floats:
    """Return points in the world, (N, 3), from pixels (N, 2) of a frame and inverse depth (N,)."""
    rays = (points - pose.camera.center_for(*shape)) / pose.camera.focal
    local = np.column_stack([rays, np.ones(len(points))]) / inverse_depth[:, None]
    return np.asarray(local @ pose.matrix[:3, :3].T + pose.matrix[:3, 3])


def _warp(inverse_depth: np.ndarray, pose0: PosedCamera, pose1: PosedCamera) -> np.ndarray:
    """Return the positions in frame 1 of all pixels of frame 0, (H, W, 2) float32.

    Invisible points get positions far outside. Pixels without depth count as infinitely far.
    """
    height, width = inverse_depth.shape
    motion = np.linalg.inv(pose1.matrix) @ pose0.matrix
    cx, cy = pose0.camera.center_for(height, width)
    x = ((np.arange(width) - cx) / pose0.camera.focal).astype(np.float32)[None, :]
    y = ((np.arange(height) - cy) / pose0.camera.focal).astype(np.float32)[:, None]
    inverse = np.nan_to_num(inverse_depth, nan=0.0, posinf=0.0, neginf=0.0)
    rows = motion[:3].astype(np.float32)
    outside_position = np.float32(-4 * (height + width))
    moved_x, moved_y, z = (row[0] * x + row[1] * y + row[2] + row[3] * inverse for row in rows)
    in_front = z > MIN_DEPTH
    z = np.where(in_front, z, 1)
    cx, cy = pose1.camera.center_for(height, width)
    focal = np.float32(pose1.camera.focal)
    warp = [
        np.where(in_front, position * (focal / z) + np.float32(center), outside_position)
        for position, center in ((moved_x, cx), (moved_y, cy))
    ]
    # OpenCV needs a limited range.
    warp = [np.clip(position, outside_position, -outside_position) for position in warp]
    return np.asarray(cv2.merge(warp))


def _match_brightness(warped_frame: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return a frame with the local mean brightness of another, (H, W) uint8."""
    size = (BRIGHTNESS_WINDOW, BRIGHTNESS_WINDOW)
    result, target = (image.astype(np.float32) for image in (warped_frame, grey))
    result += cv2.blur(target, size) - cv2.blur(result, size)
    return np.asarray(np.rint(result).clip(0, 255).astype(np.uint8))


def _match(
    grey0: np.ndarray, grey1: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the matches of points of frame 0 in frame 1, near the same position, and success."""
    if not len(points):
        return points, np.zeros(0, bool)
    start = points.astype(np.float32)
    matches, status, _ = cv2.calcOpticalFlowPyrLK(
        grey0,
        grey1,
        start,
        start.copy(),
        winSize=(WINDOW_WIDTH, WINDOW_WIDTH),
        maxLevel=PYRAMID_LEVELS,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, MAX_ITERATIONS, MIN_STEP),
        minEigThreshold=MIN_EIGENVALUE,
    )
    return matches.astype(np.float64), status[:, 0] > 0


def _are_inside(points: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return which points lie in a frame, away from its border."""
    last = np.array([shape[1], shape[0]]) - 1 - TRACKS.border
    return np.asarray(((points >= TRACKS.border) & (points <= last)).all(axis=1))


def _patches(grey: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return patches around points minus their means, (N, PATCH_WIDTH, PATCH_WIDTH) float32."""
    offsets = np.arange(PATCH_WIDTH, dtype=np.float32) - PATCH_WIDTH // 2
    dx, dy = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    x, y = (points[:, k, None].astype(np.float32) + d for k, d in enumerate((dx, dy)))
    patches = _remap_in_batches(grey, x, y).astype(np.float32)
    patches -= patches.mean(axis=1, keepdims=True)
    return np.asarray(patches.reshape(-1, PATCH_WIDTH, PATCH_WIDTH))


def _interpolate(warp: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Interpolate a map, (H, W, 2), at points bilinearly, (N, 2) float64."""
    if not len(points):
        return np.empty((0, 2))
    # OpenCV would round positions to 1/32 px, an error where the map changes fast.
    first = np.clip(np.floor(points), 0, (warp.shape[1] - 2, warp.shape[0] - 2)).astype(np.intp)
    (column, row), (x, y) = first.T, (points - first).T[..., None]
    above = (1 - x) * warp[row, column] + x * warp[row, column + 1]
    below = (1 - x) * warp[row + 1, column] + x * warp[row + 1, column + 1]
    return np.asarray((1 - y) * above + y * below)


def _remap_in_batches(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return an image at (N, M) positions, for any N: OpenCV accepts at most 32767 rows."""
    rows = 2**14
    parts = [
        cv2.remap(
            image,
            x[k : k + rows],
            y[k : k + rows],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for k in range(0, len(x), rows)
    ]
    return np.concatenate(parts)
