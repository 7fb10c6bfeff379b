"""Candidates for moving objects: motions in a flow field, and floating parts of a depth map.

An object that moves along the epipolar lines of points at rest looks like a point at rest with a
wrong depth. If it looks nearer, the whole object, with its feet, floats in front of its
surroundings. An object at rest on the ground is different: it has the depth of the ground at its
base, and from there the ground comes nearer, down to the border of the image.
"""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.camera import Camera
from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion, triangulate
from tisfm.motion.objects.label_optimisation import Potts
from tisfm.motion.objects.settings import OBJECTS


def motion_candidates(
    flow: np.ndarray,  # (H, W, 2) float32
    trust: np.ndarray,  # (H, W) float32: confidence, 0 where occluded
    camera: Camera,
    frame: np.ndarray,  # (H, W) float32: grey levels, for the boundaries
    background: np.ndarray,  # (3, 4) array: R and t of the largest motion
    residual: float,  # residual of the background's motion, px
    *,
    max_motions: int,  # largest number of motions
) -> tuple[list[np.ndarray], np.ndarray]:
    """Find motions one after another, each in the pixels that previous motions do not explain.

    The cost of a pixel is the distance of its flow from the half line of flows that a motion allows
    at depths in front of the camera. A further label stands for pixels that no motion explains; its
    largest connected part gives the next motion.

    Returns the motions, (3, 4) each, the background first; and labels, (H, W) int32.
    """
    height, width = trust.shape
    scale = min(1.0, (OBJECTS.candidate_pixels / (height * width)) ** 0.5)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    ratio = size[0] / width
    small_flow = cv2.resize(flow, size, interpolation=cv2.INTER_AREA) * np.float32(ratio)
    small_trust = cv2.resize(trust, size, interpolation=cv2.INTER_AREA)
    # The rounding of the size shifts an image by a fraction of a pixel; motions hardly change.
    search = _CandidateSearch(
        small_flow,
        small_trust,
        camera.scaled(ratio, height, width),
        cv2.resize(frame, size, interpolation=cv2.INTER_AREA),
        OBJECTS.error_residuals * residual * ratio + OBJECTS.error_px,
        np.array(background, np.float64),
    )
    motions, labels = search.run(max_motions)
    labels = cv2.resize(
        labels.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
    ).astype(np.int32)
    return motions, labels


