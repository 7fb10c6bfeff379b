"""Depth from a flow in two stages: the motion of the camera, then triangulation.

An essential matrix by random sampling (OpenCV's USAC, MAGSAC) gives the motion.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.camera import Camera

CORRESPONDENCES = 4800  # on a regular grid, about
CONFIDENCE = 0.9999  # of the random sampling
ITERATIONS = 10_000  # of the random sampling, at most
FEWEST_CORRESPONDENCES = 5  # for a sample


class NoMotion(ValueError):  # noqa: N818 (an outcome, not an error)
    """No essential matrix was found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TwoStage:
    """Result of the two stages after a flow.

    Attributes
    ----------
    pose : (4, 4) float64
        P₁ = R P₀ + t, with ‖t‖ = 1 unless it was given.
    inverse_depth : (H, W) float64
        As triangulated, signed, in units of 1/‖t‖.
    """

    pose: NDArray
    inverse_depth: NDArray


def two_stage(
    flow: NDArray, camera: Camera, *, threshold: float, pose: ArrayLike | None = None
) -> TwoStage:
    """Return pose and depth from a flow.

    Parameters
    ----------
    flow : (H, W, 2) array
        px/frame. Not modified.
    camera : Camera
        Without distortion.
    threshold : float
        Distance from the epipolar line up to which a correspondence may be an inlier, px.
    pose : (4, 4) array, optional
        The motion, if it is known: then only depth is triangulated.

    Returns
    -------
    TwoStage

    Raises
    ------
    NoMotion
        A ValueError: if there are too few correspondences, or no essential matrix fits them.
    """
    if pose is not None:
        motion = np.array(pose, np.float64)
        return TwoStage(pose=motion, inverse_depth=triangulated(flow, camera, motion))
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = _relative_pose(flow, camera, threshold)
    inverse_depth = triangulated(flow, camera, motion)
    if np.mean(inverse_depth > 0) < 0.5:  # an essential matrix does not determine the sign of t
        motion[:3, 3] *= -1
        inverse_depth = -inverse_depth
    return TwoStage(pose=motion, inverse_depth=inverse_depth)


def triangulated(flow: NDArray, camera: Camera, pose: NDArray) -> NDArray[np.float64]:
    """Return the inverse depth at which every point moves nearest to the end of its flow.

    Parameters
    ----------
    flow : (H, W, 2) array
        px/frame. Not modified.
    camera : Camera
        Without distortion.
    pose : (4, 4) array
        P₁ = R P₀ + t.

    Returns
    -------
    (H, W) float64
        Signed, in units of 1/‖t‖; 0 at the epipole.
    """
    height, width = flow.shape[:2]
    cx, cy = camera.center_for(height, width)
    x = (np.arange(width) - cx) / camera.focal
    y = (np.arange(height)[:, None] - cy) / camera.focal
    x1, y1 = x + flow[..., 0] / camera.focal, y + flow[..., 1] / camera.focal
    # R x̂₀ + d t has the direction (x̂₁, ŷ₁, 1): two equations, linear in d.
    turned_x, turned_y, turned_z = (row[0] * x + row[1] * y + row[2] for row in pose[:3, :3])
    tx, ty, tz = pose[:3, 3]
    slope_x, slope_y = tx - x1 * tz, ty - y1 * tz
    rest_x, rest_y = x1 * turned_z - turned_x, y1 * turned_z - turned_y
    square = slope_x**2 + slope_y**2
    inverse_depth = np.zeros((height, width))
    np.divide(slope_x * rest_x + slope_y * rest_y, square, out=inverse_depth, where=square > 0)
    return inverse_depth


def _relative_pose(flow: NDArray, camera: Camera, threshold: float) -> tuple[NDArray, NDArray]:
    """Return R and t, ‖t‖ = 1 and of either sign, of the essential matrix of a flow."""
    height, width = flow.shape[:2]
    stride = max(1, round((height * width / CORRESPONDENCES) ** 0.5))
    rows, columns = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    start = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
    end = start + flow[rows.ravel(), columns.ravel()]
    seen = ((end >= 0) & (end <= (width - 1, height - 1))).all(axis=1)
    if np.count_nonzero(seen) < FEWEST_CORRESPONDENCES:
        raise NoMotion(f"only {np.count_nonzero(seen)} of {len(seen)} points stay in the image")
    cx, cy = camera.center_for(height, width)
    intrinsic = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1.0]])
    essential, _ = cv2.findEssentialMat(
        start[seen],
        end[seen],
        intrinsic,
        method=cv2.USAC_MAGSAC,
        prob=CONFIDENCE,
        threshold=threshold,
        maxIters=ITERATIONS,
    )
    if essential is None or essential.shape[0] < 3 or not np.isfinite(essential).all():
        raise NoMotion(f"no essential matrix was found at a threshold of {threshold:g} px")
    first, second, direction = cv2.decomposeEssentialMat(essential[:3])
    # The two rotations differ by half a turn about t; frames are close in time.
    smaller = first if np.trace(first) > np.trace(second) else second
    return np.asarray(smaller, np.float64), np.asarray(direction, np.float64).ravel()
