"""Evidence over several frames that a pixel moves on its own.

The image motion of a static point fits the motion of the camera with some depth. In two frames, an
object that moves along epipolar lines looks like static points at another depth. Over several
frames, one static depth hardly ever fits such an object. For this reason evidence is accumulated
along the image motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import ImageMotion, pixel_grid, sample_image
from tisfm.reconstruction.objects.settings import OBJECTS


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Evidence of several frames on whether pixels move on their own."""

    # (H, W) float32: sum over frames: positive for a pixel that moves on its own, negative for a
    # static pixel
    total: np.ndarray
    weight: np.ndarray  # (H, W) float32: number of frames with evidence; each counts 1 at most

    @classmethod
    def from_arrays(cls, total: np.ndarray, weight: np.ndarray) -> "Evidence":
        """Return the evidence with these arrays."""
        return cls(total=total.astype(np.float32), weight=weight.astype(np.float32))

    def to_arrays(self) -> tuple[np.ndarray, ...]:
        """Return the arrays of the evidence, with 11 significant bits."""
        return self.total.astype(np.float16), self.weight.astype(np.float16)

    def mean(self) -> np.ndarray:
        """Return the mean evidence, (H, W) float32; pixels without evidence are static."""
        return (self.total + np.float32(OBJECTS.static_prior * OBJECTS.static_evidence)) / (
            self.weight + np.float32(OBJECTS.static_prior)
        )

    def combine_with(self, multi_frame: "Evidence") -> "Evidence":
        """Return the sum of this evidence, of frame pairs, and the evidence of many frames.

        A pixel that looks static in two frames may move along epipolar lines. For this reason, two
        frames count as evidence of a static pixel only where many frames show a static pixel.
        """
        valid = (self.total > 0) | (multi_frame.total < 0)
        return self._add_where(valid, multi_frame)

    def with_static_pixels(self, mask: np.ndarray) -> "Evidence":
        """Return the evidence with the pixels of a mask, (H, W) bool, set to static."""
        return Evidence(
            total=np.where(mask, np.float32(OBJECTS.static_evidence), self.total),
            weight=np.where(mask, np.float32(1), self.weight),
        )

    def override_with(self, other: "Evidence") -> "Evidence":
        """Return the sum; where `other` has evidence, this evidence counts only for motion."""
        valid = (self.total > 0) | (other.weight == 0)
        return self._add_where(valid, other)

    def _add_where(self, valid: np.ndarray, other: "Evidence") -> "Evidence":
        return Evidence(
            total=valid * self.total + other.total, weight=valid * self.weight + other.weight
        )


def frame_evidence(
    motion: ImageMotion,
    frame: int,
    camera: Camera,  # a pinhole, for the frames of the image motion
) -> Evidence:
    """Return the evidence of the image motion from a frame to its neighbour frames.

    Between two frames, one rigid motion is fitted to the valid image motion. The evidence of a
    pixel depends on its distance, in the other frame, from the nearest possible position of a
    static point. The unit of this distance is the standard deviation of static pixels.
    """
    shape = motion.grey(frame).shape
    total, weight = (np.zeros(shape, np.float32) for _ in range(2))
    grid, grey = pixel_grid(shape), motion.grey(frame)
    for chain in motion.chained_flows(frame, max(OBJECTS.pair_steps)):
        if chain.steps not in OBJECTS.pair_steps:
            continue
        flow = chain.positions - grid
        try:
            fit = camera_motion(flow, np.float32(chain.valid), camera)
        except TooFewPixelsError:
            continue
        deviation = fit.residual + OBJECTS.flow_deviation * max(shape) * chain.steps**0.5
        static_motion = StaticMotion(fit.rotation, fit.translation, camera, shape)
        inverse_depth = static_motion.nearest_inverse_depth(chain.positions)
        error = np.linalg.norm(static_motion.positions(inverse_depth) - chain.positions, axis=-1)
        score = evidence_of_error(error / deviation / OBJECTS.neutral_deviations)
        static_depths = inverse_depth[chain.valid & (score < 0)]
        view = motion.grey(chain.frame), chain.positions, chain.valid, static_motion
        support = support_of_motion(grey, [view], inverse_depth, static_depths)
        frame_weight = np.where(score > 0, support, 1)
        frame_weight *= chain.valid
        total += frame_weight * score
        weight += frame_weight
    comparison_count = 2 * len(OBJECTS.pair_steps)
    return Evidence(total=total / comparison_count, weight=weight / comparison_count)


