"""Three frames at a time: the frame before adds to what a pair says of its first frame.

The motion of a surface changes little from one frame to the next. So the flow to the frame before
is that to the next one turned round, and what the two differ by, the bend, is much the same all
over a surface: it is fitted where a surface is seen in all three frames, and serves where it is
hidden in the next one.
"""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from tisfm import runtime
from tisfm.kernels.data.forward_splatting import splat
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.settings import Settings
from tisfm.solver.data_term import DataTerm
from tisfm.solver.image_pyramid import BESIDE, ImagePyramid
from tisfm.solver.sampling import FAR, spline_taps
from tisfm.solver.three_frames import ThreeFrameData
from tisfm.solver.unknowns import Unknowns
from tisfm.threads import start_beside
from tisfm.visibility.occlusion import occlusion, residual_of

HALF_HIDDEN = 0.5  # of a pixel of a coarser level
ARRIVING = 0.5  # pixels of the frame before, at least, that go to a pixel seen there
GRID = 4  # px: of as many columns and rows, one is fitted
REACH = 64  # px: half the side of the window that the bend is fitted in
STEADY = 0.05  # px²: variances of the flow below it say nothing of how the bend changes with it
OFF = 0.1  # px: where the bend is off by more, it is that of another surface
ERODED = 3  # px: the side of the window in which all is seen, around what is fitted
NEAR = 2  # pixels of the grid: half the side of the window in which a bend is judged
DOUBTED, DOUBTED_HIDDEN = 0.3, 1.0  # px: deviations from the bend that halve the trust in it
# Of the way back, and px: the most of a bend that a steady motion has.
MOST_BENT, MOST_BENT_AT_REST = 0.5, 1.0
BORNE_OUT = 0.8  # of the residual: what the flow of the pair before has less than
KEPT = 0.5  # of the pixels seen in three frames: as many have to keep to the bend
LEAST_COUNT = 1e-4
LEAST_DETERMINANT = 1e-6