class _CandidateSearch:
    """The search for motions in a flow field."""

    def __init__(
        self,
        flow: np.ndarray,  # (h, w, 2) float32: px/frame
        trust: np.ndarray,  # (h, w) float32
        camera: Camera,  # camera of the flow's level
        frame: np.ndarray,  # (h, w) float32: grey levels
        max_error: float,  # px: assumed error of the flow
        background: np.ndarray,  # (3, 4): motion of the background
    ) -> None:
        self._flow, self._trust, self._camera = flow, trust, camera
        self._background = background
        self._max_error = max_error
        self._potts = Potts(frame)
        self._weight = np.maximum(trust, OBJECTS.min_label_weight)
        self.min_size = smallest_object(trust.size)

    def run(self, max_motions: int) -> tuple[list[np.ndarray], np.ndarray]:
        motions = [self._background]
        is_tried = np.zeros(self._trust.shape, bool)
        for _ in range(3 * max_motions):
            labels = self._assign_labels(motions, has_unexplained_label=True)
            part = _largest_part((labels == len(motions)) & ~is_tried)
            if len(motions) == max_motions or part.sum() < self.min_size:
                break
            motion = self._fit_motion(part)
            new_motions = None if motion is None else self._add_motion(motions, motion, part)
            if new_motions is None:
                is_tried |= part
            else:
                motions = new_motions
        motions = self._split_labels(motions, max_motions)
        return motions, self._assign_labels(motions)

    def _split_labels(self, motions: list[np.ndarray], max_motions: int) -> list[np.ndarray]:
        """Give separate parts of a label their own motions if these fit clearly better.

        One motion with free depths often explains two objects that move only roughly alike. Mostly
        this is the motion of the largest part, so the other parts try motions of their own.
        """
        labels = self._assign_labels(motions)
        new_motions: list[np.ndarray] = []
        for label in range(1, len(motions)):
            parts = sorted(_parts(labels == label, self.min_size), key=np.sum)
            joint_motion = self._fit_motion(np.any(parts, axis=0)) if len(parts) > 1 else None
            if joint_motion is None:
                continue
            joint_distance = self._distance(joint_motion)
            rest_mask = np.any(parts, axis=0)
            for part in parts[:-1]:
                part_motion = self._fit_motion(part)
                if part_motion is None or len(motions) + len(new_motions) == max_motions:
                    continue
                part_distance = self._distance(part_motion)
                if np.median(part_distance[part]) < OBJECTS.max_split_ratio * np.median(
                    joint_distance[part]
                ):
                    new_motions.append(part_motion)
                    rest_mask &= ~part
            rest_motion = self._fit_motion(rest_mask)
            motions[label] = joint_motion if rest_motion is None else rest_motion
        return motions + new_motions

    def _add_motion(
        self, motions: list[np.ndarray], motion: np.ndarray, part: np.ndarray
    ) -> list[np.ndarray] | None:
        """Return the motions with a new motion, all refitted; None if it explains few pixels."""
        is_explained = (
            self._distance(motion) < self._max_error * OBJECTS.unexplained_errors
        ) & part
        if is_explained.sum() < max(OBJECTS.min_explained_share * part.sum(), self.min_size):
            return None
        motions = [*motions, motion]
        labels = self._assign_labels(motions)
        refitted_motions = []
        for label, motion in enumerate(motions):
            is_label = labels == label
            if label == 0 and not motion[:, 3].any():
                refitted_motions.append(motion)  # a background at rest
            elif label == 0 or is_label.sum() >= self.min_size:
                new_motion = self._fit_motion(is_label)
                refitted_motions.append(motion if new_motion is None else new_motion)
        return refitted_motions if len(refitted_motions) == len(motions) else None

    def _fit_motion(self, mask: np.ndarray) -> np.ndarray | None:
        try:
            motion = camera_motion(self._flow, self._trust * mask, self._camera)
        except TooFewPixelsError:
            return None
        # No object rotates faster: such a motion fits noise.
        angle = Rotation.from_matrix(motion.rotation @ self._background[:, :3].T).magnitude()
        if angle > OBJECTS.max_rotation:
            return None
        return np.column_stack([motion.rotation, motion.translation])

    def _assign_labels(
        self, motions: list[np.ndarray], *, has_unexplained_label: bool = False
    ) -> np.ndarray:
        costs = [(self._distance(motion) / self._max_error) ** 2 for motion in motions]
        if has_unexplained_label:
            costs.append(np.full(self._trust.shape, OBJECTS.unexplained_errors**2))
        limited_costs = np.minimum(np.stack(costs), 4 * OBJECTS.unexplained_errors**2)
        return self._potts.assign(limited_costs.astype(np.float32), self._weight)

    def _distance(self, motion: np.ndarray) -> np.ndarray:
        """Return the distance of the flow from targets of points in front of the camera, px."""
        height, width = self._trust.shape
        focal = self._camera.focal
        cx, cy = self._camera.center_for(height, width)
        rows, columns = np.mgrid[:height, :width]
        positions = np.stack([columns - cx, rows - cy], axis=-1).reshape(-1, 2)
        ones = np.ones((len(positions), 1))
        rays0 = np.hstack([positions / focal, ones])
        rays1 = np.hstack([(positions + self._flow.reshape(-1, 2)) / focal, ones])
        rotation, translation = motion[:, :3], motion[:, 3]
        points = rays0 @ rotation.T
        if translation.any():
            inverse_depth = np.maximum(triangulate(rays0, rays1, rotation, translation), 0)
            points += inverse_depth[:, None] * translation
        projections = points[:, :2] / np.maximum(points[:, 2:], MIN_DEPTH_RATIO)
        distance = focal * np.linalg.norm(rays1[:, :2] - projections, axis=1)
        return distance.reshape(height, width)


