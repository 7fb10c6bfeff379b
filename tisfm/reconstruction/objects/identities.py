"""Labels of what moves, with identities that last from frame to frame and through occlusion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from tisfm.motion.objects.candidates import smallest_object
from tisfm.motion.objects.layers import nearest_known
from tisfm.motion.objects.potts import Potts
from tisfm.reconstruction.objects.evidence import DOUBT, Evidence
from tisfm.reconstruction.objects.image_motion import (
    ImageMotion,
    at_places,
    places_of,
    returning,
)

# Of mean evidence: where the boundary lies; of a core, which a thing has to have, with so many
# frames that say something; and the share of the smallest thing that is core.
BOUNDARY, CORE, CORE_WEIGHT, CORE_SHARE = -0.3, 0.3, 1.5, 0.25
SURE = 4.0  # frames that say something: more have no more say in the boundary
SEEN, UNSEEN = 0.5, 0.02  # what pixels weigh in the boundary: those of sure evidence, and others
CARRIED = 0.1  # of a part's pixels: so many that a label is carried to are the same thing
HIDDEN = 15  # frames that a thing may be hidden
ALIKE = 0.6  # of 1: the overlap of histograms of the same thing, at least
BINS = 16  # of grey levels
FEWEST, FEWEST_QUADRATIC = 30, 400  # pixels that a smooth motion is fitted to
GROWING = 0.1  # of a thing's size: how far it may reach beyond where it was
STARTING = 1.0  # px from a velocity: what moves otherwise counts little at first
LEAST_USUAL = 0.2  # px: of what a smooth motion misses, the deviation is at least that
OTHERWISE = 4.0  # deviations: what moves otherwise than a thing is another one
CLEARLY = 0.5  # of what a motion of others misses: a motion of its own misses less
MOST, OTHER_THAN_CARRIED = 16.0, 2.0  # of costs: of a motion, and of another label than before
MOST_THINGS = 255
# Px that a boundary may move; of surfaces that do not count for where they go; grey levels that
# are missed anyway, beside the median of what is missed.
REACH, RIM, MISSED = 10, 5, 2.0
OTHERWISE_LABELLED = 2.0
LASTING = 4  # frames, at least, of a thing
# Of the frames with two things: where they touch in as many, they are parts of one, if they go
# together, or anyway.
TOGETHER, NEVER_APART = 0.7, 0.95
GOING_TOGETHER = 0.3  # of the faster one's motion: how far that of parts of one may differ


@dataclass(kw_only=True)
class _Thing:
    """What is known of a thing so far.

    Attributes
    ----------
    id : int
    seen : int
        The frame in which it was labelled last.
    mask : (H, W) bool
        Where it was then.
    whole : (H, W) bool
        Where it was then with what others hid of it.
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
    """

    id: int
    seen: int
    mask: np.ndarray
    whole: np.ndarray
    velocity: np.ndarray
    look: np.ndarray
    core: int = 0
    pixels: int = 0
    motions: dict[int, np.ndarray] = field(default_factory=dict)

    def center(self) -> np.ndarray:
        """Return the centre of where it was seen last, (x, y) px."""
        rows, columns = np.nonzero(self.mask)
        return np.array([columns.mean(), rows.mean()])


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

    def labels(self) -> list[np.ndarray]:
        """Return the labels of every frame, (H, W) uint8, in the size of the image motion's.

        They are 0 for what is at rest, and else from 1 on, in the order in which things appear.
        """
        found: list[np.ndarray] = []
        for frame in range(len(self._motion)):
            parts = list(moving_parts(self._motion.grey(frame), self._evidence[frame]))
            before = found[-1] if found else None
            found.append(self._labelled(frame, parts, before))
        table = self._lasting()
        return [table[labels] for labels in found]

    def _labelled(
        self, frame: int, parts: Sequence[tuple[np.ndarray, bool]], before: np.ndarray | None
    ) -> np.ndarray:
        """Return the labels of a frame, (H, W) int32, of which the parts are given that move."""
        labels = np.zeros(self._motion.grey(frame).shape, np.int32)
        carried = np.zeros_like(labels) if before is None else self._carried(frame, before)
        moves = _Moves(self._motion, frame)
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
        labels = bordered(labels, self._motion, frame)
        self._note(frame, labels, parts, moves)
        return labels

    def _by_motion(
        self,
        frame: int,
        part: np.ndarray,
        known: list[int],
        labels: np.ndarray,
        carried: np.ndarray,
        moves: "_Moves",
    ) -> None:
        """Let motions decide which of several things a pixel of a part belongs to.

        What moves otherwise than all of them is a thing that was hidden, or another one.
        """
        missed = {}
        for number in known:
            mine = part & (carried == number) if (carried[part] == number).any() else part
            mine = mine if mine.sum() >= FEWEST else part & (labels == number)
            thing = self._things[number]
            usual = thing.velocity if thing.seen == frame - 1 else None
            missed[number] = moves.beside(mine, usual)
            if thing.seen == frame - 1:
                missed[number][~self._reach(thing)] = np.sqrt(MOST)
        rest = part & (np.min([*missed.values()], axis=0) > OTHERWISE)
        rest = cv2.morphologyEx(rest.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        count, numbered, statistics, _ = cv2.connectedComponentsWithStats(rest, connectivity=4)
        for k in range(1, count):
            piece = numbered == k
            if statistics[k, cv2.CC_STAT_AREA] < self._smallest(part):
                continue
            own = moves.beside(piece)
            if np.median(own[piece]) > CLEARLY * np.median(missed_by(missed, piece)):
                continue
            there = np.where(piece, 0, labels)
            thing = self._again(frame, piece, there, np.where(piece, 0, carried))
            number = thing or self._begun(frame)
            labels[piece], missed[number] = number, own
        if len(missed) < 2:
            return
        top, left, height, width = _box(part)
        window = np.s_[top : top + height, left : left + width]
        costs = np.stack([np.minimum(one[window] ** 2, MOST) for one in missed.values()])
        numbers = np.array(list(missed))
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
            np.uint8(thing.whole), np.float64([[1, 0, x], [0, 1, y]]), thing.whole.shape[::-1]
        )
        if not grown:
            return shifted > 0
        side = 1 + 2 * round(GROWING * thing.whole.sum() ** 0.5 + 1)
        return cv2.dilate(shifted, np.ones((side, side), np.uint8)) > 0

    def _again(
        self, frame: int, part: np.ndarray, labels: np.ndarray, carried: np.ndarray
    ) -> int:
        """Return the thing that a part is which was hidden; 0 if it is none."""
        there = set(np.unique(labels)) | set(np.unique(carried))
        rows, columns = np.nonzero(part)
        center = np.array([columns.mean(), rows.mean()])
        look = self._look(frame, part)
        best, found = 0.0, 0
        for thing in self._things.values():
            away = frame - thing.seen
            if thing.id in there or not 0 < away <= HIDDEN + 1:
                continue
            size = np.sqrt(max(part.sum(), thing.mask.sum()))
            expected = thing.center() + away * thing.velocity
            far = np.linalg.norm(center - expected) / (size * (1 + 0.1 * away))
            alike = float(np.sqrt(look * thing.look).sum())
            if far < 1.5 and alike > ALIKE and alike / (1 + far) > best:
                best, found = alike / (1 + far), thing.id
        return found

    def _begun(self, frame: int) -> int:
        number = 1 + max(self._things, default=0)
        nowhere = np.zeros(self._motion.grey(frame).shape, bool)
        self._things[number] = _Thing(
            id=number, seen=frame, mask=nowhere, whole=nowhere, velocity=np.zeros(2), look=np.zeros(BINS)
        )
        return number

    def _note(
        self,
        frame: int,
        labels: np.ndarray,
        parts: Sequence[tuple[np.ndarray, bool]],
        moves: "_Moves",
    ) -> None:
        """Note where things are, and which of them touch."""
        flow = moves.flow
        for number in np.unique(labels[labels > 0]):
            thing, mask = self._things[number], labels == number
            beside = cv2.dilate(np.uint8(mask), np.ones((5, 5), np.uint8)) > 0
            is_whole = not (beside & (labels > 0) & ~mask).any()
            kept = self._reach(thing, grown=False) if thing.seen == frame - 1 else mask
            thing.whole = mask if is_whole else kept | mask
            thing.seen, thing.mask = frame, mask
            thing.pixels += int(mask.sum())
            thing.velocity = np.median(flow[mask], axis=0).astype(np.float64)
            thing.look = self._look(frame, mask)
            around = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
            around &= labels == 0
            rest = np.median(flow[around], axis=0) if around.any() else np.zeros(2)
            thing.motions[frame] = thing.velocity - rest
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
                whole[part] = max(larger, key=lambda k: self._times(self._touching, part, k))
        for part in reversed(by_size):  # the larger come first
            whole[part] = whole[whole[part]]
        table, number = np.zeros(count, np.uint8), 0
        for thing in sorted(self._things):
            if whole[thing] != thing:
                continue
            same = np.flatnonzero(whole == thing)
            frames = {frame for k in same for frame in self._things[k].motions}
            lasting = min(LASTING, len(self._motion))
            core = sum(self._things[k].core for k in same)
            if len(frames) >= lasting and core >= lasting - 1 and number < MOST_THINGS:
                number += 1
                table[same] = number
        return table

    def _belongs(self, part: int, other: int) -> bool:
        """Return whether two things were hardly apart, and so are parts of one."""
        touching = self._times(self._touching, part, other)
        lasting = len(self._things[part].motions)
        if touching < TOGETHER * lasting:
            return False
        return touching >= NEVER_APART * lasting or self._go_together(part, other)

    @staticmethod
    def _times(counts: dict[tuple[int, int], int], first: int, second: int) -> int:
        return counts.get((min(first, second), max(first, second)), 0)

    def _go_together(self, first: int, second: int) -> bool:
        one, two = self._things[first].motions, self._things[second].motions
        frames = sorted(one.keys() & two.keys())
        apart = np.linalg.norm([one[f] - two[f] for f in frames], axis=1)
        fast = np.maximum(*(np.linalg.norm([m[f] for f in frames], axis=1) for m in (one, two)))
        return bool(np.median(apart) < GOING_TOGETHER * np.median(fast))

    def _carried(self, frame: int, before: np.ndarray) -> np.ndarray:
        """Return the labels of the frame before where the image motion carries them, 0 elsewhere."""
        backward = self._motion.backward(frame)
        carried = at_places(before.astype(np.float32), places_of(before.shape) + backward, nearest=True)
        returns = returning(backward, self._motion.forward(frame - 1)) > 0
        return np.where(returns, carried.astype(np.int32), 0)

    def _look(self, frame: int, mask: np.ndarray) -> np.ndarray:
        grey = self._motion.grey(frame)[mask]
        shares, _ = np.histogram(grey, BINS, (0, 256))
        return shares / max(1, shares.sum())

    def _smallest(self, image: np.ndarray) -> int:
        return smallest_object(image.size)


def moving_parts(grey: np.ndarray, evidence: Evidence) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield the connected parts of a frame that move, (H, W) bool, and whether they have a core."""
    mean = evidence.mean()
    costs = np.stack([2 * np.clip(mean - BOUNDARY, 0, 3), 4 * np.clip(BOUNDARY - mean, 0, 1)])
    weight = SEEN * np.clip((evidence.weight + DOUBT) / SURE, UNSEEN, 1)
    moving = Potts(grey).assign(costs.astype(np.float32), weight.astype(np.float32)) == 1
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(
        moving.astype(np.uint8), connectivity=4
    )
    core = (mean > CORE) & (evidence.weight > CORE_WEIGHT)
    cores = np.bincount(parts[core], minlength=count)
    smallest = smallest_object(grey.size)
    for part in range(1, count):
        if statistics[part, cv2.CC_STAT_AREA] >= smallest:
            yield parts == part, bool(cores[part] >= CORE_SHARE * smallest)