@dataclass(frozen=True, kw_only=True)
class PreviousPair:
    """The pair before, on the level that its flow ended on.

    Attributes
    ----------
    frame0, frame1 : (h, w) float32
        Its frames, smoothed. The second is the first of the pair that follows.
    flow : (2, h, w) float32
        px/frame of the level.
    hidden : (h, w) bool
        Where its first frame is not visible in the second.
    """

    frame0: np.ndarray
    frame1: np.ndarray
    flow: np.ndarray
    hidden: np.ndarray

    @classmethod
    def of(cls, pyramid: ImagePyramid, flow: np.ndarray, hidden: np.ndarray) -> "PreviousPair":
        """Return what the next pair takes from one.

        Parameters
        ----------
        pyramid : ImagePyramid
        flow : (2, H, W) float32
            Of the finest level, px/frame.
        hidden : (H, W) bool
        """
        frame0, frame1 = pyramid.frames0[pyramid.last], pyramid.frames1[pyramid.last]
        if frame0.shape != hidden.shape:
            size, scale = frame0.shape[::-1], np.float32(pyramid.scales[pyramid.last])
            area = cv2.INTER_AREA
            flow = scale * np.stack([cv2.resize(part, size, interpolation=area) for part in flow])
            hidden = cv2.resize(hidden.astype(np.float32), size, interpolation=area) > HALF_HIDDEN
        return cls(frame0=frame0, frame1=frame1, flow=flow, hidden=hidden)

    def turned(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the flow from the second frame back to the first, and where it is known.

        Returns
        -------
        flow : (2, h, w) float32
            px/frame; 0 where it is not known.
        seen : (h, w) bool
            Where a pixel of the second frame is seen in the first.
        """
        flow = np.where(self.hidden, np.float32(FAR), self.flow)
        sums = aligned_empty((*self.hidden.shape, 4))
        splat(flow, np.zeros(self.hidden.shape, np.float32), sums, any_order=runtime.on_gpu())
        count, _, *moved = cv2.split(sums)
        seen = count > ARRIVING
        scale = np.where(seen, -1 / np.maximum(count, np.float32(ARRIVING)), np.float32(0))
        return np.stack([part * scale for part in moved]), seen


class PreviousFrame:
    """`MoreData` of the frame before a pair.

    Parameters
    ----------
    pyramid : ImagePyramid
        Of the pair.
    previous : PreviousPair
    settings : Settings

    Attributes
    ----------
    used : bool
        Whether the frame before was of use.
    residual : (h, w) float32 or None
        Of a flow near the last one, on the last level, if it was.
    """

    def __init__(self, pyramid: ImagePyramid, previous: PreviousPair, settings: Settings) -> None:
        self._pyramid, self._earlier, self._settings = pyramid, previous, settings
        self.used = False
        self.residual: np.ndarray | None = None
        frame = previous.frame0
        ahead = runtime.threads() > 1 and frame.size >= BESIDE  # kernels of coarse levels take one
        self._taps = start_beside(spline_taps, frame) if ahead else partial(spline_taps, frame)

    def joined(self, unknowns: Unknowns, data_term: DataTerm) -> ThreeFrameData | None:
        """Return the data of all three frames; None where the motion is not steady."""
        flow = unknowns.flow()
        if not (flow.min() >= -FAR and flow.max() <= FAR):
            return None
        back, seen = self._earlier.turned()
        here = self._residual(flow)
        hidden = self._hidden(flow, here)
        fit = fitted_bend(flow, back, seen & ~hidden)
        if fit is None:
            return None
        bend, off, steady = fit
        turned = bend - back - flow
        known = seen & steady
        # What is seen starts from there as well, where frame 1 bears it out.
        there = self._residual(flow + turned * known)
        better = known & (hidden | (there < BORNE_OUT * here))
        self.residual = np.where(better, there, here)
        # What now moves as it should no longer hides anything in a wrong place.
        hidden |= self._hidden(flow + turned * better, self.residual)
        taken = hidden & known
        unknowns.move(turned * (better | taken))
        doubt = np.where(taken, np.float32(DOUBTED_HIDDEN**-2), np.float32(DOUBTED**-2))
        trust = 1 / (1 + off * doubt)
        trust[~seen] = 0
        self.used = True
        return ThreeFrameData(
            data_term,
            self._earlier.frame0,
            self._taps(),
            bend,
            ((~taken).astype(np.float32), trust),
        )

    def _residual(self, flow: np.ndarray) -> np.ndarray:
        """Return how badly a flow of the last level fits the next frame."""
        pyramid, level = self._pyramid, self._pyramid.last
        frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
        return residual_of(frame0, frame1, flow, self._settings, taps1=pyramid.taps1(level))

    def _hidden(self, flow: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return which pixels of the last level a flow hides in the next frame."""
        pyramid, level = self._pyramid, self._pyramid.last
        frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
        return occlusion(frame0, frame1, flow, self._settings, residual=residual)


def previous_frame(
    pyramid: ImagePyramid, settings: Settings, previous: PreviousPair | None
) -> PreviousFrame | None:
    """Return what the pair before adds to a pair, None where it does not end where this begins.

    Its second frame has to be the first of the pair, grey level by grey level.
    """
    if previous is None or not np.array_equal(previous.frame1, pyramid.frames0[pyramid.last]):
        return None
    return PreviousFrame(pyramid, previous, settings)


def fitted_bend(
    flow: np.ndarray, back: np.ndarray, seen: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the sum of the flows forward and backward, as an affine function of the backward one.

    The function is fitted in windows, twice: the second time with less weight of what is off.
    That of a steady 3D motion depends on the depth, as flow does, so two surfaces in one window
    have a bend each.

    Parameters
    ----------
    flow, back : (2, h, w) float32
        px/frame, to the next frame and to the one before.
    seen : (h, w) bool
        Where both are seen.

    Returns
    -------
    bend : (2, h, w) float32
        px/frame.
    off : (h, w) float32
        The squared deviation from it around every pixel, and how much more it is than that of a
        steady motion, px².
    steady : (h, w) bool
        Where it is not more than that of a steady motion.
    None
        If most of what is seen keeps to no bend.
    """
    h, w = seen.shape
    first = min(GRID, h, w) // 2
    inner = cv2.erode(seen.astype(np.float32), np.ones((ERODED, ERODED), np.uint8))
    part = np.s_[first::GRID, first::GRID]
    given = np.ascontiguousarray(inner[part])
    if not given.any():
        return None
    x0, x1 = (np.ascontiguousarray(component[part]) for component in back)
    sums = [np.ascontiguousarray(a[part] + b[part]) for a, b in zip(flow, back, strict=True)]
    coefficients = _affine(x0, x1, sums, given)
    off = _squared(x0, x1, sums, coefficients)
    weight = given / (1 + off / OFF**2)
    coefficients = _affine(x0, x1, sums, weight)
    excess = _too_bent(x0, x1, coefficients)
    off = _squared(x0, x1, sums, coefficients) + excess
    if (given * (off < DOUBTED**2)).sum() < KEPT * given.sum():
        return None
    side = (2 * NEAR + 1, 2 * NEAR + 1)
    count = cv2.boxFilter(given, -1, side)
    near = np.asarray(cv2.boxFilter(off * given, -1, side) / (count + np.float32(LEAST_COUNT)))

    def everywhere(values: np.ndarray) -> np.ndarray:
        return cv2.resize(values, (w, h), interpolation=cv2.INTER_LINEAR)

    bend = np.empty_like(flow)
    for component, (a0, a1, constant) in enumerate(coefficients):
        bend[component] = everywhere(a0) * back[0] + everywhere(a1) * back[1] + everywhere(constant)
    return bend, everywhere(near), everywhere(excess) < DOUBTED**2


def _affine(
    x0: np.ndarray, x1: np.ndarray, values: list[np.ndarray], weight: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return (a0, a1, c) of a0·x0 + a1·x1 + c nearest to each of the values around every pixel.

    As a guided filter does: fitted in every window, and the fits of all that hold a pixel averaged.

    References
    ----------
    He, Sun, Tang, "Guided image filtering", PAMI 35 (2013), 1397, doi 10.1109/TPAMI.2012.213.
    """
    side = 2 * (REACH // GRID) + 1

    def mean(image: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(image, -1, (side, side), borderType=cv2.BORDER_REFLECT_101)

    count = mean(weight)
    inverse = 1 / (count + np.float32(LEAST_COUNT))
    m0, m1 = mean(weight * x0) * inverse, mean(weight * x1) * inverse
    s00 = mean(weight * x0 * x0) * inverse - m0 * m0 + np.float32(STEADY)
    s01 = mean(weight * x0 * x1) * inverse - m0 * m1
    s11 = mean(weight * x1 * x1) * inverse - m1 * m1 + np.float32(STEADY)
    determinant = np.maximum(s00 * s11 - s01 * s01, np.float32(LEAST_DETERMINANT))
    shared = 1 / (mean(count) + np.float32(LEAST_COUNT))
    found = []
    for y in values:
        my = mean(weight * y) * inverse
        t0 = mean(weight * x0 * y) * inverse - m0 * my
        t1 = mean(weight * x1 * y) * inverse - m1 * my
        a0 = (s11 * t0 - s01 * t1) / determinant
        a1 = (s00 * t1 - s01 * t0) / determinant
        fit = a0, a1, my - a0 * m0 - a1 * m1
        found.append(tuple(mean(count * part) * shared for part in fit))
    return found


def _squared(
    x0: np.ndarray,
    x1: np.ndarray,
    values: list[np.ndarray],
    coefficients: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Return by how much fits are off, squared and summed over the components."""
    total = np.zeros_like(x0)
    for y, (a0, a1, constant) in zip(values, coefficients, strict=True):
        total += (y - a0 * x0 - a1 * x1 - constant) ** 2
    return total


def _too_bent(
    x0: np.ndarray, x1: np.ndarray, coefficients: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return by how much fits are beyond what a steady motion has, squared."""
    zero = np.zeros_like(x0)
    bent = np.sqrt(_squared(x0, x1, [zero, zero], coefficients))
    most = MOST_BENT * np.sqrt(x0 * x0 + x1 * x1) + np.float32(MOST_BENT_AT_REST)
    return np.asarray(np.maximum(bent - most, 0) ** 2)
