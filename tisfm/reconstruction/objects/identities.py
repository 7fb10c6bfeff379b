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
    pixel_grid,
    returns_to_start,
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
    seen: int  # the last frame in which it was labelled
    whole: np.ndarray  # (H, W) bool: its mask in that frame, with its occluded parts
    velocity: np.ndarray  # (2,) float64: its mean motion in that frame, px/frame
    look: np.ndarray  # (BINS,) float64: its grey-level histogram; the sum is 1
    core: int = 0  # number of frames in which its region has a core (`find_moving_regions`)
    pixels: int = 0  # its labelled pixels in all frames
    # dict of int to (2,) float64: by frame: its mean motion minus the motion of its surroundings,
    # px/frame
    motions: dict[int, np.ndarray] = field(default_factory=dict)
    # dict of int to (3,) float64: by frame: its centre, (x, y), and its size, the square root of
    # its area, px
    places: dict[int, np.ndarray] = field(default_factory=dict)

    def center(self) -> np.ndarray:
        """Return the centre of its last mask, (x, y) px."""
        return _center(self.whole)


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
        self._touching: dict[tuple[int, int], int] = {}

    def labels(self) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, (H, W) uint8, in the size of the image motion.

        Static pixels have 0. Objects are numbered from 1 in the order in which they appear.
        """
        found: DiskCache[np.ndarray] = DiskCache(lambda labels: (labels,), lambda labels: labels)
        before = None
        for frame in range(len(self._motion)):
            before = self._label_frame(frame, before)
            found.append(before)
        table = self._final_labels()
        for labels in found:
            yield table[labels]

    def _label_frame(self, frame: int, before: np.ndarray | None) -> np.ndarray:
        """Return the labels of a frame, (H, W) int32, from the labels of the previous frame."""
        grey = self._motion.grey(frame)
        labels = np.zeros(grey.shape, np.int32)
        carried = np.zeros_like(labels) if before is None else self._propagate(frame, before)
        sure = [number for number, obj in self._objects.items() if obj.core >= MIN_FRAMES]
        regions = list(find_moving_regions(grey, self._evidence[frame], np.isin(carried, sure)))
        motions_of = SmoothMotions(self._motion, frame)
        for region, _ in regions:
            counts = np.bincount(carried[region], minlength=1)
            counts[0] = 0
            enough = min(MIN_PROPAGATED * region.sum(), self._smallest(region) / 2)
            known = [int(k) for k in np.flatnonzero(counts) if counts[k] >= enough]
            if not known:
                known = [
                    self._reappeared(frame, region, labels, carried) or self._new_object(frame)
                ]
                labels[region] = known[0]
            else:
                labels[region] = fill_nearest(carried, region & np.isin(carried, known))[region]
            self._assign_by_motion(frame, region, known, labels, carried, motions_of)
        labels = refine_boundaries(labels, self._motion, frame)
        self._update(frame, labels, regions, motions_of)
        return labels

    def _assign_by_motion(
        self,
        frame: int,
        region: np.ndarray,
        known: list[int],
        labels: np.ndarray,
        carried: np.ndarray,
        motions_of: SmoothMotions,
    ) -> None:
        """Assign each pixel of a region to the object whose motion it follows.

        Pixels that follow no known motion become an object that was occluded, or a new one.
        """
        far: dict[int, np.ndarray] = {}  # error of each motion, px
        unlike = np.full(region.shape, np.inf, np.float32)  # smallest error, in standard deviations
        usual = np.inf
        for number in known:
            obj = self._objects[number]
            followed = obj.seen == frame - 1
            mine = region & (carried == number)
            mine = mine if mine.sum() >= MIN_PIXELS else region & (labels == number)
            share = mine.sum() / max(1, obj.whole.sum()) if followed else 1.0
            terms: Terms = 6 if share >= MIN_QUADRATIC else 3 if share >= MIN_AFFINE else 1
            velocity = obj.velocity if followed else None
            far[number], deviation = motions_of.beside(mine, velocity, terms=terms)
            usual = min(usual, deviation)
            unlike = np.minimum(unlike, far[number] / deviation)
            if followed:
                far[number][~self._predicted_mask(obj)] = np.inf
        rest = np.uint8(region & (unlike > MAX_MOTION_DEVIATIONS))
        opened = cv2.morphologyEx(rest, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        count, numbered, statistics, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
        for k in range(1, count):
            piece = numbered == k
            if statistics[k, cv2.CC_STAT_AREA] < self._smallest(region):
                continue
            own, _ = motions_of.beside(piece)
            nearest = np.min([one[piece] for one in far.values()], axis=0)
            if np.median(own[piece]) > MAX_OWN_ERROR * np.median(nearest):
                continue
            there, gone = np.where(piece, 0, labels), np.where(piece, 0, carried)
            number = self._reappeared(frame, piece, there, gone) or self._new_object(frame)
            labels[piece], far[number] = number, own
        if len(far) < 2:
            return
        top, left, height, width = _box(region)
        window = np.s_[top : top + height, left : left + width]
        distance = np.stack([np.minimum(one[window], MAX_ERROR) for one in far.values()])
        nearest = distance.min(axis=0)
        tolerated = (
            usual**2 + (ERROR_TOLERANCE * nearest) ** 2
        )  # where no motion fits, only a clear difference counts
        costs = np.minimum((distance**2 - nearest**2) / tolerated, MAX_COST)
        numbers = np.array(list(far))
        costs += CHANGE_COST * (labels[window] != numbers[:, None, None])
        weight = np.where(
            motions_of.known[window] & region[window], KNOWN_WEIGHT, UNKNOWN_WEIGHT
        ).astype(np.float32)
        grey = np.ascontiguousarray(self._motion.grey(frame)[window])
        best = numbers[Potts(grey).assign(costs.astype(np.float32), weight)]
        labels[window][region[window]] = best[region[window]]

    @staticmethod
    def _predicted_mask(obj: _Object, *, grown: bool = True) -> np.ndarray:
        """Return the mask of an object predicted for the next frame, enlarged if `grown`."""
        x, y = obj.velocity
        shifted = cv2.warpAffine(
            np.uint8(obj.whole), np.array([[1, 0, x], [0, 1, y]]), obj.whole.shape[::-1]
        )
        if not grown:
            return shifted > 0
        side = 1 + 2 * round(REACH_SHARE * obj.whole.sum() ** 0.5 + 1)
        return cv2.dilate(shifted, np.ones((side, side), np.uint8)) > 0

    def _reappeared(
        self, frame: int, region: np.ndarray, labels: np.ndarray, carried: np.ndarray
    ) -> int:
        """Return the id of the occluded object that reappears in a region; 0 for none."""
        there = set(np.unique(labels)) | set(np.unique(carried))
        place = np.array([*_center(region), region.sum() ** 0.5])
        look = self._histogram(frame, region)
        best, found = 0.0, 0
        for obj in self._objects.values():
            away = frame - obj.seen
            hidden = obj.id not in there and 0 < away <= MAX_OCCLUSION + 1
            if not hidden or region.sum() <= MIN_REAPPEARED * obj.whole.sum():
                continue
            alike = self._likeness(obj, place, look, away)
            if alike > best:
                best, found = alike, obj.id
        return found

    @staticmethod
    def _likeness(obj: _Object, place: np.ndarray, look: np.ndarray, away: int) -> float:
        """Return the likeness of a region and an object last seen `away` frames ago; 0 for none."""
        if not obj.whole.any():
            return 0.0
        size = max(place[2], obj.whole.sum() ** 0.5)
        expected = obj.center() + away * obj.velocity
        far = float(np.linalg.norm(place[:2] - expected) / (size * (1 + DISTANCE_GROWTH * away)))
        alike = float(np.sqrt(look * obj.look).sum())
        return alike / (1 + far) if far < MAX_DISTANCE and alike > MIN_HISTOGRAM_OVERLAP else 0.0

    def _new_object(self, frame: int) -> int:
        number = 1 + max(self._objects, default=0)
        nowhere = np.zeros(self._motion.grey(frame).shape, bool)
        self._objects[number] = _Object(
            id=number,
            seen=frame,
            whole=nowhere,
            velocity=np.zeros(2),
            look=np.zeros(BINS),
        )
        return number

    def _update(
        self,
        frame: int,
        labels: np.ndarray,
        regions: Sequence[tuple[np.ndarray, bool]],
        motions_of: SmoothMotions,
    ) -> None:
        """Update the state of the objects in a frame, and count the pairs that touch."""
        flow = motions_of.flow
        for number in np.unique(labels[labels > 0]):
            obj, mask = self._objects[number], labels == number
            beside = cv2.dilate(np.uint8(mask), np.ones((5, 5), np.uint8)) > 0
            is_whole = not (beside & (labels > 0) & ~mask).any()
            kept = self._predicted_mask(obj, grown=False) if obj.seen == frame - 1 else mask
            known_well = is_whole or mask.sum() >= MIN_QUADRATIC * kept.sum()
            obj.whole = mask if is_whole else kept | mask if known_well else kept
            obj.seen = frame
            obj.pixels += int(mask.sum())
            moved = np.median(flow[mask], axis=0).astype(np.float64)
            if known_well:
                obj.velocity, obj.look = moved, self._histogram(frame, mask)
            around = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
            around &= labels == 0
            rest = np.median(flow[around], axis=0) if around.any() else np.zeros(2)
            obj.motions[frame] = moved - rest
            obj.places[frame] = np.array([*_center(mask), mask.sum() ** 0.5])
        moving = cv2.connectedComponents((labels > 0).astype(np.uint8), connectivity=4)[1]
        for region, core in regions:
            for number in np.unique(labels[region & (labels > 0)]):
                self._objects[int(number)].core += core
        for joined in range(1, moving.max() + 1):
            inside = [int(number) for number in np.unique(labels[moving == joined])]
            for i, first in enumerate(inside):
                for second in inside[i + 1 :]:
                    pair = first, second
                    self._touching[pair] = self._touching.get(pair, 0) + 1

    def _final_labels(self) -> np.ndarray:
        """Return the final label of each object, (K,) uint8; 0 for an object that is dropped."""
        count = 1 + max(self._objects, default=0)
        whole = np.arange(count)  # the object that each object is a part of
        by_size = sorted(self._objects, key=lambda k: self._objects[k].pixels)
        for place, region in enumerate(by_size):
            larger = [k for k in by_size[place + 1 :] if self._is_part_of(region, k)]
            if larger:
                whole[region] = larger[-1]  # the largest
        for region in reversed(by_size):  # larger objects first
            whole[region] = whole[whole[region]]
        for late in sorted(self._objects):  # objects that reappear
            if whole[late] == late and (earlier := self._same_before(late, whole)):
                whole[whole == late] = whole[earlier]
        table, number = np.zeros(count, np.uint8), 0
        for obj in sorted(self._objects):
            if whole[obj] != obj:
                continue
            same = np.flatnonzero(whole == obj)
            frames = {frame for k in same for frame in self._objects[int(k)].motions}
            lasting = min(MIN_FRAMES, len(self._motion))
            core = sum(self._objects[int(k)].core for k in same)
            if len(frames) >= lasting and core >= lasting - 1 and number < MAX_OBJECTS:
                number += 1
                table[same] = number
        return table

    def _same_before(self, late: int, whole: np.ndarray) -> int:
        """Return the object, occluded earlier, that looks like a later one; 0 for none."""
        obj = self._objects[late]
        frames = [f for k in np.flatnonzero(whole == late) for f in self._objects[int(k)].motions]
        if not frames:  # the refined boundary left no pixel of the object
            return 0
        first = min(frames)
        best, found = 0.0, 0
        for other in self._objects.values():
            away = first - other.seen
            if not 0 < away <= MAX_OCCLUSION + 1 or first not in obj.places:
                continue
            alike = self._likeness(other, obj.places[first], obj.look, away)
            if alike > best:
                best, found = alike, other.id
        return found

    def _is_part_of(self, region: int, other: int) -> bool:
        """Return whether an object is a part of another one: they touch and move alike."""
        touching = self._times(self._touching, region, other)
        mine, others = self._objects[region].motions, self._objects[other].motions
        both = len(mine.keys() & others.keys())
        if touching < max(1, MIN_TOUCHING_LOOSE * len(mine)) or not both:
            return False
        differing = self._motion_difference(region, other)
        if touching >= MIN_TOUCHING * len(mine) and differing < MAX_SAME_MOTION:
            return True
        return touching >= MIN_TOUCHING_OF_BOTH * both and differing < MAX_SIMILAR_MOTION

    @staticmethod
    def _times(counts: dict[tuple[int, int], int], first: int, second: int) -> int:
        return counts.get((min(first, second), max(first, second)), 0)

    def _motion_difference(self, first: int, second: int) -> float:
        """Return the difference of the motions of two objects, as a share of the faster one."""
        one, two = self._objects[first].motions, self._objects[second].motions
        frames = sorted(one.keys() & two.keys())
        apart = np.linalg.norm([one[f] - two[f] for f in frames], axis=1)
        fast = np.maximum(*(np.linalg.norm([m[f] for f in frames], axis=1) for m in (one, two)))
        return float(np.median(apart) / max(np.median(fast), 1e-9))

    def _propagate(self, frame: int, before: np.ndarray) -> np.ndarray:
        """Return the labels of the previous frame, propagated by the image motion; 0 for none."""
        backward = self._motion.backward(frame)
        carried = sample_image(
            before.astype(np.float32), pixel_grid(before.shape) + backward, nearest=True
        )
        returns = returns_to_start(backward, self._motion.forward(frame - 1)) > 0
        return np.where(returns, carried.astype(np.int32), 0)

    def _histogram(self, frame: int, mask: np.ndarray) -> np.ndarray:
        grey = self._motion.grey(frame)[mask]
        shares, _ = np.histogram(grey, BINS, (0, 256))
        return shares / max(1, shares.sum())

    def _smallest(self, image: np.ndarray) -> int:
        return smallest_object(image.size)


def _center(mask: np.ndarray) -> np.ndarray:
    """Return the centre of a mask, (x, y) px."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


def _box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Return the top, left, height and width of the bounding box of a mask."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return top, left, height, width