def bordered(labels: np.ndarray, motion: ImageMotion, frame: int) -> np.ndarray:
    """Return labels with boundaries where the frames before and after show them, (H, W) int32.

    What lies on either side of a boundary goes on beyond it. A pixel belongs to what the frame
    after or the one before shows it to go with: behind a thing that goes on, one of them does.
    """
    numbers = np.unique(labels)
    if len(numbers) < 2:
        return labels
    grey, places = motion.grey(frame), places_of(labels.shape)
    window = np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)
    near = np.stack([cv2.dilate(np.uint8(labels == k), window) > 0 for k in numbers])
    band = near.sum(axis=0) > 1
    missed = np.full((len(numbers), *labels.shape), np.inf, np.float32)
    for led in motion.led(frame, 1):
        flow, other = led.places - places, motion.grey(led.frame)
        for index, number in enumerate(numbers):
            mine = labels == number
            core = cv2.erode(np.uint8(mine), np.ones((RIM, RIM), np.uint8)) > 0
            source = core if core.sum() >= FEWEST else mine
            gone = _going_on(flow, source)
            off = np.abs(at_places(other, places + gone) - grey)
            x, y = np.moveaxis(places + gone, -1, 0)
            outside = (x < 0) | (y < 0) | (x > labels.shape[1] - 1) | (y > labels.shape[0] - 1)
            off = np.where(outside, np.inf, cv2.blur(off, (3, 3)))
            missed[index] = np.minimum(missed[index], off)
    own = np.take_along_axis(missed, np.searchsorted(numbers, labels)[None], axis=0)[0]
    usual = MISSED + 1.5 * float(np.median(own[np.isfinite(own)]))
    costs = np.minimum((missed / usual) ** 2, MOST)
    costs += OTHERWISE_LABELLED * (labels != numbers[:, None, None])
    costs[~near] = 2 * MOST
    weight = np.where(band, SEEN, 1).astype(np.float32)
    found = numbers[Potts(grey).assign(costs.astype(np.float32), weight)]
    return np.where(band, found, labels).astype(np.int32)


