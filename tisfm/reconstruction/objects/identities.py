"""Labels of moving objects, whose ids persist from frame to frame and through occlusion."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from tisfm.motion.objects.candidates import smallest_object
from tisfm.motion.objects.label_optimisation import Potts
from tisfm.motion.objects.layers import fill_nearest
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import (
    ImageMotion,
    consistency_mask,
    pixel_grid,
    sample_image,
)
from tisfm.reconstruction.objects.label_propagation import refine_boundaries
from tisfm.reconstruction.objects.motion_evidence import Evidence
from tisfm.reconstruction.objects.moving_regions import SmoothMotions, Terms, find_moving_regions
from tisfm.reconstruction.objects.settings import OBJECTS
from tisfm.reconstruction.objects.tracked_objects import (
    TrackedObject,
    final_labels,
    mask_position,
    most_similar_object,
)


class ObjectTracker:
    """Assignment of labels to moving objects, frame by frame."""

    def __init__(
        self,
        motion: ImageMotion,
        evidence: Sequence[Evidence],  # of every frame
        # the same, accumulated over the frames around it
        accumulated: Sequence[Evidence],
    ) -> None:
        self._motion, self._evidence, self._accumulated = motion, evidence, accumulated
        self._objects: dict[int, TrackedObject] = {}
        self._touching_frames: dict[tuple[int, int], int] = {}

    def labels(self) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, (H, W) uint8, in the size of the image motion.

        Static pixels have 0. Objects are numbered from 1 in the order in which they appear.
        """
        result: DiskCache[np.ndarray] = DiskCache(lambda labels: (labels,), lambda labels: labels)
        previous = None
        for frame in range(len(self._motion)):
            previous = self._label_frame(frame, previous)
            result.append(previous)
        table = final_labels(self._objects, self._touching_frames, len(self._motion))
        for labels in result:
            yield table[labels]

    def _label_frame(self, frame: int, previous: np.ndarray | None) -> np.ndarray:
        """Return the labels of a frame, (H, W) int32, from the labels of the previous frame."""
        grey = self._motion.grey(frame)
        labels = np.zeros(grey.shape, np.int32)
        propagated = np.zeros_like(labels) if previous is None else self._propagate(frame, previous)
        objects = self._objects.values()
        confirmed = [obj.id for obj in objects if obj.core_frames >= OBJECTS.min_object_frames]
        motions = SmoothMotions(self._motion, frame)
        expected = self._expected_evidence(frame, propagated, confirmed, motions)
        regions = list(find_moving_regions(grey, self._accumulated[frame], expected))
        for region, _ in regions:
            counts = np.bincount(propagated[region], minlength=1)
            counts[0] = 0
            min_pixels = min(
                OBJECTS.min_propagated_share * region.sum(), smallest_object(region.size) / 2
            )
            ids = [int(k) for k in np.flatnonzero(counts) if counts[k] >= min_pixels]
            if not ids:
                ids = [self._find_object(frame, region, labels, propagated)]
                labels[region] = ids[0]
            else:
                labels[region] = fill_nearest(propagated, region & np.isin(propagated, ids))[region]
            self._assign_by_motion(frame, region, ids, labels, propagated, motions)
        labels = refine_boundaries(labels, self._motion, frame)
        self._update(frame, labels, regions, motions)
        return labels

    def _expected_evidence(
        self,
        frame: int,
        propagated: np.ndarray,  # (H, W) int32: propagated labels of the previous frame
        ids: Sequence[int],  # ids of objects that moved in several frames
        motions: SmoothMotions,
    ) -> np.ndarray:
        """Return evidence that is added where known objects are expected, (H, W) float32."""
        expected = np.float32(OBJECTS.known_object_bonus) * np.isin(propagated, ids)
        counts = np.bincount(propagated.ravel())
        for number in ids:
            obj = self._objects[number]
            if obj.last_frame != frame - 1 or number >= len(counts):
                continue
            if counts[number] >= smallest_object(propagated.size) / 2 and obj.is_clear(
                int(counts[number])
            ):
                is_shared = motions.shared_motion(propagated == number, propagated > 0)
                expected[is_shared] = OBJECTS.shared_motion_bonus
        return expected

    def _assign_by_motion(
        self,
        frame: int,
        region: np.ndarray,  # (H, W) bool
        ids: list[int],  # ids of objects that the region may show
        labels: np.ndarray,  # (H, W) int32, modified in place
        propagated: np.ndarray,  # (H, W) int32: propagated labels of the previous frame
        motions: SmoothMotions,
    ) -> None:
        """Assign each pixel of a region to the object whose motion fits the pixel best.

        Connected pixels that no known motion fits become an object that was occluded, or a new one.
        """
        errors: dict[int, np.ndarray] = {}  # by object id: distance of pixels from its motion, px
        # smallest error of each pixel, in standard deviations of the motion
        relative_errors = np.full(region.shape, np.inf, np.float32)
        min_deviation = np.inf
        for number in ids:
            obj = self._objects[number]
            is_tracked = obj.last_frame == frame - 1
            pixels = region & (propagated == number)
            if pixels.sum() < OBJECTS.min_motion_pixels:
                pixels = region & (labels == number)
            visible_share = pixels.sum() / max(1, obj.mask.sum()) if is_tracked else 1.0
            terms: Terms = 3 if visible_share >= OBJECTS.min_affine_visible_share else 1
            if visible_share >= OBJECTS.min_quadratic_visible_share:
                terms = 6
            velocity = obj.velocity if is_tracked else None
            errors[number], deviation = motions.residuals_from(pixels, velocity, terms=terms)
            min_deviation = min(min_deviation, deviation)
            relative_errors = np.minimum(relative_errors, errors[number] / deviation)
            if is_tracked:
                errors[number][~self._predicted_mask(obj)] = np.inf
        outliers = np.uint8(region & (relative_errors > OBJECTS.max_motion_deviations))
        outlier_mask = cv2.morphologyEx(outliers, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        count, components, statistics, _ = cv2.connectedComponentsWithStats(
            outlier_mask, connectivity=4
        )
        for k in range(1, count):
            part = components == k
            if statistics[k, cv2.CC_STAT_AREA] < smallest_object(region.size):
                continue
            part_errors, _ = motions.residuals_from(part)
            min_errors = np.min([error[part] for error in errors.values()], axis=0)
            if np.median(part_errors[part]) > OBJECTS.max_new_error_ratio * np.median(min_errors):
                continue
            other_labels = np.where(part, 0, labels), np.where(part, 0, propagated)
            number = self._find_object(frame, part, *other_labels)
            labels[part], errors[number] = number, part_errors
        if len(errors) < 2:
            return
        left, top, width, height = cv2.boundingRect(np.uint8(region))
        window = np.s_[top : top + height, left : left + width]
        clipped_errors = np.stack([error[window] for error in errors.values()])
        clipped_errors = np.minimum(clipped_errors, OBJECTS.max_motion_error)
        min_errors = clipped_errors.min(axis=0)
        # Where no motion fits, only a clear difference between errors counts.
        tolerance = min_deviation**2 + (OBJECTS.relative_error_tolerance * min_errors) ** 2
        costs = np.minimum((clipped_errors**2 - min_errors**2) / tolerance, OBJECTS.max_motion_cost)
        numbers = np.array(list(errors))
        costs += OBJECTS.identity_change_cost * (labels[window] != numbers[:, None, None])
        has_motion = motions.valid[window] & region[window]
        weight = np.where(has_motion, OBJECTS.known_motion_weight, OBJECTS.unknown_motion_weight)
        grey = np.ascontiguousarray(self._motion.grey(frame)[window])
        best_ids = numbers[Potts(grey).assign(costs.astype(np.float32), weight.astype(np.float32))]
        labels[window][region[window]] = best_ids[region[window]]

    @staticmethod
    def _predicted_mask(obj: TrackedObject, *, enlarge: bool = True) -> np.ndarray:
        """Return the predicted mask of an object in the next frame, dilated if `enlarge`."""
        x, y = obj.velocity
        shifted_mask = cv2.warpAffine(
            np.uint8(obj.mask), np.array([[1, 0, x], [0, 1, y]]), obj.mask.shape[::-1]
        )
        if not enlarge:
            return shifted_mask > 0
        side = 1 + 2 * round(OBJECTS.search_margin * obj.mask.sum() ** 0.5 + 1)
        return cv2.dilate(shifted_mask, np.ones((side, side), np.uint8)) > 0

    def _find_object(
        self, frame: int, region: np.ndarray, labels: np.ndarray, propagated: np.ndarray
    ) -> int:
        """Return the id of the occluded object that reappears in a region, or of a new object."""
        visible_ids = set(np.unique(labels)) | set(np.unique(propagated))
        size = region.sum()
        candidates = [
            obj
            for obj in self._objects.values()
            if obj.id not in visible_ids and size > OBJECTS.min_reappeared_share * obj.mask.sum()
        ]
        histogram = self._histogram(frame, region)
        reappeared_id = most_similar_object(candidates, frame, mask_position(region), histogram)
        if reappeared_id:
            return reappeared_id
        number = 1 + max(self._objects, default=0)
        self._objects[number] = TrackedObject(
            id=number,
            last_frame=frame,
            mask=np.zeros(region.shape, bool),
            velocity=np.zeros(2),
            histogram=np.zeros(OBJECTS.histogram_bins),
        )
        return number

    def _update(
        self,
        frame: int,
        labels: np.ndarray,
        regions: Sequence[tuple[np.ndarray, bool]],  # from `find_moving_regions`
        motions: SmoothMotions,
    ) -> None:
        """Update the state of the objects in a frame, and count their touching pairs."""
        flow, own = motions.flow, self._evidence[frame]
        for number in np.unique(labels[labels > 0]):
            obj, mask = self._objects[number], labels == number
            neighbourhood = cv2.dilate(np.uint8(mask), np.ones((5, 5), np.uint8)) > 0
            is_unoccluded = not (neighbourhood & (labels > 0) & ~mask).any()
            is_tracked = obj.last_frame == frame - 1
            predicted = self._predicted_mask(obj, enlarge=False) if is_tracked else mask
            min_visible = OBJECTS.min_quadratic_visible_share * predicted.sum()
            is_reliable = is_unoccluded or mask.sum() >= min_visible
            obj.mask = mask if is_unoccluded else predicted | mask if is_reliable else predicted
            obj.last_frame = frame
            obj.pixel_count += int(mask.sum())
            velocity = np.median(flow[mask], axis=0).astype(np.float64)
            if is_reliable:
                obj.velocity, obj.histogram = velocity, self._histogram(frame, mask)
            surroundings = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
            surroundings &= labels == 0
            surrounding_flow = flow[surroundings] if surroundings.any() else np.zeros((1, 2))
            obj.motions[frame] = velocity - np.median(surrounding_flow, axis=0)
            obj.positions[frame] = mask_position(mask)
            obj.evidence[frame] = float(own.total[mask].sum() / max(own.weight[mask].sum(), 1e-6))
        components = cv2.connectedComponents((labels > 0).astype(np.uint8), connectivity=4)[1]
        for region, has_core in regions:
            for number in np.unique(labels[region & (labels > 0)]):
                self._objects[int(number)].add_core(has_core)
        for component in range(1, components.max() + 1):
            ids = [int(number) for number in np.unique(labels[components == component])]
            for i, first in enumerate(ids):
                for second in ids[i + 1 :]:
                    pair = first, second
                    self._touching_frames[pair] = self._touching_frames.get(pair, 0) + 1

    def _propagate(self, frame: int, previous: np.ndarray) -> np.ndarray:
        """Return the labels of the previous frame, propagated by the image motion; 0 if unknown."""
        backward = self._motion.backward(frame)
        propagated = sample_image(
            previous.astype(np.float32), pixel_grid(previous.shape) + backward, nearest=True
        )
        is_consistent = consistency_mask(backward, self._motion.forward(frame - 1)) > 0
        return np.where(is_consistent, propagated.astype(np.int32), 0)

    def _histogram(self, frame: int, mask: np.ndarray) -> np.ndarray:
        grey = self._motion.grey(frame)[mask]
        counts, _ = np.histogram(grey, OBJECTS.histogram_bins, (0, 256))
        return counts / max(1, counts.sum())