def evidence_of_error(error: np.ndarray) -> np.ndarray:
    """Return the evidence of one frame, (H, W), from relative errors; an error of 1 gives 0."""
    return np.clip(error**2 - 1, OBJECTS.static_evidence, OBJECTS.moving_evidence)


def accumulate_evidence(motion: ImageMotion, evidence: Sequence[Evidence]) -> Sequence[Evidence]:
    """Return the evidence of every frame, accumulated along the image motion in both directions."""
    forward, backward = _accumulate(motion, evidence, 1), _accumulate(motion, evidence, -1)
    result = DiskCache(Evidence.to_arrays, Evidence.from_arrays)
    for frame, own_evidence in enumerate(evidence):
        from_earlier, from_later = forward[frame], backward[len(evidence) - 1 - frame]
        result.append(
            Evidence(
                total=from_earlier.total + from_later.total - own_evidence.total,
                weight=from_earlier.weight + from_later.weight - own_evidence.weight,
            )
        )
    return result


def _accumulate(
    motion: ImageMotion, evidence: Sequence[Evidence], direction: int
) -> DiskCache[Evidence]:
    """Return evidence accumulated over earlier frames, or, with direction −1, over later frames.

    The result has the frames in the order of accumulation.
    """
    result, previous = DiskCache(Evidence.to_arrays, Evidence.from_arrays), None
    for frame in range(len(evidence))[::direction]:
        accumulated = evidence[frame]
        if previous is not None:
            chain = motion.chained_flow(frame, frame - direction)
            factor = np.float32(OBJECTS.passed_evidence_share) * chain.valid
            accumulated = Evidence(
                total=accumulated.total + factor * sample_image(previous.total, chain.positions),
                weight=accumulated.weight + factor * sample_image(previous.weight, chain.positions),
            )
        result.append(accumulated)
        previous = accumulated
    return result


