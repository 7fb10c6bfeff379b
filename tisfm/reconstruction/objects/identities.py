"""Labels of moving objects, whose ids persist from frame to frame and through occlusion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

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
from tisfm.reconstruction.objects.boundaries import refine_boundaries
from tisfm.reconstruction.objects.motion_evidence import Evidence
from tisfm.reconstruction.objects.moving_regions import find_moving_regions
from tisfm.reconstruction.objects.smooth_motion import MIN_PIXELS, SmoothMotions, Terms

# Values without a stated source were set by hand.
# A region shows a known object if this share of its pixels has the propagated label.
MIN_PROPAGATED = 0.1
# Frames for which an object may be occluded and still keep its id.
MAX_OCCLUSION = 15
# Smallest overlap of two grey-level histograms of the same object, 0 to 1.
MIN_HISTOGRAM_OVERLAP = 0.6
# Largest distance from the predicted position after occlusion, in sizes of the object.
MAX_DISTANCE = 1.5
# Growth of this distance with each occluded frame, as a share.
DISTANCE_GROWTH = 0.1
# Share of an occluded object that has to reappear before it is recognised.
MIN_REAPPEARED = 0.2
# Bins of a grey-level histogram.
BINS = 16
# Reach of an object beyond its predicted mask, in sizes of the object.
REACH_SHARE = 0.1
# Visible share of an object that is needed for a quadratic motion.
MIN_QUADRATIC = 0.5
# Visible share of an object that is needed for an affine motion; with less, one velocity is fitted.
MIN_AFFINE = 0.15
# Standard deviations from the motion of an object beyond which pixels belong to another object.
MAX_MOTION_DEVIATIONS = 4.0
# Largest error of such pixels from a motion fitted to them, as a share of their error from the
# known motions.
MAX_OWN_ERROR = 0.5
# px: limit of the errors of a motion.
MAX_ERROR = 1e3
# Tolerance between motions where none fits, as a share of the smallest error of the pixel.
ERROR_TOLERANCE = 0.5
# Largest cost of a motion, in squared ratios of its error to the usual error.
MAX_COST = 16.0
# Cost of a label that differs from the propagated one, in the same unit.
CHANGE_COST = 2.0
# Data weight of pixels of a region with known motion, of 1.
KNOWN_WEIGHT = 0.5
# Data weight of all other pixels.
UNKNOWN_WEIGHT = 0.02
# Largest label: in given labels, 255 marks ignored pixels.
MAX_OBJECTS = 254
# Frames in which an object has to be seen.
MIN_FRAMES = 4
# An object is a part of a larger object if they touch in this share of the frames of the smaller
# one, and their motions differ by less than MAX_SAME_MOTION,
MIN_TOUCHING = 0.7
# or if they touch in this share of the frames of the smaller one,
MIN_TOUCHING_LOOSE = 0.3
# and in this share of the frames with both objects, and their motions differ by less than
# MAX_SIMILAR_MOTION.
MIN_TOUCHING_OF_BOTH = 0.6
# Difference of two motions, as a share of the faster one.
MAX_SAME_MOTION = 0.3
MAX_SIMILAR_MOTION = 0.9


@dataclass(kw_only=True)
class _Object:
    """The state of an object."""

    id: int
    last_frame: int  # the last frame in which it was labelled
    mask: np.ndarray  # (H, W) bool: its mask in that frame, with its occluded parts
    velocity: np.ndarray  # (2,) float64: its mean motion in that frame, px/frame
    histogram: np.ndarray  # (BINS,) float64: its grey-level histogram; the sum is 1
    core_frames: int = 0  # number of frames in which its region has a core (`find_moving_regions`)
    pixel_count: int = 0  # its labelled pixels in all frames
    # dict of int to (2,) float64: by frame: its mean motion minus the motion of its surroundings,
    # px/frame
    motions: dict[int, np.ndarray] = field(default_factory=dict)
    # dict of int to (3,) float64: by frame: its centre, (x, y), and its size, the square root of
    # its area, px
    positions: dict[int, np.ndarray] = field(default_factory=dict)

    def center(self) -> np.ndarray:
        """Return the centre of its last mask, (x, y) px."""
        return _center(self.mask)


class ObjectTracker:
    """Labels moving objects, frame by frame."""

    def __init__(
        self,
        motion: ImageMotion,
        # evidence of every frame, accumulated over the frames around it
        evidence: Sequence[Evidence],
    ) -> None:
        self._motion, self._evidence = motion, evidence
        self._objects: dict[int, _Object] = {}
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
        table = self._final_labels()
        for labels in result:
            yield table[labels]

    def _label_frame(self, frame: int, previous: np.ndarray | None) -> np.ndarray:
        """Return the labels of a frame, (H, W) int32, from the labels of the previous frame."""
        grey = self._motion.grey(frame)
        labels = np.zeros(grey.shape, np.int32)
        propagated = np.zeros_like(labels) if previous is None else self._propagate(frame, previous)
        confirmed_ids = [
            number for number, obj in self._objects.items() if obj.core_frames >= MIN_FRAMES
        ]
        regions = list(
            find_moving_regions(grey, self._evidence[frame], np.isin(propagated, confirmed_ids))
        )
        motions = SmoothMotions(self._motion, frame)
        for region, _ in regions:
            counts = np.bincount(propagated[region], minlength=1)
            counts[0] = 0
            min_pixels = min(MIN_PROPAGATED * region.sum(), self._min_pixels(region) / 2)
            ids = [int(k) for k in np.flatnonzero(counts) if counts[k] >= min_pixels]
            if not ids:
                ids = [
                    self._find_reappeared(frame, region, labels, propagated)
                    or self._new_object(frame)
                ]
                labels[region] = ids[0]
            else:
                labels[region] = fill_nearest(propagated, region & np.isin(propagated, ids))[region]
            self._assign_by_motion(frame, region, ids, labels, propagated, motions)
        labels = refine_boundaries(labels, self._motion, frame)
        self._update(frame, labels, regions, motions)
        return labels

    def _assign_by_motion(
        self,
        frame: int,
        region: np.ndarray,
        ids: list[int],
        labels: np.ndarray,
        propagated: np.ndarray,
        motions: SmoothMotions,
    ) -> None:
        """Assign each pixel of a region to the object whose motion it follows.

        Pixels that follow no known motion become an object that was occluded, or a new one.
        """
        errors: dict[int, np.ndarray] = {}  # error of each motion, px
        min_deviations = np.full(
            region.shape, np.inf, np.float32
        )  # smallest error, in standard deviations
        scale = np.inf
        for number in ids:
            obj = self._objects[number]
            is_tracked = obj.last_frame == frame - 1
            pixels = region & (propagated == number)
            pixels = pixels if pixels.sum() >= MIN_PIXELS else region & (labels == number)
            visible = pixels.sum() / max(1, obj.mask.sum()) if is_tracked else 1.0
            terms: Terms = 6 if visible >= MIN_QUADRATIC else 3 if visible >= MIN_AFFINE else 1
            velocity = obj.velocity if is_tracked else None
            errors[number], deviation = motions.residuals_from(pixels, velocity, terms=terms)
            scale = min(scale, deviation)
            min_deviations = np.minimum(min_deviations, errors[number] / deviation)
            if is_tracked:
                errors[number][~self._predicted_mask(obj)] = np.inf
        outliers = np.uint8(region & (min_deviations > MAX_MOTION_DEVIATIONS))
        opened = cv2.morphologyEx(outliers, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        count, components, statistics, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
        for k in range(1, count):
            part = components == k
            if statistics[k, cv2.CC_STAT_AREA] < self._min_pixels(region):
                continue
            own_errors, _ = motions.residuals_from(part)
            nearest = np.min([error[part] for error in errors.values()], axis=0)
            if np.median(own_errors[part]) > MAX_OWN_ERROR * np.median(nearest):
                continue
            other_labels, other_propagated = (
                np.where(part, 0, labels),
                np.where(part, 0, propagated),
            )
            number = self._find_reappeared(
                frame, part, other_labels, other_propagated
            ) or self._new_object(frame)
            labels[part], errors[number] = number, own_errors
        if len(errors) < 2:
            return
        top, left, height, width = _box(region)
        window = np.s_[top : top + height, left : left + width]
        distances = np.stack([np.minimum(error[window], MAX_ERROR) for error in errors.values()])
        nearest = distances.min(axis=0)
        tolerance = (
            scale**2 + (ERROR_TOLERANCE * nearest) ** 2
        )  # where no motion fits, only a clear difference counts
        costs = np.minimum((distances**2 - nearest**2) / tolerance, MAX_COST)
        numbers = np.array(list(errors))
        costs += CHANGE_COST * (labels[window] != numbers[:, None, None])
        weight = np.where(
            motions.valid[window] & region[window], KNOWN_WEIGHT, UNKNOWN_WEIGHT
        ).astype(np.float32)
        grey = np.ascontiguousarray(self._motion.grey(frame)[window])
        best = numbers[Potts(grey).assign(costs.astype(np.float32), weight)]
        labels[window][region[window]] = best[region[window]]

    @staticmethod
    def _predicted_mask(obj: _Object, *, enlarge: bool = True) -> np.ndarray:
        """Return the mask of an object predicted for the next frame, enlarged if `enlarge`."""
        x, y = obj.velocity
        shifted = cv2.warpAffine(
            np.uint8(obj.mask), np.array([[1, 0, x], [0, 1, y]]), obj.mask.shape[::-1]
        )
        if not enlarge:
            return shifted > 0
        side = 1 + 2 * round(REACH_SHARE * obj.mask.sum() ** 0.5 + 1)
        return cv2.dilate(shifted, np.ones((side, side), np.uint8)) > 0

    def _find_reappeared(
        self, frame: int, region: np.ndarray, labels: np.ndarray, propagated: np.ndarray
    ) -> int:
        """Return the id of the occluded object that reappears in a region; 0 for none."""
        visible_ids = set(np.unique(labels)) | set(np.unique(propagated))
        position = np.array([*_center(region), region.sum() ** 0.5])
        histogram = self._histogram(frame, region)
        max_similarity, best_id = 0.0, 0
        for obj in self._objects.values():
            gap = frame - obj.last_frame
            is_occluded = obj.id not in visible_ids and 0 < gap <= MAX_OCCLUSION + 1
            if not is_occluded or region.sum() <= MIN_REAPPEARED * obj.mask.sum():
                continue
            similarity = self._similarity(obj, position, histogram, gap)
            if similarity > max_similarity:
                max_similarity, best_id = similarity, obj.id
        return best_id

    @staticmethod
    def _similarity(obj: _Object, position: np.ndarray, histogram: np.ndarray, gap: int) -> float:
        """Return the likeness of a region and an object last seen `gap` frames ago; 0 for none."""
        if not obj.mask.any():
            return 0.0
        size = max(position[2], obj.mask.sum() ** 0.5)
        expected = obj.center() + gap * obj.velocity
        distance = float(
            np.linalg.norm(position[:2] - expected) / (size * (1 + DISTANCE_GROWTH * gap))
        )
        overlap = float(np.sqrt(histogram * obj.histogram).sum())
        return (
            overlap / (1 + distance)
            if distance < MAX_DISTANCE and overlap > MIN_HISTOGRAM_OVERLAP
            else 0.0
        )

    def _new_object(self, frame: int) -> int:
        number = 1 + max(self._objects, default=0)
        empty = np.zeros(self._motion.grey(frame).shape, bool)
        self._objects[number] = _Object(
            id=number,
            last_frame=frame,
            mask=empty,
            velocity=np.zeros(2),
            histogram=np.zeros(BINS),
        )
        return number

    def _update(
        self,
        frame: int,
        labels: np.ndarray,
        regions: Sequence[tuple[np.ndarray, bool]],
        motions: SmoothMotions,
    ) -> None:
        """Update the state of the objects in a frame, and count the pairs that touch."""
        flow = motions.flow
        for number in np.unique(labels[labels > 0]):
            obj, mask = self._objects[number], labels == number
            neighbourhood = cv2.dilate(np.uint8(mask), np.ones((5, 5), np.uint8)) > 0
            is_unoccluded = not (neighbourhood & (labels > 0) & ~mask).any()
            predicted = (
                self._predicted_mask(obj, enlarge=False) if obj.last_frame == frame - 1 else mask
            )
            is_reliable = is_unoccluded or mask.sum() >= MIN_QUADRATIC * predicted.sum()
            obj.mask = mask if is_unoccluded else predicted | mask if is_reliable else predicted
            obj.last_frame = frame
            obj.pixel_count += int(mask.sum())
            velocity = np.median(flow[mask], axis=0).astype(np.float64)
            if is_reliable:
                obj.velocity, obj.histogram = velocity, self._histogram(frame, mask)
            surroundings = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
            surroundings &= labels == 0
            background = (
                np.median(flow[surroundings], axis=0) if surroundings.any() else np.zeros(2)
            )
            obj.motions[frame] = velocity - background
            obj.positions[frame] = np.array([*_center(mask), mask.sum() ** 0.5])
        components = cv2.connectedComponents((labels > 0).astype(np.uint8), connectivity=4)[1]
        for region, has_core in regions:
            for number in np.unique(labels[region & (labels > 0)]):
                self._objects[int(number)].core_frames += has_core
        for component in range(1, components.max() + 1):
            ids = [int(number) for number in np.unique(labels[components == component])]
            for i, first in enumerate(ids):
                for second in ids[i + 1 :]:
                    pair = first, second
                    self._touching_frames[pair] = self._touching_frames.get(pair, 0) + 1

    def _final_labels(self) -> np.ndarray:
        """Return the final label of each object, (K,) uint8; 0 for an object that is dropped."""
        count = 1 + max(self._objects, default=0)
        root = np.arange(count)  # the object that each object is a part of
        by_size = sorted(self._objects, key=lambda k: self._objects[k].pixel_count)
        for index, smaller in enumerate(by_size):
            larger = [k for k in by_size[index + 1 :] if self._is_part_of(smaller, k)]
            if larger:
                root[smaller] = larger[-1]  # the largest
        for smaller in reversed(by_size):  # larger objects first
            root[smaller] = root[root[smaller]]
        for later in sorted(self._objects):  # objects that reappear
            if root[later] == later and (earlier := self._earlier_object(later, root)):
                root[root == later] = root[earlier]
        table, number = np.zeros(count, np.uint8), 0
        for obj in sorted(self._objects):
            if root[obj] != obj:
                continue
            members = np.flatnonzero(root == obj)
            frames = {frame for k in members for frame in self._objects[int(k)].motions}
            min_frames = min(MIN_FRAMES, len(self._motion))
            core_frames = sum(self._objects[int(k)].core_frames for k in members)
            if len(frames) >= min_frames and core_frames >= min_frames - 1 and number < MAX_OBJECTS:
                number += 1
                table[members] = number
        return table

    def _earlier_object(self, later: int, root: np.ndarray) -> int:
        """Return the object, occluded earlier, that looks like a later one; 0 for none."""
        obj = self._objects[later]
        frames = [f for k in np.flatnonzero(root == later) for f in self._objects[int(k)].motions]
        if not frames:  # the refined boundary left no pixel of the object
            return 0
        first = min(frames)
        max_similarity, best_id = 0.0, 0
        for other in self._objects.values():
            gap = first - other.last_frame
            if not 0 < gap <= MAX_OCCLUSION + 1 or first not in obj.positions:
                continue
            similarity = self._similarity(other, obj.positions[first], obj.histogram, gap)
            if similarity > max_similarity:
                max_similarity, best_id = similarity, other.id
        return best_id

    def _is_part_of(self, smaller: int, larger: int) -> bool:
        """Return whether an object is a part of another one: they touch and move alike."""
        touching_frames = self._pair_count(self._touching_frames, smaller, larger)
        smaller_motions, larger_motions = (
            self._objects[smaller].motions,
            self._objects[larger].motions,
        )
        common_frames = len(smaller_motions.keys() & larger_motions.keys())
        if touching_frames < max(1, MIN_TOUCHING_LOOSE * len(smaller_motions)) or not common_frames:
            return False
        difference = self._motion_difference(smaller, larger)
        if touching_frames >= MIN_TOUCHING * len(smaller_motions) and difference < MAX_SAME_MOTION:
            return True
        return (
            touching_frames >= MIN_TOUCHING_OF_BOTH * common_frames
            and difference < MAX_SIMILAR_MOTION
        )

    @staticmethod
    def _pair_count(counts: dict[tuple[int, int], int], first: int, second: int) -> int:
        return counts.get((min(first, second), max(first, second)), 0)

    def _motion_difference(self, first: int, second: int) -> float:
        """Return the difference of the motions of two objects, as a share of the faster one."""
        motions0, motions1 = self._objects[first].motions, self._objects[second].motions
        frames = sorted(motions0.keys() & motions1.keys())
        differences = np.linalg.norm([motions0[f] - motions1[f] for f in frames], axis=1)
        speeds = np.maximum(
            *(np.linalg.norm([m[f] for f in frames], axis=1) for m in (motions0, motions1))
        )
        return float(np.median(differences) / max(np.median(speeds), 1e-9))

    def _propagate(self, frame: int, previous: np.ndarray) -> np.ndarray:
        """Return the labels of the previous frame, propagated by the image motion; 0 for none."""
        backward = self._motion.backward(frame)
        propagated = sample_image(
            previous.astype(np.float32), pixel_grid(previous.shape) + backward, nearest=True
        )
        consistent = consistency_mask(backward, self._motion.forward(frame - 1)) > 0
        return np.where(consistent, propagated.astype(np.int32), 0)

    def _histogram(self, frame: int, mask: np.ndarray) -> np.ndarray:
        grey = self._motion.grey(frame)[mask]
        counts, _ = np.histogram(grey, BINS, (0, 256))
        return counts / max(1, counts.sum())

    def _min_pixels(self, image: np.ndarray) -> int:
        return smallest_object(image.size)


def _center(mask: np.ndarray) -> np.ndarray:
    """Return the centre of a mask, (x, y) px."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


def _box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Return the top, left, height and width of the bounding box of a mask."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return top, left, height, width
