"""Choice of the neighbour frames that give the depth of a keyframe."""

from collections.abc import Sequence

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.geometry.rays import pinhole_rays


def choose_neighbours(
    # (N, 4, 4) float64: camera to world. A frame without a pose has NaN and is never chosen.
    poses: np.ndarray,
    key: int,  # number of the keyframe
    # (H, W) array or float: a rough inverse depth of the keyframe, 1/unit of the poses. The median
    # replaces values that are not finite or not positive.
    inverse_depth: np.ndarray | float,
    camera: Camera,  # a pinhole
    shape: tuple[int, int],  # height and width of the frames, px
    *,
    max_count: int = 4,  # largest number of chosen frames
    # Height and width of the uncropped frames, px, if the frames are crops. Parallax is a share of
    # this width.
    uncropped_shape: tuple[int, int] | None = None,
) -> list[int]:  # numbers of the chosen frames, the best first
    """Choose frames with good parallax for each part of a keyframe, from both sides.

    The value of a frame for a point is s = min(1, p/p₁) min(1, p₂/p), where p is the parallax of
    the point; s is 0 outside the frame. Frames are chosen greedily: each time the frame that adds
    most to Σ √S over all points and both sides. S is the sum of s over the chosen frames in which
    the point moves to one side along its epipolar line. The sides have separate sums, since a
    surface that is hidden from one side may be visible from the other side.

    Raises ValueError if the keyframe has no pose or no known depth.
    """
    candidates = _Candidates(poses, key, inverse_depth, camera, shape, uncropped_shape)
    weights = np.full(candidates.values.shape[1], 1 / candidates.values.shape[1])
    return candidates.choose(candidates.values, weights, max_count)


def choose_neighbours_of_unmatched(
    # as for `choose_neighbours`
    poses: np.ndarray,
    key: int,
    inverse_depth: np.ndarray | float,
    camera: Camera,
    shape: tuple[int, int],
    *,
    first: Sequence[int],  # frames in which the keyframe was matched
    is_unmatched: np.ndarray,  # (h, w) bool: cells of the keyframe without a match
    max_count: int = 4,
    uncropped_shape: tuple[int, int] | None = None,
) -> list[int]:  # their numbers, the best first; empty if no frames are clearly better
    """Choose frames for the part of a keyframe that has no matches in the first frames.

    On a drive, a far background fills most of a frame, and asks for frames so far apart that the
    road below the camera is no longer in them, or looks different there. The value s of a frame for
    a point is multiplied by min(1, log q / |log r|)², where r is the ratio of the distances of the
    point from both cameras, and q is `DEPTH.max_distance_ratio`. Points have the weight of the
    unmatched cells around them. The benefit of a set of frames is the weighted mean of √Σs, for
    both sides together. At least two frames are chosen, so that one match confirms the other.

    Raises ValueError if the keyframe has no pose or no known depth, or no cell is unmatched.
    """
    if not is_unmatched.any():
        raise InputError("is_unmatched is False everywhere: expected a cell without a match")
    candidates = _Candidates(poses, key, inverse_depth, camera, shape, uncropped_shape)
    share = cv2.resize(
        is_unmatched.astype(np.float32), DEPTH.parallax_grid[::-1], interpolation=cv2.INTER_AREA
    )
    weights = (share / share.sum()).ravel().astype(np.float64)
    values = candidates.values * candidates.likeness()
    chosen = candidates.choose(values, weights, max_count)
    benefit, first_benefit = (
        float(np.sqrt(values[np.isin(candidates.frames, frames)].sum(axis=0)) @ weights)
        for frames in (chosen, list(first))
    )
    is_better = len(chosen) > 1 and benefit >= DEPTH.min_benefit_ratio * first_benefit
    return chosen if is_better else []