def _going_on(flow: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return a flow, (H, W, 2), as it is within a mask, and as at the nearest pixel of it beyond."""
    _, nearest = cv2.distanceTransformWithLabels(
        np.uint8(~mask), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros((int(nearest.max()) + 1, 2), np.float32)
    table[nearest[mask]] = flow[mask]
    beyond = cv2.blur(table[nearest], (RIM, RIM))
    return np.where(mask[..., None], flow, beyond)


class _Moves:
    """How the pixels of a frame move to the frames after and before.

    Attributes
    ----------
    flow : (H, W, 2) float32
        To the frame after, or away from that before if it is the last one.
    known : (H, W) bool
        Where one of the frames shows the pixel.
    """

    def __init__(self, motion: ImageMotion, frame: int) -> None:
        self._ways = [
            (led.places - places_of(led.found.shape), led.found) for led in motion.led(frame, 1)
        ]
        self._later = frame + 1 < len(motion)
        self.known = np.any([found for _, found in self._ways], axis=0)
        self.flow = self._ways[0][0] if self._later else -self._ways[0][0]

    def beside(self, mask: np.ndarray, usual_velocity: np.ndarray | None = None) -> np.ndarray:
        """Return how far pixels move otherwise than what is in a mask, in deviations of that.

        0 where it is not known. The velocity is that of most of it, px/frame, if that is known.
        """
        total, count = np.zeros(mask.shape, np.float32), np.zeros(mask.shape, np.float32)
        for way, (flow, found) in enumerate(self._ways):
            inside = mask & found
            if inside.sum() < FEWEST:
                continue
            sign = 1 if self._later and way == 0 else -1
            start = None if usual_velocity is None else sign * usual_velocity
            missed = np.linalg.norm(flow - _smooth_motion(flow, inside, start), axis=-1)
            usual = max(1.48 * float(np.median(missed[inside])), LEAST_USUAL)
            total += np.where(found, missed / usual, 0)
            count += found
        return total / np.maximum(count, 1)


def missed_by(missed: dict[int, np.ndarray], piece: np.ndarray) -> np.ndarray:
    """Return how far the pixels of a piece are from the nearest of several motions."""
    return np.asarray(np.min([one[piece] for one in missed.values()], axis=0))


def _box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Return the top, left, height and width of what is around a mask."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return top, left, height, width


def _smooth_motion(
    flow: np.ndarray, mask: np.ndarray, start: np.ndarray | None = None
) -> np.ndarray:
    """Return the quadratic motion, (H, W, 2), that fits a flow within a mask, robustly.

    Of few pixels it is affine. What moves as `start` does, (2,) px/frame, counts most at first.
    """
    rows, columns = np.nonzero(mask)
    middle = np.array([np.median(columns), np.median(rows)])
    size = max(1.0, float(max(np.ptp(columns), np.ptp(rows))) / 2)
    x, y = np.moveaxis((places_of(flow.shape) - middle) / size, -1, 0).clip(-2, 2)
    terms = [np.ones_like(x), x, y]
    if len(rows) >= FEWEST_QUADRATIC:
        terms += [x * x, x * y, y * y]
    stacked = np.stack(terms, axis=-1)
    every = max(1, len(rows) // 4000)
    inside, moved = stacked[mask][::every], flow[mask][::every].astype(np.float64)
    weight = np.ones(len(moved))
    if start is not None:
        weight = 1 / (1 + (np.linalg.norm(moved - start, axis=1) / STARTING) ** 2) ** 2
    for _ in range(5):
        weighted = inside * weight[:, None]
        gram = weighted.T @ inside + 1e-6 * len(moved) * np.eye(inside.shape[1])
        fitted = np.linalg.solve(gram, weighted.T @ moved)
        missed = np.linalg.norm(inside @ fitted - moved, axis=1)
        weight = 1 / (1 + (missed / max(1.48 * np.median(missed), 0.05)) ** 2)
    return np.float32(stacked @ fitted)