class StaticMotion:
    """Projection of static points from a frame to another frame, under one camera motion."""

    def __init__(
        self,
        # rotation, translation: (3, 3) and (3,) array: from a frame to another, P₁ = R P₀ + t
        rotation: np.ndarray,
        translation: np.ndarray,
        camera: Camera,
        shape: tuple[int, ...],  # height and width of the frames, px
    ) -> None:
        self._focal = np.float32(camera.focal)
        self._center = np.array(camera.center_for(*shape[:2]), np.float32)
        image_points = (pixel_grid(shape) - self._center) / self._focal
        rays = cv2.merge([*cv2.split(image_points), np.ones(shape[:2], np.float32)])
        self._rays = cv2.transform(rays, rotation.astype(np.float32))
        self._translation = translation.astype(np.float32)

    @classmethod
    def between(
        cls, pose: np.ndarray, other: np.ndarray, camera: Camera, shape: tuple[int, ...]
    ) -> "StaticMotion":
        """Return the motion from a frame to another, from their poses, (4, 4) camera to world."""
        relative = np.linalg.inv(other) @ pose
        return cls(relative[:3, :3], relative[:3, 3], camera, shape)

    def positions(self, inverse_depth: np.ndarray | float) -> np.ndarray:
        """Return the positions of points, (H, W, 2) float32, px, by inverse depth, 1/unit of t."""
        point = [
            ray + np.float32(inverse_depth) * component
            for ray, component in zip(cv2.split(self._rays), self._translation, strict=True)
        ]
        scale = self._focal / np.maximum(point[2], np.float32(OBJECTS.min_depth_ratio))
        x, y = self._center
        return cv2.merge([point[0] * scale + x, point[1] * scale + y])

    def other_inverse_depth(self, inverse_depth: np.ndarray) -> np.ndarray:
        """Return the inverse depth of these points in the other frame, (H, W) float32."""
        depth = self._rays[..., 2] + inverse_depth * self._translation[2]
        return inverse_depth / np.maximum(depth, np.float32(OBJECTS.min_depth_ratio))

    def slope_and_residual(
        self, inverse_depth: np.ndarray, positions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative of the positions by inverse depth, and the errors of positions, px.

        (H, W, 2) float32 each.
        """
        x, y, depth = (
            ray + inverse_depth * component
            for ray, component in zip(cv2.split(self._rays), self._translation, strict=True)
        )
        scale = self._focal / np.maximum(depth, np.float32(OBJECTS.min_depth_ratio))
        t1, t2, t3 = self._translation
        projected_x, projected_y = x * scale, y * scale
        slope = [
            scale * t1 - projected_x * scale / self._focal * t3,
            scale * t2 - projected_y * scale / self._focal * t3,
        ]
        residual = positions - self._center - cv2.merge([projected_x, projected_y])
        return cv2.merge(slope), residual

    def nearest_inverse_depth(self, positions: np.ndarray) -> np.ndarray:
        """Return the inverse depth, (H, W) float32, whose positions are nearest to `positions`."""
        target = (positions - self._center) / self._focal
        t12, t3 = self._translation[:2], self._translation[2]
        min_depth = np.float32(OBJECTS.min_depth_ratio)
        ray, inverse_depth = self._rays, np.zeros(target.shape[:2], np.float32)
        for _ in range(2):  # the second round has the weights of the first result
            depth = np.maximum(ray[..., 2] + inverse_depth * t3, min_depth)
            residual = (target * ray[..., 2:] - ray[..., :2]) / depth[..., None]
            slope = (target * t3 - t12) / depth[..., None]
            square = np.maximum((slope * slope).sum(axis=-1), np.float32(1e-12))
            inverse_depth = np.maximum(-(residual * slope).sum(axis=-1) / square, np.float32(0))
        return inverse_depth


def support_of_motion(
    grey: np.ndarray,  # (H, W) float32
    # sequence of (other, positions, valid, static_motion): another frame, (H, W) float32; the
    # position of each pixel in it, (H, W, 2) float32; where this position is known, (H, W) bool;
    # and the motion of static points
    views: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, StaticMotion]],
    # (H, W) float32: the inverse depth whose static positions are nearest to these positions
    nearest_inverse_depth: np.ndarray,
    static_depths: np.ndarray,  # (N,) float32: inverse depths of static points
) -> np.ndarray:  # (H, W) float32: from `OBJECTS.min_support` to 1
    """Return a factor of evidence of motion: 1 where all static positions match clearly worse.

    In an area without texture all positions look alike, and the image motion is arbitrary. Where
    the image motion is wrong, some static depth fits the images as well or better. One depth has to
    fit all frames of `views`.
    """
    max_static_inverse_depth = (
        float(np.quantile(static_depths, 0.99)) if len(static_depths) else 0.0
    )
    max_inverse_depth = max_static_inverse_depth * OBJECTS.max_inverse_depth_factor
    shifts = [
        np.median(
            np.linalg.norm(
                static_motion.positions(max_inverse_depth) - static_motion.positions(0.0), axis=-1
            )
        )
        for *_, static_motion in views
    ]
    count = int(np.clip(max(shifts) / OBJECTS.static_position_step, *OBJECTS.static_position_range))
    difference = _mean_difference(grey, [view[:3] for view in views])
    min_difference = np.full(grey.shape, np.inf, np.float32)
    candidates: list[np.ndarray | float] = [
        nearest_inverse_depth,
        *np.linspace(0, max_inverse_depth, count).tolist(),
    ]
    for inverse_depth in candidates:
        static_views = [
            (other, static_motion.positions(inverse_depth), valid)
            for other, _, valid, static_motion in views
        ]
        min_difference = np.minimum(min_difference, _mean_difference(grey, static_views))
    support = (min_difference - difference) / (OBJECTS.full_evidence_difference + difference)
    return np.clip(support, OBJECTS.min_support, 1)


def _mean_difference(
    grey: np.ndarray, views: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return the mean difference of pixels from positions in other frames, grey levels, (H, W)."""
    total, count = np.zeros(grey.shape, np.float32), np.zeros(grey.shape, np.float32)
    for other, positions, valid in views:
        total += valid * grey_difference(other, positions, grey)
        count += valid
    return total / np.maximum(count, 1)


def grey_difference(other: np.ndarray, positions: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return the mean difference of `grey` from another frame at positions, in a window.

    The result is in grey levels, (H, W) float32.
    """
    side = OBJECTS.comparison_window
    return cv2.blur(np.abs(sample_image(other, positions) - grey), (side, side))
