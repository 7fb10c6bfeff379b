"""Labels of what moves, with identities that last from frame to frame and through occlusion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from tisfm.motion.objects.candidates import smallest_object
from tisfm.motion.objects.label_optimisation import Potts
from tisfm.motion.objects.layers import nearest_known
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

CARRIED = 0.1  # of a part's pixels: so many that a label is carried to are the same thing
HIDDEN = 15  # frames that a thing may be hidden
ALIKE = 0.6  # of 1: the overlap of histograms of the same thing, at least
# Of its size: how far it may be from where its motion leads, and the more of that each frame.
NEAR, FARTHER = 1.5, 0.1
REAPPEARED = 0.2  # of a thing that was hidden has to be seen, for it to be known again
BINS = 16  # of grey levels
GROWING = 0.1  # of a thing's size: how far it may reach beyond where it was
HALF, LITTLE = 0.5, 0.15  # of a thing is seen: less shows an affine motion, or a velocity, at most
OTHERWISE = 4.0  # deviations: what moves otherwise than a thing is another one
CLEARLY = 0.5  # of what a motion of others misses: a motion of its own misses less
FURTHEST, TOLERATED = 1e3, 0.5  # px; and of the least distance, what another one may be off by
MOST, OTHER_THAN_CARRIED = 16.0, 2.0  # of costs: of a motion, and of another label than before
SEEN, UNSEEN = 0.5, 0.02  # what pixels weigh: those of a part whose motion is known, and others
MOST_THINGS = 254  # 255 is for what is ignored, where labels are given
LASTING = 4  # frames, at least, of a thing
# Of the frames with a thing: where it touches a larger one in as many, it is a part of that, if
# they go together; or where it does in fewer, but in most that show both, and they go roughly
# together.
TOGETHER, TOUCHING, HARDLY_APART = 0.7, 0.3, 0.6
GOING_TOGETHER, ROUGHLY = 0.3, 0.9  # of the faster one's motion: how far that of parts may differ


@dataclass(kw_only=True)
class _Thing:
    """What is known of a thing so far.

    Attributes
    ----------
    id : int
    seen : int
        The frame in which it was labelled last.
    whole : (H, W) bool
        Where it was then, with what others hid of it.
    velocity : (2,) float64
        Its mean motion then, px/frame.
    look : (BINS,) float64
        The shares of its grey levels.
    core : int
        Frames with as much evidence as a thing has to have.
    pixels : int
        Of all frames.
    motions : dict of int to (2,) float64
        Mean motion beside that of what is around it, by frame.
    places : dict of int to (3,) float64
        Its centre, (x, y), and size, the root of its area, px, by frame.
    """

    id: int
    seen: int
    whole: np.ndarray
    velocity: np.ndarray
    look: np.ndarray
    core: int = 0
    pixels: int = 0
    motions: dict[int, np.ndarray] = field(default_factory=dict)
    places: dict[int, np.ndarray] = field(default_factory=dict)

    def center(self) -> np.ndarray:
        """Return the centre of where it was last, with what others hid of it, (x, y) px."""
        return _center(self.whole)


class Identities:
    """Labels frames one after the other.

    Parameters
    ----------
    motion : ImageMotion
    evidence : sequence of Evidence
        Of every frame, together with those around it.
    """

    def __init__(self, motion: ImageMotion, evidence: Sequence[Evidence]) -> None:
        self._motion, self._evidence = motion, evidence
        self._things: dict[int, _Thing] = {}
        self._touching: dict[tuple[int, int], int] = {}

    def labels(self) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, (H, W) uint8, in the size of the image motion's.

        They are 0 for what is at rest, and else from 1 on, in the order in which things appear.
        """
        found: DiskCache[np.ndarray] = DiskCache(lambda labels: (labels,), lambda labels: labels)
        before = None
        for frame in range(len(self._motion)):
            before = self._labelled(frame, before)
            found.append(before)
        table = self._lasting()
        for labels in found:
            yield table[labels]

    def _labelled(self, frame: int, before: np.ndarray | None) -> np.ndarray:
        """Return the labels of a frame, (H, W) int32, after those of the frame before."""
        grey = self._motion.grey(frame)
        labels = np.zeros(grey.shape, np.int32)
        carried = np.zeros_like(labels) if before is None else self._carried(frame, before)
        sure = [number for number, thing in self._things.items() if thing.core >= LASTING]
        parts = list(find_moving_regions(grey, self._evidence[frame], np.isin(carried, sure)))
        moves = SmoothMotions(self._motion, frame)
        for part, _ in parts:
            counts = np.bincount(carried[part], minlength=1)
            counts[0] = 0
            enough = min(CARRIED * part.sum(), self._smallest(part) / 2)
            known = [int(k) for k in np.flatnonzero(counts) if counts[k] >= enough]
            if not known:
                known = [self._again(frame, part, labels, carried) or self._begun(frame)]
                labels[part] = known[0]
            else:
                labels[part] = nearest_known(carried, part & np.isin(carried, known))[part]
            self._by_motion(frame, part, known, labels, carried, moves)
        labels = refine_boundaries(labels, self._motion, frame)
        self._note(frame, labels, parts, moves)
        return labels

    def _by_motion(
        self,
        frame: int,
        part: np.ndarray,
        known: list[int],
        labels: np.ndarray,
        carried: np.ndarray,
        moves: SmoothMotions,
    ) -> None:
        """Let motions decide which of several things a pixel of a part belongs to.

        What moves otherwise than all of them is a thing that was hidden, or another one.
        """
        far: dict[int, np.ndarray] = {}  # px
        unlike = np.full(part.shape, np.inf, np.float32)  # deviations of what is nearest
        usual = np.inf
        for number in known:
            thing = self._things[number]
            followed = thing.seen == frame - 1
            mine = part & (carried == number)
            mine = mine if mine.sum() >= MIN_PIXELS else part & (labels == number)
            share = mine.sum() / max(1, thing.whole.sum()) if followed else 1.0
            terms: Terms = 6 if share >= HALF else 3 if share >= LITTLE else 1
            velocity = thing.velocity if followed else None
            far[number], deviation = moves.beside(mine, velocity, terms=terms)
            usual = min(usual, deviation)
            unlike = np.minimum(unlike, far[number] / deviation)
            if followed:
                far[number][~self._reach(thing)] = np.inf
        rest = np.uint8(part & (unlike > OTHERWISE))
        opened = cv2.morphologyEx(rest, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        count, numbered, statistics, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
        for k in range(1, count):
            piece = numbered == k
            if statistics[k, cv2.CC_STAT_AREA] < self._smallest(part):
                continue
            own, _ = moves.beside(piece)
            nearest = np.min([one[piece] for one in far.values()], axis=0)
            if np.median(own[piece]) > CLEARLY * np.median(nearest):
                continue
            there, gone = np.where(piece, 0, labels), np.where(piece, 0, carried)
            number = self._again(frame, piece, there, gone) or self._begun(frame)
            labels[piece], far[number] = number, own
        if len(far) < 2:
            return
        top, left, height, width = _box(part)
        window = np.s_[top : top + height, left : left + width]
        distance = np.stack([np.minimum(one[window], FURTHEST) for one in far.values()])
        nearest = distance.min(axis=0)
        tolerated = usual**2 + (TOLERATED * nearest) ** 2  # where none fits, it takes a clear win
        costs = np.minimum((distance**2 - nearest**2) / tolerated, MOST)
        numbers = np.array(list(far))
        costs += OTHER_THAN_CARRIED * (labels[window] != numbers[:, None, None])
        weight = np.where(moves.known[window] & part[window], SEEN, UNSEEN).astype(np.float32)
        grey = np.ascontiguousarray(self._motion.grey(frame)[window])
        best = numbers[Potts(grey).assign(costs.astype(np.float32), weight)]
        labels[window][part[window]] = best[part[window]]

    @staticmethod
    def _reach(thing: _Thing, *, grown: bool = True) -> np.ndarray:
        """Return where a thing is in the frame after it was seen, or may be, (H, W) bool."""
        x, y = thing.velocity
        shifted = cv2.warpAffine(
            np.uint8(thing.whole), np.array([[1, 0, x], [0, 1, y]]), thing.whole.shape[::-1]
        )
        if not grown:
            return shifted > 0
        side = 1 + 2 * round(GROWING * thing.whole.sum() ** 0.5 + 1)
        return cv2.dilate(shifted, np.ones((side, side), np.uint8)) > 0

    def _again(self, frame: int, part: np.ndarray, labels: np.ndarray, carried: np.ndarray) -> int:
        """Return the thing that a part is which was hidden; 0 if it is none."""
        there = set(np.unique(labels)) | set(np.unique(carried))
        place = np.array([*_center(part), part.sum() ** 0.5])
        look = self._look(frame, part)
        best, found = 0.0, 0
        for thing in self._things.values():
            away = frame - thing.seen
            hidden = thing.id not in there and 0 < away <= HIDDEN + 1
            if not hidden or part.sum() <= REAPPEARED * thing.whole.sum():
                continue
            alike = self._alike(thing, place, look, away)
            if alike > best:
                best, found = alike, thing.id
        return found

    @staticmethod
    def _alike(thing: _Thing, place: np.ndarray, look: np.ndarray, away: int) -> float:
        """Return how far something is what a thing was so many frames ago; 0 if it is not."""
        if not thing.whole.any():
            return 0.0
        size = max(place[2], thing.whole.sum() ** 0.5)
        expected = thing.center() + away * thing.velocity
        far = float(np.linalg.norm(place[:2] - expected) / (size * (1 + FARTHER * away)))
        alike = float(np.sqrt(look * thing.look).sum())
        return alike / (1 + far) if far < NEAR and alike > ALIKE else 0.0

    def _begun(self, frame: int) -> int:
        number = 1 + max(self._things, default=0)
        nowhere = np.zeros(self._motion.grey(frame).shape, bool)
        self._things[number] = _Thing(
            id=number,
            seen=frame,
            whole=nowhere,
            velocity=np.zeros(2),
            look=np.zeros(BINS),
        )
        return number

    def _note(
        self,
        frame: int,
        labels: np.ndarray,
        parts: Sequence[tuple[np.ndarray, bool]],
        moves: SmoothMotions,
    ) -> None:
        """Note where things are, and which of them touch."""
        flow = moves.flow
        for number in np.unique(labels[labels > 0]):
            thing, mask = self._things[number], labels == number
            beside = cv2.dilate(np.uint8(mask), np.ones((5, 5), np.uint8)) > 0
            is_whole = not (beside & (labels > 0) & ~mask).any()
            kept = self._reach(thing, grown=False) if thing.seen == frame - 1 else mask
            known_well = is_whole or mask.sum() >= HALF * kept.sum()
            thing.whole = mask if is_whole else kept | mask if known_well else kept
            thing.seen = frame
            thing.pixels += int(mask.sum())
            moved = np.median(flow[mask], axis=0).astype(np.float64)
            if known_well:
                thing.velocity, thing.look = moved, self._look(frame, mask)
            around = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
            around &= labels == 0
            rest = np.median(flow[around], axis=0) if around.any() else np.zeros(2)
            thing.motions[frame] = moved - rest
            thing.places[frame] = np.array([*_center(mask), mask.sum() ** 0.5])
        moving = cv2.connectedComponents((labels > 0).astype(np.uint8), connectivity=4)[1]
        for part, core in parts:
            for number in np.unique(labels[part & (labels > 0)]):
                self._things[int(number)].core += core
        for joined in range(1, moving.max() + 1):
            inside = [int(number) for number in np.unique(labels[moving == joined])]
            for i, first in enumerate(inside):
                for second in inside[i + 1 :]:
                    pair = first, second
                    self._touching[pair] = self._touching.get(pair, 0) + 1

    def _lasting(self) -> np.ndarray:
        """Return the final labels by the first ones, (K,) uint8."""
        count = 1 + max(self._things, default=0)
        whole = np.arange(count)  # what a thing is a part of
        by_size = sorted(self._things, key=lambda k: self._things[k].pixels)
        for place, part in enumerate(by_size):
            larger = [k for k in by_size[place + 1 :] if self._belongs(part, k)]
            if larger:
                whole[part] = larger[-1]  # the largest
        for part in reversed(by_size):  # the larger come first
            whole[part] = whole[whole[part]]
        for late in sorted(self._things):  # whole things that are seen again
            if whole[late] == late and (earlier := self._seen_before(late, whole)):
                whole[whole == late] = whole[earlier]
        table, number = np.zeros(count, np.uint8), 0
        for thing in sorted(self._things):
            if whole[thing] != thing:
                continue
            same = np.flatnonzero(whole == thing)
            frames = {frame for k in same for frame in self._things[int(k)].motions}
            lasting = min(LASTING, len(self._motion))
            core = sum(self._things[int(k)].core for k in same)
            if len(frames) >= lasting and core >= lasting - 1 and number < MOST_THINGS:
                number += 1
                table[same] = number
        return table

    def _seen_before(self, late: int, whole: np.ndarray) -> int:
        """Return the thing that was hidden before another began, and looks like it; 0 if none."""
        thing = self._things[late]
        frames = [f for k in np.flatnonzero(whole == late) for f in self._things[int(k)].motions]
        if not frames:  # its outline left nothing of it
            return 0
        first = min(frames)
        best, found = 0.0, 0
        for other in self._things.values():
            away = first - other.seen
            if not 0 < away <= HIDDEN + 1 or first not in thing.places:
                continue
            alike = self._alike(other, thing.places[first], thing.look, away)
            if alike > best:
                best, found = alike, other.id
        return found

    def _belongs(self, part: int, other: int) -> bool:
        """Return whether two things were hardly apart, and so are parts of one."""
        touching = self._times(self._touching, part, other)
        mine, others = self._things[part].motions, self._things[other].motions
        both = len(mine.keys() & others.keys())
        if touching < max(1, TOUCHING * len(mine)) or not both:
            return False
        differing = self._differing(part, other)
        if touching >= TOGETHER * len(mine) and differing < GOING_TOGETHER:
            return True
        return touching >= HARDLY_APART * both and differing < ROUGHLY

    @staticmethod
    def _times(counts: dict[tuple[int, int], int], first: int, second: int) -> int:
        return counts.get((min(first, second), max(first, second)), 0)

    def _differing(self, first: int, second: int) -> float:
        """Return how far the motions of two things differ, as a share of the faster one's."""
        one, two = self._things[first].motions, self._things[second].motions
        frames = sorted(one.keys() & two.keys())
        apart = np.linalg.norm([one[f] - two[f] for f in frames], axis=1)
        fast = np.maximum(*(np.linalg.norm([m[f] for f in frames], axis=1) for m in (one, two)))
        return float(np.median(apart) / max(np.median(fast), 1e-9))

    def _carried(self, frame: int, before: np.ndarray) -> np.ndarray:
        """Return the labels of the frame before where the image motion carries them, or else 0."""
        backward = self._motion.backward(frame)
        carried = sample_image(
            before.astype(np.float32), pixel_grid(before.shape) + backward, nearest=True
        )
        returns = returns_to_start(backward, self._motion.forward(frame - 1)) > 0
        return np.where(returns, carried.astype(np.int32), 0)

    def _look(self, frame: int, mask: np.ndarray) -> np.ndarray:
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
    """Return the top, left, height and width of what is around a mask."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return top, left, height, width
