"""Which rigid motions a flow field may hold: candidates for ``motion="objects"``."""

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.model.constants import NEAREST
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion, triangulate
from tisfm.motion.objects.label_optimisation import Potts

PIXELS = 40_000  # of the flow that is looked at: labels are made sharp later
TOLERATED_ERROR, FLOOR = 3.0, 0.02  # of the background's residual, and px: what flow may be off by
UNEXPLAINED = 3.0  # the cost of a pixel that no motion explains, in squares of that
SMALLEST = 0.002  # of the pixels: what is smaller is no object
EXPLAINED = 0.3  # of a candidate's pixels, at least, by its own motion
CLEARLY = 0.6  # of the median distance under a common motion, at most, under one of its own
FASTEST_SPIN = 0.2  # rad/frame, beside the background
LEAST_WEIGHT = 0.02  # of a pixel, where labels are assigned


def motion_candidates(
    flow: np.ndarray,
    trust: np.ndarray,
    camera: Camera,
    frame: np.ndarray,
    background: np.ndarray,
    residual: float,
    *,
    most: int,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Find motions one after another in what those before do not explain.

    The distance of a pixel's flow from what a motion allows, the half line of depths before the
    camera, is its cost; a further label stands for pixels that no motion explains. The largest
    connected part of that label gives the next motion.

    Parameters
    ----------
    flow : (H, W, 2) float32
    trust : (H, W) float32
        Confidence, 0 where occluded.
    camera : Camera
    frame : (H, W) float32
        Grey levels, for the boundaries.
    background : (3, 4) array
        R and t of the largest motion.
    residual : float
        Its residual, px.
    most : int
        How many motions there may be.

    Returns
    -------
    motions : list of (3, 4) array
        The background first.
    labels : (H, W) int32
    """
    height, width = trust.shape
    scale = min(1.0, (PIXELS / (height * width)) ** 0.5)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    ratio = size[0] / width
    small_flow = cv2.resize(flow, size, interpolation=cv2.INTER_AREA) * np.float32(ratio)
    small_trust = cv2.resize(trust, size, interpolation=cv2.INTER_AREA)
    # The rounding of the size shifts a pixel by a fraction of one; motions hardly feel it.
    search = _Search(
        small_flow,
        small_trust,
        camera.scaled(ratio, height, width),
        cv2.resize(frame, size, interpolation=cv2.INTER_AREA),
        TOLERATED_ERROR * residual * ratio + FLOOR,
        np.array(background, np.float64),
    )
    motions, labels = search.run(most)
    labels = cv2.resize(
        labels.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
    ).astype(np.int32)
    return motions, labels


class _Search:
    """A flow field, and the motions found in it so far."""

    def __init__(
        self,
        flow: np.ndarray,
        trust: np.ndarray,
        camera: Camera,
        frame: np.ndarray,
        tolerated: float,
        background: np.ndarray,
    ) -> None:
        self._flow, self._trust, self._camera = flow, trust, camera
        self._background = background
        self._tolerated = tolerated
        self._potts = Potts(frame)
        self._weight = np.maximum(trust, LEAST_WEIGHT)
        self.smallest = smallest_object(trust.size)

    def run(self, most: int) -> tuple[list[np.ndarray], np.ndarray]:
        motions = [self._background]
        tried = np.zeros(self._trust.shape, bool)
        for _ in range(3 * most):
            labels = self._labels(motions, unexplained=True)
            part = _largest_part((labels == len(motions)) & ~tried)
            if len(motions) == most or part.sum() < self.smallest:
                break
            motion = self._fit(part)
            found = None if motion is None else self._refitted_with(motions, motion, part)
            if found is None:
                tried |= part
            else:
                motions = found
        motions = self._split(motions, most)
        return motions, self._labels(motions)

    def _split(self, motions: list[np.ndarray], most: int) -> list[np.ndarray]:
        """Give separate parts of a label motions of their own where those fit clearly better.

        One motion, its depths free, often explains two things that move alike only roughly. It
        is that of the largest part rather than of the others: so the others are asked.
        """
        labels = self._labels(motions)
        added: list[np.ndarray] = []
        for label in range(1, len(motions)):
            parts = sorted(_parts(labels == label, self.smallest), key=np.sum)
            joint = self._fit(np.any(parts, axis=0)) if len(parts) > 1 else None
            if joint is None:
                continue
            together = self._distance(joint)
            left = np.any(parts, axis=0)
            for part in parts[:-1]:
                found = self._fit(part)
                if found is None or len(motions) + len(added) == most:
                    continue
                apart = self._distance(found)
                if np.median(apart[part]) < CLEARLY * np.median(together[part]):
                    added.append(found)
                    left &= ~part
            rest = self._fit(left)
            motions[label] = joint if rest is None else rest
        return motions + added

    def _refitted_with(
        self, motions: list[np.ndarray], motion: np.ndarray, part: np.ndarray
    ) -> list[np.ndarray] | None:
        """Return motions and one more, fitted to the pixels they have; None if it explains few."""
        explained = (self._distance(motion) < self._tolerated * UNEXPLAINED) & part
        if explained.sum() < max(EXPLAINED * part.sum(), self.smallest):
            return None
        motions = [*motions, motion]
        labels = self._labels(motions)
        kept = []
        for label, motion in enumerate(motions):
            mine = labels == label
            if label == 0 and not motion[:, 3].any():
                kept.append(motion)  # a background at rest
            elif label == 0 or mine.sum() >= self.smallest:
                found = self._fit(mine)
                kept.append(motion if found is None else found)
        return kept if len(kept) == len(motions) else None

    def _fit(self, mine: np.ndarray) -> np.ndarray | None:
        try:
            found = camera_motion(self._flow, self._trust * mine, self._camera)
        except TooFewPixelsError:
            return None
        # Nothing seen from frame to frame spins faster: such a fit is one of noise.
        spin = np.linalg.norm(cv2.Rodrigues(found.rotation @ self._background[:, :3].T)[0])
        if spin > FASTEST_SPIN:
            return None
        return np.column_stack([found.rotation, found.translation])

    def _labels(self, motions: list[np.ndarray], *, unexplained: bool = False) -> np.ndarray:
        costs = [(self._distance(motion) / self._tolerated) ** 2 for motion in motions]
        if unexplained:
            costs.append(np.full(self._trust.shape, UNEXPLAINED**2))
        stacked = np.minimum(np.stack(costs), 4 * UNEXPLAINED**2)
        return self._potts.assign(stacked.astype(np.float32), self._weight)

    def _distance(self, motion: np.ndarray) -> np.ndarray:
        """Return how far the flow is from where points before the camera can go, px."""
        height, width = self._trust.shape
        focal = self._camera.focal
        cx, cy = self._camera.center_for(height, width)
        rows, columns = np.mgrid[:height, :width]
        start = np.stack([columns - cx, rows - cy], axis=-1).reshape(-1, 2)
        ones = np.ones((len(start), 1))
        before = np.hstack([start / focal, ones])
        after = np.hstack([(start + self._flow.reshape(-1, 2)) / focal, ones])
        rotation, translation = motion[:, :3], motion[:, 3]
        moved = before @ rotation.T
        if translation.any():
            inverse_depth = np.maximum(triangulate(before, after, rotation, translation), 0)
            moved += inverse_depth[:, None] * translation
        projected = moved[:, :2] / np.maximum(moved[:, 2:], NEAREST)
        distance = focal * np.linalg.norm(after[:, :2] - projected, axis=1)
        return distance.reshape(height, width)


def smallest_object(pixels: int) -> int:
    """Return the fewest pixels that an object may have, of an image of so many."""
    return max(64, round(SMALLEST * pixels))


def _parts(mask: np.ndarray, smallest: int) -> list[np.ndarray]:
    """Return the connected parts of a mask that are not too small."""
    count, parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    each = (parts == index for index in range(1, count))
    return [part for part in each if part.sum() >= smallest]


def _largest_part(mask: np.ndarray) -> np.ndarray:
    """Return the largest connected part of a mask; empty if there is none."""
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=4
    )
    if count < 2:
        return np.zeros(mask.shape, bool)
    return parts == 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))
