"""Pixels of a pair that are fixed on the sensor, although the camera moves: a bonnet, a logo."""

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.camera_settings import FIXED
from tisfm.motion.epipolar_fit import Pose, Rays, length, nearest_points, rotation_residual
from tisfm.status import Status
from tisfm.visibility.confidence import median


def find_fixed_pixels(
    # frame0, frame1: (h, w) float32, grey levels
    frame0: np.ndarray,
    frame1: np.ndarray,
    camera: Camera,  # pinhole camera of the frames
    rotation: np.ndarray,  # (3, 3): of the motion that most of the flow shows
    translation: np.ndarray | None,  # (3,), of length 1; None if the camera only turned
    flow: np.ndarray,  # (h, w, 2) float32: px/frame
    residual: float,  # px: robust deviation of the flow from epipolar lines
) -> np.ndarray | None:  # (h, w) bool
    """Return the pixels that show the same in both frames although they have to move, or None.

    A textured pixel is at rest if its neighbourhood differs by less than a small shift would cause.
    It is fixed if the motion lets no point in front of the camera stay there. Points at infinity
    may stay if the camera only translates. Then only regions at the lower border count as fixed:
    what is at rest below moving parts is a bonnet rather than the horizon.
    """
    window = (FIXED.window, FIXED.window)
    change = cv2.blur(cv2.absdiff(frame0, frame1), window)
    slopes = (cv2.Sobel(frame0, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    slope = cv2.blur(cv2.magnitude(*slopes), window)
    is_textured = slope > FIXED.min_slope
    is_at_rest = is_textured & (change < FIXED.max_shift * slope)
    textured_count, resting_count = (np.count_nonzero(m) for m in (is_textured, is_at_rest))
    if not FIXED.min_share * textured_count < resting_count < FIXED.max_share * textured_count:
        return None
    height, width = frame0.shape
    rows, columns = np.nonzero(is_at_rest)
    positions = _normalised(rows, columns, camera, frame0.shape)
    resting = Rays(
        rays0=np.vstack([positions, np.ones(len(rows))]),
        rays1=positions,
        trust=np.ones(len(rows)),
        focal=camera.focal,
    )
    distance = camera.focal * length(rotation_residual(resting, rotation))
    if translation is not None:
        points = nearest_points(resting, rotation, translation)
        distance = np.where(points.inverse_depth > 0, np.abs(points.distance), distance)
    limit = max(FIXED.min_distance, FIXED.min_deviations * residual)
    fixed = np.zeros((height, width), np.uint8)
    is_fixed = distance > limit
    fixed[rows[is_fixed], columns[is_fixed]] = 1
    if translation is not None:
        fixed |= _at_lower_border(is_at_rest, camera, (rotation, translation), flow)
    if np.count_nonzero(fixed) < FIXED.min_share * textured_count:
        return None
    closed = cv2.morphologyEx(
        np.pad(fixed, FIXED.gap, mode="edge"), cv2.MORPH_CLOSE, np.ones((FIXED.gap,) * 2, np.uint8)
    )[FIXED.gap : -FIXED.gap, FIXED.gap : -FIXED.gap]
    mask = np.asarray(cv2.dilate(closed, np.ones(window, np.uint8)) > 0)
    return None if mask.mean() > FIXED.max_share else mask


def _normalised(
    rows: np.ndarray, columns: np.ndarray, camera: Camera, shape: tuple[int, int]
) -> np.ndarray:
    """Return normalised coordinates of pixels, (2, N) float64."""
    cx, cy = camera.center_for(*shape)
    return np.stack([columns - cx, rows - cy]) / camera.focal


def _at_lower_border(
    is_at_rest: np.ndarray, camera: Camera, pose: Pose, flow: np.ndarray
) -> np.ndarray:
    """Return the regions at rest that touch the lower border, (h, w) uint8.

    A region counts if points of the frame's typical depth would move there, and if the flow just
    above it moves.
    """
    height, width = is_at_rest.shape
    kernel = np.ones((FIXED.gap, FIXED.gap), np.uint8)
    closed = cv2.morphologyEx(is_at_rest.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    count, regions, statistics, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    found = np.zeros((height, width), np.uint8)
    step = FIXED.flow_step
    rows, columns = (values.ravel() for values in np.mgrid[:height:step, :width:step])
    positions = _normalised(rows, columns, camera, is_at_rest.shape)
    moving = Rays(
        rays0=np.vstack([positions, np.ones(len(rows))]),
        rays1=positions + flow[rows, columns].T / camera.focal,
        trust=np.ones(len(rows)),
        focal=camera.focal,
    )
    depth = median(nearest_points(moving, *pose).inverse_depth)
    for number in range(1, count):
        left, top, region_width, region_height, area = statistics[number]
        if top + region_height < height - FIXED.border or area < FIXED.min_area * closed.size:
            continue
        region = (regions == number) & is_at_rest
        region_rows, region_columns = np.nonzero(region)
        seen = _normalised(region_rows, region_columns, camera, is_at_rest.shape)
        rays = np.vstack([seen, np.ones(len(region_rows))])
        moved = pose[0] @ rays + depth * pose[1][:, None]
        expected = camera.focal * median(length(moved[:2] / moved[2] - seen))
        above = flow[max(top - FIXED.gap, 0) : max(top, 1), left : left + region_width]
        speed = median(np.hypot(above[..., 0], above[..., 1]).ravel())
        if min(expected, speed) > FIXED.min_motion:
            found[region] = 1
    return found


def resize_mask(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a mask of a coarser level, (h, w) bool, with the shape of the frame, (H, W)."""
    size = shape[::-1]
    return cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0


def with_fixed_note(status: Status, fixed: np.ndarray) -> Status:
    """Return a status whose message names the pixels that are fixed on the sensor, (H, W) bool."""
    return Status(
        status,
        f"{status.message}. {100 * fixed.mean():.0f}% of the frame is fixed on the sensor, as a "
        "bonnet or a logo is; it was ignored, and its depth is unknown",
    )
