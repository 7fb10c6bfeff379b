"""Moving regions of a frame, from evidence on every pixel, and their smooth motions."""

from collections.abc import Iterator
from typing import Literal

import cv2
import numpy as np

from tisfm.motion.objects.candidates import smallest_object
from tisfm.motion.objects.label_optimisation import Potts
from tisfm.reconstruction.frames.image_motion import ImageMotion, pixel_grid, vector_lengths
from tisfm.reconstruction.objects.motion_evidence import Evidence
from tisfm.reconstruction.objects.settings import OBJECTS


def find_moving_regions(
    grey: np.ndarray,  # (H, W) float32
    evidence: Evidence,
    expected: np.ndarray,  # (H, W) float32: evidence that is added where known objects are expected
) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield moving connected regions of a frame, (H, W) bool, and whether they have a core."""
    mean_evidence = evidence.mean()
    core_pixels = (mean_evidence > OBJECTS.core_evidence) & (
        evidence.weight > OBJECTS.min_core_weight
    )
    mean_evidence += expected - np.float32(OBJECTS.region_evidence)
    costs = np.stack([2 * np.clip(mean_evidence, 0, 3), 4 * np.clip(-mean_evidence, 0, 1)])
    weight = (evidence.weight + OBJECTS.static_prior) / OBJECTS.full_weight_frames
    weight = OBJECTS.max_data_weight * np.clip(weight, OBJECTS.min_data_share, 1)
    is_moving = Potts(grey).assign(costs.astype(np.float32), weight.astype(np.float32)) == 1
    count, components, statistics, _ = cv2.connectedComponentsWithStats(
        is_moving.astype(np.uint8), connectivity=4
    )
    core_areas = np.bincount(components[core_pixels], minlength=count)
    min_area = smallest_object(grey.size)
    for component in range(1, count):
        area = statistics[component, cv2.CC_STAT_AREA]
        if area >= min_area:
            min_core_area = max(OBJECTS.min_core_ratio * min_area, OBJECTS.min_core_share * area)
            yield components == component, bool(core_areas[component] >= min_core_area)


# Terms of the polynomial motion model: 1 velocity, 3 affine motion, 6 quadratic motion.
Terms = Literal[1, 3, 6]


class SmoothMotions:
    """The image motion of a frame to the next and the previous frame."""

    def __init__(self, motion: ImageMotion, frame: int) -> None:
        self._flows = [
            (chain.positions - pixel_grid(chain.valid.shape), chain.valid)
            for chain in motion.chained_flows(frame, 1)
        ]
        self._has_next = frame + 1 < len(motion)
        # (H, W) bool: pixels that the next or the previous frame shows
        self.valid = np.any([valid for _, valid in self._flows], axis=0)
        # (H, W, 2) float32: to the next frame; for the last frame, the negative of the flow to the
        # previous frame
        self.flow = self._flows[0][0] if self._has_next else -self._flows[0][0]

    def residuals_from(
        self,
        mask: np.ndarray,  # (H, W) bool
        # (2,) array: velocity of most pixels of the mask, px/frame, if known
        velocity: np.ndarray | None = None,
        *,
        # {1, 3, 6}: terms of the largest model: 1 velocity, 3 affine motion, 6 quadratic motion
        terms: Terms = 6,
    ) -> tuple[np.ndarray, float]:
        """Return each pixel's distance from the smooth motion of a mask, (H, W) px; 0 if unknown.

        The second result is the standard deviation of the mask's pixels from this motion, px.
        """
        total, count = np.zeros(mask.shape, np.float32), np.zeros(mask.shape, np.float32)
        deviations = []
        for index, (flow, valid) in enumerate(self._flows):
            pixels = mask & valid
            if pixels.sum() < OBJECTS.min_motion_pixels:
                continue
            sign = 1 if self._has_next and index == 0 else -1
            expected = None if velocity is None else sign * velocity
            residual = vector_lengths(flow - smooth_motion(flow, pixels, expected, terms))
            deviations.append(1.48 * float(np.median(residual[pixels])))
            total += np.where(valid, residual, 0)
            count += valid
        deviation = max([OBJECTS.min_motion_deviation, *deviations])
        return total / np.maximum(count, 1), deviation

    def shared_motion(
        self,
        core: np.ndarray,  # (H, W) bool: known pixels of an object
        object_pixels: np.ndarray,  # (H, W) bool: known pixels of all objects
    ) -> np.ndarray:
        """Return the pixels near an object that move like it, and not like its surroundings, bool.

        A part without texture, or one that moves along epipolar lines, looks static by itself.
        """
        result = np.zeros(core.shape, bool)
        radius = 1 + round(OBJECTS.shared_motion_range * float(core.sum()) ** 0.5)
        left, top, width, height = cv2.boundingRect(np.uint8(core))
        margin = radius + OBJECTS.surroundings_width
        window = np.s_[
            max(0, top - margin) : top + height + margin,
            max(0, left - margin) : left + width + margin,
        ]
        core, object_pixels = core[window], object_pixels[window]
        is_near = cv2.dilate(np.uint8(core), np.ones((2 * radius + 1,) * 2, np.uint8)) > 0
        inner = cv2.erode(np.uint8(core), np.ones((OBJECTS.rim_width,) * 2, np.uint8)) > 0
        source = inner if inner.sum() >= OBJECTS.min_core_pixels else core
        own, other, count = np.zeros((3, *core.shape), np.float32)
        deviation = OBJECTS.min_shared_motion
        for whole_flow, whole_valid in self._flows:
            flow, valid = np.ascontiguousarray(whole_flow[window]), whole_valid[window]
            inside, outside = source & valid, valid & ~(object_pixels | is_near)
            if inside.sum() < OBJECTS.min_motion_pixels or not outside.any():
                continue
            residual = vector_lengths(flow - smooth_motion(flow, inside))
            deviation = max(deviation, 1.48 * float(np.median(residual[inside])))
            own += np.where(valid, residual, 0)
            # A foot on the ground moves as the ground does, which comes nearer towards the camera.
            from_surroundings = np.minimum(
                vector_lengths(flow - extend_flow(flow, outside)),
                vector_lengths(flow - smooth_motion(flow, outside)),
            )
            other += np.where(valid, from_surroundings, 0)
            count += valid
        own, other = own / np.maximum(count, 1), other / np.maximum(count, 1)
        is_shared = (own < OBJECTS.max_shared_deviations * deviation) & (
            own < OBJECTS.max_shared_ratio * other
        )
        is_shared &= is_near & (count > 0) & (other > OBJECTS.min_shared_motion)
        result[window] = is_shared & (core | ~object_pixels)
        return result


def extend_flow(flow: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return a flow, (H, W, 2), continued beyond a mask from the nearest pixel inside."""
    _, nearest = cv2.distanceTransformWithLabels(
        np.uint8(~mask), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros((int(nearest.max()) + 1, 2), np.float32)
    table[nearest[mask]] = flow[mask]
    extrapolated = cv2.blur(table[nearest], (OBJECTS.rim_width, OBJECTS.rim_width))
    return np.where(mask[..., None], flow, extrapolated)


def smooth_motion(
    flow: np.ndarray,  # (H, W, 2) float32
    mask: np.ndarray,  # (H, W) bool
    # (2,) array: px/frame: pixels near the expected velocity count most in the first round
    expected: np.ndarray | None = None,
    # {1, 3, 6}: 1 velocity, 3 affine motion, 6 quadratic motion. With few pixels, the motion is
    # affine at most.
    terms: Terms = 6,
) -> np.ndarray:
    """Return a smooth motion, (H, W, 2) float32, fitted robustly to a flow within a mask."""
    rows, columns = np.nonzero(mask)
    center = np.array([np.median(columns), np.median(rows)])
    size = max(1.0, float(max(np.ptp(columns), np.ptp(rows))) / 2)
    x, y = np.moveaxis((pixel_grid(flow.shape) - center) / size, -1, 0).clip(-2, 2)
    monomials = [np.ones_like(x), x, y, x * x, x * y, y * y]
    count = terms if len(rows) >= OBJECTS.min_quadratic_pixels else min(terms, 3)
    basis = np.stack(monomials[:count], -1)
    stride = max(1, len(rows) // 4000)
    samples, flow_samples = basis[mask][::stride], flow[mask][::stride].astype(np.float64)
    weight = np.ones(len(flow_samples))
    if expected is not None:
        distance = np.linalg.norm(flow_samples - expected, axis=1)
        weight = 1 / (1 + (distance / OBJECTS.velocity_tolerance) ** 2) ** 2
    for _ in range(5):
        weighted_samples = samples * weight[:, None]
        gram = weighted_samples.T @ samples + 1e-6 * len(flow_samples) * np.eye(samples.shape[1])
        coefficients = np.linalg.solve(gram, weighted_samples.T @ flow_samples)
        residual = np.linalg.norm(samples @ coefficients - flow_samples, axis=1)
        weight = 1 / (1 + (residual / max(1.48 * np.median(residual), 0.05)) ** 2)
    return np.float32(basis @ coefficients)
