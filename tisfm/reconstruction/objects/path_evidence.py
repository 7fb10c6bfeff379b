"""Evidence from the camera path: one depth has to fit many frames, and to lie above the ground.

In two frames, an object that moves along epipolar lines looks like static points at another depth.
Over many frames, such a motion hardly ever fits one depth. An object that drives ahead of a vehicle
moves along the same lines as the camera: in any number of frames it looks like a static object that
is farther away. But the object stands on the ground. The apparent depth of a pixel is the depth
of a static point with the image motion of the pixel. If the apparent depth of an object lies below
the ground, and the object hides points nearer than its apparent depth, then the object moves.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.objects.candidates import smallest_object
from tisfm.reconstruction.frames.image_motion import ChainedFlow, ImageMotion, sample_image
from tisfm.reconstruction.geometry.rays import pinhole_rays
from tisfm.reconstruction.objects.motion_evidence import (
    Evidence,
    StaticMotion,
    evidence_of_error,
    grey_difference,
    support_of_motion,
)
from tisfm.reconstruction.objects.settings import OBJECTS


def path_evidence(
    motion: ImageMotion,
    frame: int,
    # sequence of (4, 4) array or None: camera to world, of every frame, in one scale; None for a
    # frame without a pose
    poses: Sequence[np.ndarray | None],
    camera: Camera,  # a pinhole, for the frames of the image motion
    moving_pixels: np.ndarray,  # (H, W) bool: pixels that are known to move
) -> tuple[Evidence, np.ndarray] | None:
    """Return the evidence of many frames on a frame's pixels, under known poses, or None.

    The second result is the inverse depth, (H, W) float32, that fits these frames best.
    """
    pose = poses[frame]
    if pose is None:
        return None
    shape = motion.grey(frame).shape
    views: list[tuple[ChainedFlow, StaticMotion]] = []
    for chain in motion.chained_flows(frame, max(OBJECTS.path_steps)):
        other_pose = poses[chain.frame]
        if chain.steps in OBJECTS.path_steps and other_pose is not None:
            views.append((chain, StaticMotion.between(pose, other_pose, camera, shape)))
    if len(views) < 2:
        return None
    inverse_depth, error = _joint_depth(views, shape)
    count = np.sum([chain.valid for chain, _ in views], axis=0)
    static_pixels = (count >= 2) & ~moving_pixels
    if static_pixels.sum() < 100:
        return None
    deviation = 1.48 * float(np.median(error[static_pixels]))
    if deviation > OBJECTS.max_path_error * max(shape):
        return None
    deviation += OBJECTS.flow_deviation / 2 * max(shape)  # many frames are more certain than one
    score = evidence_of_error(error / (deviation * OBJECTS.neutral_deviations))
    static_depths = inverse_depth[static_pixels & (score < 0)]
    # one before and one after the frame
    longest_chains = {chain.frame > frame: (chain, static) for chain, static in views}
    compared_views = [
        (motion.grey(chain.frame), chain.positions, chain.valid, static)
        for chain, static in longest_chains.values()
    ]
    support = support_of_motion(motion.grey(frame), compared_views, inverse_depth, static_depths)
    weight = np.where(score > 0, support, 1) * np.minimum(count / len(views) * 2, 1) * (count >= 2)
    evidence = Evidence(total=np.float32(score * weight), weight=np.float32(weight))
    return evidence, inverse_depth


def _joint_depth(
    views: Sequence[tuple[ChainedFlow, StaticMotion]], shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse depth that fits all views best, and its RMS error, px, (H, W) each."""
    inverse_depth = np.zeros(shape, np.float32)
    for fit_round in range(OBJECTS.depth_rounds):
        squares, products = np.full(shape, 1e-12, np.float32), np.zeros(shape, np.float32)
        for chain, static in views:
            slope, residual = static.slope_and_residual(inverse_depth, chain.positions)
            weight = chain.valid / np.float32(chain.steps)  # errors add up along a chain
            if fit_round:
                error = np.linalg.norm(residual, axis=-1) / np.float32(chain.steps**0.5)
                weight = weight / (1 + (error / OBJECTS.outlier_error) ** 2)
            squares += weight * (slope * slope).sum(axis=-1)
            products += weight * (slope * residual).sum(axis=-1)
        inverse_depth = np.maximum(inverse_depth + products / squares, 0)
    total, count = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for chain, static in views:
        error = np.linalg.norm(static.positions(inverse_depth) - chain.positions, axis=-1)
        total += chain.valid * error**2 / chain.steps
        count += chain.valid
    return inverse_depth, np.sqrt(total / np.maximum(count, 1))