def smallest_object(pixels: int) -> int:
    """Return the number of pixels of the smallest object, in an image of `pixels` pixels."""
    return max(64, round(OBJECTS.min_object_share * pixels))


def _parts(mask: np.ndarray, min_size: int) -> list[np.ndarray]:
    """Return the connected parts of a mask with at least `min_size` pixels."""
    count, parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    masks = (parts == index for index in range(1, count))
    return [part for part in masks if part.sum() >= min_size]


def _largest_part(mask: np.ndarray) -> np.ndarray:
    """Return the largest connected part of a mask; it is empty if the mask is empty."""
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=4
    )
    if count < 2:
        return np.zeros(mask.shape, bool)
    return parts == 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))


MAX_PARTS = 255  # floating parts, numbered in uint8


def floating_parts(
    inverse_depth: np.ndarray,  # (H, W) float32: in any unit; positive in front of the camera
    deviation: np.ndarray,  # (H, W) float32: standard deviation of `inverse_depth`
    min_size: int,  # fewest pixels of a part
) -> np.ndarray:  # (H, W) int32: parts in order of size, the largest first
    """Return the connected parts of a depth map that float, numbered from 1; 0 elsewhere.

    From each point of a standing object, a path over the object and the ground leads to the border
    of the image, and no point of the path is much farther away than the first. Morphological
    reconstruction by dilation from the border gives the farthest point of the best path: the
    inverse depth with all domes cut off. A part floats if its inverse depth is `min_nearness_ratio`
    times as large, by lower and upper limits of `depth_deviations` deviations, and if the ground
    below the part comes nearer or stays as far away. Objects that touch the border never float.
    Objects that hang from above, or are tall and seen from straight above, wrongly seem to float.

    References
    ----------
    Vincent, "Morphological grayscale reconstruction in image analysis", IEEE Transactions on
    Image Processing 2 (1993) 176, doi 10.1109/83.217222.
    """
    height, width = inverse_depth.shape
    scale = min(1.0, (OBJECTS.map_pixels / (height * width)) ** 0.5)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    depth, margin = (
        cv2.medianBlur(
            cv2.resize(image, size, interpolation=cv2.INTER_AREA), OBJECTS.map_median_window
        )
        for image in (
            inverse_depth.astype(np.float32),
            OBJECTS.depth_deviations * deviation.astype(np.float32),
        )
    )
    min_depth = OBJECTS.min_surrounding_depth * float(np.median(np.abs(depth)))
    upper_limit = np.maximum(depth + margin, min_depth)
    surroundings = without_domes(
        cv2.dilate(upper_limit, np.ones((OBJECTS.gap_window, OBJECTS.gap_window), np.uint8))
    )
    is_in_front = (depth - margin > OBJECTS.min_nearness_ratio * surroundings).astype(np.uint8)
    parts = cv2.connectedComponents(
        cv2.dilate(is_in_front, np.ones((OBJECTS.joining_window, OBJECTS.joining_window), np.uint8))
    )[1]
    parts *= is_in_front
    areas = np.bincount(parts.ravel())
    areas[0] = 0
    numbers = np.zeros(parts.shape, np.uint8)
    for part in np.argsort(-areas, kind="stable"):
        is_part = parts == part
        if areas[part] < min_size * scale**2 or numbers.max() == MAX_PARTS:
            break
        ground = upper_limit[-OBJECTS.ground_rows :, is_part.any(axis=0)]
        if np.median(ground) >= OBJECTS.min_ground_ratio * np.median(surroundings[is_part]):
            numbers[is_part] = numbers.max() + 1
    return cv2.resize(numbers, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.int32)


def without_domes(
    image: np.ndarray,  # (H, W) float32
) -> np.ndarray:
    """Return an image with all maxima that do not touch its border cut off.

    Each pixel takes the largest, over all 8-connected paths to the border, of the least value on
    the path. This is the morphological reconstruction of the image by dilation from its border.
    """
    window = np.ones((3, 3), np.uint8)
    result = np.full_like(image, image.min())
    for border in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        result[border] = image[border]
    while True:
        dilation = np.minimum(cv2.dilate(result, window), image)
        if np.array_equal(dilation, result):
            return result
        result = dilation