class _Candidates:
    """Frames with poses, and their parallax at a grid of points of the keyframe."""

    def __init__(
        self,
        poses: np.ndarray,
        key: int,
        inverse_depth: np.ndarray | float,
        camera: Camera,
        shape: tuple[int, int],
        uncropped_shape: tuple[int, int] | None,
    ) -> None:
        poses = np.asarray(poses, np.float64)
        if not np.isfinite(poses[key]).all():
            raise InputError(f"poses[{key}] is not finite: expected a pose of the keyframe")
        self._rays, self._inverse_depths = _grid_points(inverse_depth, camera, shape)
        has_pose = np.isfinite(poses).all(axis=(1, 2))
        has_pose[key] = False
        self.frames = np.flatnonzero(has_pose)  # (J,) int64: numbers of the frames
        self._motions = np.linalg.inv(poses[self.frames]) @ poses[key]
        # (J, P): how well the frames show the points; and (J, 2, P): the directions of parallax
        self.values, self._directions = _parallax_values(
            self._motions,
            self._rays,
            self._inverse_depths,
            camera,
            shape,
            (uncropped_shape or shape)[1],
        )

    def likeness(self) -> np.ndarray:
        """Return how alike points look in the frames (J, P): 1 at about the same distance.

        A ratio of the distances scales the image of a point in both directions, so it counts twice.
        """
        rotations, translations = self._motions[:, :3, :3], self._motions[:, :3, 3:]
        points = rotations @ self._rays + self._inverse_depths * translations
        ratio = np.linalg.norm(points, axis=1) / np.linalg.norm(self._rays, axis=0)
        change = np.abs(np.log(np.maximum(ratio, MIN_DIVISOR)))
        limit = np.log(DEPTH.max_distance_ratio)
        return np.asarray(np.minimum(1, limit / np.maximum(change, MIN_DIVISOR)) ** 2)

    def choose(
        self,
        values: np.ndarray,  # (J, P)
        weights: np.ndarray,  # (P,): weights of the points, with the sum 1
        max_count: int,
    ) -> list[int]:
        """Return the numbers of the chosen frames, the best first."""
        chosen: list[int] = []
        sums = np.zeros((2, values.shape[1]))
        reference = None
        for _ in range(min(max_count, len(values))):
            same_side = np.ones(values.shape, bool)
            if reference is not None:
                same_side = np.einsum("jkp,kp->jp", self._directions, reference) >= 0
            gains = np.zeros(len(values))
            for is_same, side_sums in zip((same_side, ~same_side), sums, strict=True):
                gains += (np.sqrt(side_sums + values * is_same) - np.sqrt(side_sums)) @ weights
            gains[chosen] = 0
            best = int(np.argmax(gains))
            if gains[best] < DEPTH.min_gain:
                break
            for is_same, side_sums in zip((same_side, ~same_side), sums, strict=True):
                side_sums += values[best] * is_same[best]
            if reference is None:
                reference = self._directions[best].copy()
            has_no_reference = ~reference.any(axis=0)
            reference[:, has_no_reference] = self._directions[best][:, has_no_reference]
            chosen.append(best)
        return [int(self.frames[j]) for j in chosen]


def _grid_points(
    inverse_depth: np.ndarray | float, camera: Camera, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays (3, P) of a grid of image points, and their inverse depth (P,)."""
    rows, columns = (
        ((np.arange(count) + 0.5) * length / count - 0.5)
        for count, length in zip(DEPTH.parallax_grid, shape, strict=True)
    )
    depth_map = np.broadcast_to(np.asarray(inverse_depth, np.float64), shape)
    inverse_depths = depth_map[np.ix_(rows.astype(int), columns.astype(int))].ravel()
    valid = np.isfinite(inverse_depths) & (inverse_depths > 0)
    if not valid.any():
        raise InputError("inverse_depth is nowhere positive: expected a rough depth of the frame")
    inverse_depths = np.where(valid, inverse_depths, np.median(inverse_depths[valid]))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return np.ascontiguousarray(pinhole_rays(points, camera, shape).T), inverse_depths


def _parallax_values(
    motions: np.ndarray,  # (J, 4, 4): from the keyframe to each frame
    rays: np.ndarray,  # (3, P)
    inverse_depths: np.ndarray,  # (P,)
    camera: Camera,
    shape: tuple[int, int],
    uncropped_width: int,  # px
) -> tuple[np.ndarray, np.ndarray]:
    """Return how well candidates show points (J, P), and the directions of parallax (J, 2, P).

    Parallax is a share of `uncropped_width`.
    """
    height, width = shape
    cx, cy = camera.center_for(height, width)
    rotated_rays = motions[:, :3, :3] @ rays
    points = rotated_rays + inverse_depths * motions[:, :3, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        positions = camera.focal * points[:, :2] / points[:, 2:]
        displacement = positions - camera.focal * rotated_rays[:, :2] / rotated_rays[:, 2:]
        u, v = cx + positions[:, 0], cy + positions[:, 1]
        is_inside = (points[:, 2] > 0) & (rotated_rays[:, 2] > 0)
        is_inside &= (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    displacement = np.where(is_inside[:, None], displacement, 0)
    parallax = np.hypot(displacement[:, 0], displacement[:, 1]) / uncropped_width
    values = np.minimum(1, parallax / DEPTH.full_parallax) * np.minimum(
        1, DEPTH.max_parallax / np.maximum(parallax, 1e-9)
    )
    direction = displacement / np.maximum(uncropped_width * parallax, 1e-9)[:, None]
    return values * is_inside, direction