@dataclass(frozen=True, kw_only=True)
class StaticDepth:
    """Depth of the static pixels of a frame, under the camera path."""

    inverse_depth: np.ndarray  # (H, W) float32
    static_pixels: np.ndarray  # (H, W) bool: pixels that are known to be static

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> "StaticDepth":
        """Return a `StaticDepth` without static pixels."""
        return cls(inverse_depth=np.zeros(shape, np.float32), static_pixels=np.zeros(shape, bool))

    @classmethod
    def from_arrays(cls, inverse_depth: np.ndarray, static_pixels: np.ndarray) -> "StaticDepth":
        """Return the `StaticDepth` with these arrays."""
        return cls(inverse_depth=inverse_depth.astype(np.float32), static_pixels=static_pixels)

    def to_arrays(self) -> tuple[np.ndarray, ...]:
        """Return the arrays with all bits, since the unit of depth is arbitrary."""
        return self.inverse_depth, self.static_pixels


class BelowGroundSearch:
    """The search for moving objects whose apparent depth lies below the ground."""

    def __init__(
        self,
        motion: ImageMotion,
        # sequence of (4, 4) array or None: camera to world, of every frame, in one scale; None for
        # a frame without a pose
        poses: Sequence[np.ndarray | None],
        camera: Camera,  # a pinhole, for the frames of the image motion
        depths: Sequence[StaticDepth],  # static depth of every frame
    ) -> None:
        self._motion, self._poses, self._camera, self._depths = motion, poses, camera, depths
        height, width = motion.grey(0).shape
        pixels = np.indices((height, width))[::-1].reshape(2, -1).T  # (x, y)
        self._rays = pinhole_rays(pixels, camera, (height, width)).reshape(height, width, 3)
        self._grounds = [
            None if pose is None else self._fit_ground(depth)
            for pose, depth in zip(poses, depths, strict=True)
        ]

    def evidence(
        self,
        frame: int,
        moving_pixels: np.ndarray,  # (H, W) bool: pixels that are known to move
    ) -> Evidence | None:
        """Return the evidence of pixels whose apparent depth lies below the ground, or None."""
        plane = self._median_ground(frame)
        if plane is None:
            return None
        ground, apparent = self._rays @ plane, self._depths[frame].inverse_depth
        is_below = (
            (ground > OBJECTS.min_ground_inverse_depth * np.abs(ground).max())
            & (apparent * OBJECTS.min_below_ground_ratio < ground)
            & ~moving_pixels
        )
        regions = list(_inner_regions(is_below))
        if not regions:
            return None
        hiding_pixels = self._hiding_pixels(frame)
        mask = np.zeros(is_below.shape, bool)
        for region in regions:
            min_points = OBJECTS.min_hidden_points * region.sum() ** 0.5
            mask |= region & (np.count_nonzero(hiding_pixels & region) > min_points)
        if not mask.any():
            return None
        weight = np.float32(mask * self._ground_contradiction(frame, ground))
        return Evidence(total=OBJECTS.moving_evidence * weight, weight=weight)

    def _fit_ground(self, depth: StaticDepth) -> np.ndarray | None:
        """Return the ground plane, (3,), or None; plane · ray is its inverse depth."""
        lower_half = depth.static_pixels & (self._rays[..., 1] > 0)
        rays, inverse_depth = self._rays[lower_half], depth.inverse_depth[lower_half]
        if len(rays) < OBJECTS.min_ground_share * depth.static_pixels.size:
            return None
        random = np.random.default_rng(0)
        sample = random.integers(len(rays), size=min(OBJECTS.ground_sample, len(rays)))
        triples = random.integers(len(rays), size=(OBJECTS.ground_trials, 3))
        is_solvable = np.abs(np.linalg.det(rays[triples])) > 1e-9
        planes = np.linalg.solve(
            rays[triples[is_solvable]], inverse_depth[triples[is_solvable], None]
        )
        planes = planes[..., 0]
        planes = planes[_is_upright(planes)]
        if not len(planes):
            return None
        is_inlier = _plane_inliers(rays[sample] @ planes.T, inverse_depth[sample, None])
        plane = planes[np.argmax(is_inlier.sum(axis=0))]
        for _ in range(OBJECTS.ground_rounds):
            inliers = _plane_inliers(rays @ plane, inverse_depth)
            if inliers.sum() < OBJECTS.min_ground_share * depth.static_pixels.size:
                return None
            plane = np.linalg.lstsq(rays[inliers], inverse_depth[inliers], rcond=None)[0]
        return plane if _is_upright(plane) else None

    def _median_ground(self, frame: int) -> np.ndarray | None:
        """Return the median ground plane, (3,), of the frames around a frame.

        Return None if the camera's height above the ground changes, or few frames show the ground.
        """
        window = slice(max(0, frame - OBJECTS.height_frames), frame + OBJECTS.height_frames + 1)
        planes = [plane for plane in self._grounds[window] if plane is not None]
        min_planes = max(3, OBJECTS.min_ground_frame_share * len(self._grounds[window]))
        if self._poses[frame] is None or len(planes) < min_planes:
            return None
        plane = np.median(planes, axis=0)
        min_height, max_height = np.quantile(np.array(planes)[:, 1], (0.1, 0.9))
        return plane if max_height - min_height < OBJECTS.max_height_change * plane[1] else None

    def _hiding_pixels(self, frame: int) -> np.ndarray:
        """Return the pixels, (H, W) bool, that hide static points nearer than their apparent depth.

        The static points are known from other frames. The chained image motion from there to this
        frame is invalid. At the projected position of a hidden point, this frame has other grey
        levels and a larger apparent depth.
        """
        hiding_pixels = np.zeros(self._rays.shape[:2], bool)
        grey, own_depth = self._motion.grey(frame), self._depths[frame]
        limit = grey.shape[1] - 1, grey.shape[0] - 1
        for number in [*self._frames_with_pose(frame, -1), *self._frames_with_pose(frame, 1)]:
            other, other_grey = self._depths[number], self._motion.grey(number)
            static = self._static_motion(number, frame)
            positions = static.positions(other.inverse_depth)
            expected_inverse_depth = static.other_inverse_depth(other.inverse_depth)
            inside = ((positions > 0) & (positions < limit)).all(axis=-1)
            apparent = sample_image(own_depth.inverse_depth, positions)
            is_hidden = (
                other.static_pixels & inside & ~self._motion.chained_flow(number, frame).valid
            )
            is_hidden &= apparent * OBJECTS.min_below_ground_ratio < expected_inverse_depth
            is_hidden &= sample_image(np.float32(own_depth.static_pixels), positions) > 0.5
            difference = grey_difference(grey, positions, other_grey)
            is_hidden &= difference > OBJECTS.min_hidden_difference
            x, y = np.rint(positions[is_hidden]).astype(int).T
            hiding_pixels[y, x] = True
        return hiding_pixels

    def _ground_contradiction(self, frame: int, ground: np.ndarray) -> np.ndarray:
        """Return how strongly the images contradict that a pixel is ground, (H, W), 0 to 1."""
        grey, depth = self._motion.grey(frame), self._depths[frame].inverse_depth
        contradiction = np.zeros(depth.shape, np.float32)
        for direction in (-1, 1):
            numbers = self._frames_with_pose(frame, direction)
            if not numbers:
                continue
            static, other = self._static_motion(frame, numbers[-1]), self._motion.grey(numbers[-1])
            difference = grey_difference(other, static.positions(depth), grey)
            gain = grey_difference(other, static.positions(ground), grey) - difference
            contradiction = np.maximum(
                contradiction, gain / (OBJECTS.full_evidence_difference + difference)
            )
        return np.clip(contradiction, 0, 1)

    def _static_motion(self, frame: int, other: int) -> StaticMotion:
        pose, other_pose = self._poses[frame], self._poses[other]
        assert pose is not None and other_pose is not None
        return StaticMotion.between(pose, other_pose, self._camera, self._rays.shape)

    def _frames_with_pose(self, frame: int, direction: int) -> list[int]:
        """Return the frames with poses, `hidden_steps` before (−1) or after (1) a frame."""
        numbers = [frame + direction * steps for steps in OBJECTS.hidden_steps]
        count = len(self._poses)
        return [k for k in numbers if 0 <= k < count and self._poses[k] is not None]


def _is_upright(planes: np.ndarray) -> np.ndarray:
    """Return whether planes, (..., 3), are the ground below an upright camera, (...) bool."""
    slope_x, slope_y, center = np.moveaxis(planes, -1, 0)
    is_level = np.abs(slope_x) < OBJECTS.max_roll_slope * slope_y
    return is_level & (np.abs(center) < OBJECTS.max_pitch_slope * slope_y)


def _plane_inliers(plane_depth: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
    return np.abs(inverse_depth - plane_depth) < OBJECTS.ground_tolerance * np.abs(plane_depth)


def _inner_regions(mask: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the large connected parts, (H, W) bool, that do not touch the frame's sides."""
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    width = mask.shape[1]
    for label in range(1, count):
        left, _, columns, _, area = statistics[label]
        if area >= smallest_object(mask.size) and left > 1 and left + columns < width - 1:
            yield labels == label
