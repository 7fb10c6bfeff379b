"""Three frames: the previous frame adds data for the first frame of a pair.

The motion of a surface changes little from frame to frame. So the flow to the previous frame is
about the negative flow to the next frame. The sum of the two flows, the bend, is similar all over
a surface. The bend is fitted where a surface is visible in all three frames. It predicts the flow
where the surface is hidden in the next frame.
"""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from tisfm import runtime
from tisfm.kernels.data.forward_splatting import splat
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.motion.settings import PREVIOUS
from tisfm.settings import Settings
from tisfm.solver.data_term import DataTerm
from tisfm.solver.image_pyramid import MIN_PARALLEL_PIXELS, ImagePyramid
from tisfm.solver.sampling import FAR_FLOW, spline_taps
from tisfm.solver.three_frames import ThreeFrameData
from tisfm.solver.unknowns import Unknowns
from tisfm.threads import start_in_second_thread
from tisfm.visibility.occlusion import flow_residual, occlusion

MIN_COUNT = 1e-4  # pixels: smallest number in a window, as a divisor
MIN_DETERMINANT = 1e-6  # px⁴, of the variances of the flow


@dataclass(frozen=True, kw_only=True)
class PreviousPair:
    """The previous pair, on the last level of its flow."""

    # frame0, frame1: (h, w) float32, smoothed frames of the previous pair. The second is the first
    # frame of the current pair.
    frame0: np.ndarray
    frame1: np.ndarray
    flow: np.ndarray  # (2, h, w) float32: px/frame of the level
    hidden: np.ndarray  # (h, w) bool: pixels of its first frame that are not visible in the second

    @classmethod
    def from_pair(
        cls,
        pyramid: ImagePyramid,
        flow: np.ndarray,  # (2, H, W) float32: px/frame of the finest level
        hidden: np.ndarray,  # (H, W) bool
    ) -> "PreviousPair":
        """Return the data that the next pair needs from a pair."""
        frame0, frame1 = pyramid.frames0[pyramid.last], pyramid.frames1[pyramid.last]
        if frame0.shape != hidden.shape:
            size, scale = frame0.shape[::-1], np.float32(pyramid.scales[pyramid.last])
            mode = cv2.INTER_AREA
            flow = scale * np.stack([cv2.resize(part, size, interpolation=mode) for part in flow])
            hidden = (
                cv2.resize(hidden.astype(np.float32), size, interpolation=mode)
                > PREVIOUS.min_hidden_share
            )
        return cls(frame0=frame0, frame1=frame1, flow=flow, hidden=hidden)

    def backward_flow(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the flow from the second frame back to the first, and the pixels that have a flow.

        Returns the flow, (2, h, w) float32, px/frame, 0 without a flow; and the pixels of the
        second frame that are visible in the first frame, (h, w) bool.
        """
        flow = np.where(self.hidden, np.float32(FAR_FLOW), self.flow)
        sums = aligned_empty((*self.hidden.shape, 4))
        splat(flow, np.zeros(self.hidden.shape, np.float32), sums, any_order=runtime.runs_on_gpu())
        count, _, *displacements = cv2.split(sums)
        is_visible = count > PREVIOUS.min_arrivals
        scale = np.where(
            is_visible, -1 / np.maximum(count, np.float32(PREVIOUS.min_arrivals)), np.float32(0)
        )
        return np.stack([part * scale for part in displacements]), is_visible


class PreviousFrame:
    """Data of the previous frame for a pair (`tisfm.solver.coarse_to_fine.AdditionalData`)."""

    def __init__(
        self,
        pyramid: ImagePyramid,  # pyramid of the current pair
        previous: PreviousPair,
        settings: Settings,
    ) -> None:
        self._pyramid, self._previous, self._settings = pyramid, previous, settings
        self.is_used = False  # whether the previous frame was used
        # (h, w) float32 or None: residual of a flow near the final flow, on the last level; None if
        # the frame is not used
        self.residual: np.ndarray | None = None
        frame = previous.frame0
        # The estimation of coarse levels leaves threads free.
        is_parallel = runtime.threads() > 1 and frame.size >= MIN_PARALLEL_PIXELS
        self._taps = (
            start_in_second_thread(spline_taps, frame)
            if is_parallel
            else partial(spline_taps, frame)
        )

    def joint_data_term(self, unknowns: Unknowns, data_term: DataTerm) -> ThreeFrameData | None:
        """Return the data of all three frames, or None if the motion is not steady."""
        flow = unknowns.flow()
        if not (flow.min() >= -FAR_FLOW and flow.max() <= FAR_FLOW):
            return None
        backward, is_visible = self._previous.backward_flow()
        residual = self._compute_residual(flow)
        hidden = self._find_hidden(flow, residual)
        fit = fit_bend(flow, backward, is_visible & ~hidden)
        if fit is None:
            return None
        bend, deviation, is_steady = fit
        correction = bend - backward - flow
        is_predicted = is_visible & is_steady
        # A visible pixel takes the predicted flow if this flow fits frame 1 better.
        predicted_residual = self._compute_residual(flow + correction * is_predicted)
        is_better = is_predicted & (
            hidden | (predicted_residual < PREVIOUS.max_residual_ratio * residual)
        )
        self.residual = np.where(is_better, predicted_residual, residual)
        # With corrected flow, occluders hide other pixels.
        hidden |= self._find_hidden(flow + correction * is_better, self.residual)
        is_filled = hidden & is_predicted
        unknowns.move(correction * (is_better | is_filled))
        doubt = np.where(
            is_filled,
            np.float32(PREVIOUS.half_trust_deviation_if_hidden**-2),
            np.float32(PREVIOUS.half_trust_deviation**-2),
        )
        trust = 1 / (1 + deviation * doubt)
        trust[~is_visible] = 0
        self.is_used = True
        return ThreeFrameData(
            data_term,
            self._previous.frame0,
            self._taps(),
            bend,
            ((~is_filled).astype(np.float32), trust),
        )

    def _compute_residual(self, flow: np.ndarray) -> np.ndarray:
        """Return the residual of a flow of the last level in the next frame."""
        pyramid, level = self._pyramid, self._pyramid.last
        frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
        return flow_residual(frame0, frame1, flow, self._settings, spline1=pyramid.spline1(level))

    def _find_hidden(self, flow: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return the pixels of the last level that a flow hides in the next frame."""
        pyramid, level = self._pyramid, self._pyramid.last
        frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
        return occlusion(frame0, frame1, flow, self._settings, residual=residual)


def previous_frame(
    pyramid: ImagePyramid, settings: Settings, previous: PreviousPair | None
) -> PreviousFrame | None:
    """Return the data of the previous frame, or None if the previous pair does not fit.

    The second frame of the previous pair has to equal the first frame of the pair at every pixel.
    """
    if previous is None or not np.array_equal(previous.frame1, pyramid.frames0[pyramid.last]):
        return None
    return PreviousFrame(pyramid, previous, settings)


def fit_bend(
    # flow, backward: (2, h, w) float32, px/frame, to the next frame and to the previous frame
    flow: np.ndarray,
    backward: np.ndarray,
    is_visible: np.ndarray,  # (h, w) bool: pixels that are visible in both frames
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the sum of forward and backward flow as an affine function of the backward flow.

    The function is fitted in windows twice, the second time with less weight for outliers. The
    bend of a steady 3D motion depends on depth, as the flow does, so two surfaces in one window
    have different bends.

    Returns the bend, (2, h, w) float32, px/frame; the squared deviation from the bend around every
    pixel, plus the squared excess of the bend over that of a steady motion, (h, w) float32, px²;
    and the pixels whose bend is small enough for a steady motion, (h, w) bool. Returns None if less
    than `min_fitting_share` of the visible pixels fit the bend.
    """
    h, w = is_visible.shape
    margin = min(PREVIOUS.grid_step, h, w) // 2
    interior = cv2.erode(
        is_visible.astype(np.float32),
        np.ones((PREVIOUS.visible_window, PREVIOUS.visible_window), np.uint8),
    )
    grid_pixels = np.s_[margin :: PREVIOUS.grid_step, margin :: PREVIOUS.grid_step]
    first_weight = np.ascontiguousarray(interior[grid_pixels])
    if not first_weight.any():
        return None
    x0, x1 = (np.ascontiguousarray(component[grid_pixels]) for component in backward)
    sums = [
        np.ascontiguousarray(a[grid_pixels] + b[grid_pixels])
        for a, b in zip(flow, backward, strict=True)
    ]
    coefficients = _fit_affine(x0, x1, sums, first_weight)
    deviation = _squared_deviation(x0, x1, sums, coefficients)
    weight = first_weight / (1 + deviation / PREVIOUS.half_weight_deviation**2)
    coefficients = _fit_affine(x0, x1, sums, weight)
    excess = _excess_bend(x0, x1, coefficients)
    deviation = _squared_deviation(x0, x1, sums, coefficients) + excess
    if (
        first_weight * (deviation < PREVIOUS.half_trust_deviation**2)
    ).sum() < PREVIOUS.min_fitting_share * first_weight.sum():
        return None
    window = (2 * PREVIOUS.mean_radius + 1, 2 * PREVIOUS.mean_radius + 1)
    count = cv2.boxFilter(first_weight, -1, window)
    mean_deviation = np.asarray(
        cv2.boxFilter(deviation * first_weight, -1, window) / (count + np.float32(MIN_COUNT))
    )

    def upsample(values: np.ndarray) -> np.ndarray:
        return cv2.resize(values, (w, h), interpolation=cv2.INTER_LINEAR)

    bend = np.empty_like(flow)
    for component, (a0, a1, constant) in enumerate(coefficients):
        bend[component] = (
            upsample(a0) * backward[0] + upsample(a1) * backward[1] + upsample(constant)
        )
    return bend, upsample(mean_deviation), upsample(excess) < PREVIOUS.half_trust_deviation**2


def _fit_affine(
    x0: np.ndarray, x1: np.ndarray, values: list[np.ndarray], weight: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return (a0, a1, c) of the fit a0·x0 + a1·x1 + c to each of the values at every pixel.

    As in a guided filter, every window has a fit, and a pixel takes the mean of the fits of all
    windows that contain the pixel.

    References
    ----------
    He, Sun, Tang, "Guided image filtering", PAMI 35 (2013), 1397, doi 10.1109/TPAMI.2012.213.
    """
    side = 2 * (PREVIOUS.window_radius // PREVIOUS.grid_step) + 1

    def mean(image: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(image, -1, (side, side), borderType=cv2.BORDER_REFLECT_101)

    count = mean(weight)
    inverse = 1 / (count + np.float32(MIN_COUNT))
    m0, m1 = mean(weight * x0) * inverse, mean(weight * x1) * inverse
    s00 = mean(weight * x0 * x0) * inverse - m0 * m0 + np.float32(PREVIOUS.added_variance)
    s01 = mean(weight * x0 * x1) * inverse - m0 * m1
    s11 = mean(weight * x1 * x1) * inverse - m1 * m1 + np.float32(PREVIOUS.added_variance)
    determinant = np.maximum(s00 * s11 - s01 * s01, np.float32(MIN_DETERMINANT))
    mean_count = 1 / (mean(count) + np.float32(MIN_COUNT))
    fits = []
    for y in values:
        my = mean(weight * y) * inverse
        t0 = mean(weight * x0 * y) * inverse - m0 * my
        t1 = mean(weight * x1 * y) * inverse - m1 * my
        a0 = (s11 * t0 - s01 * t1) / determinant
        a1 = (s00 * t1 - s01 * t0) / determinant
        fit = a0, a1, my - a0 * m0 - a1 * m1
        fits.append(tuple(mean(count * part) * mean_count for part in fit))
    return fits


def _squared_deviation(
    x0: np.ndarray,
    x1: np.ndarray,
    values: list[np.ndarray],
    coefficients: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Return the squared deviations of values from their fits, summed over the components."""
    total = np.zeros_like(x0)
    for y, (a0, a1, constant) in zip(values, coefficients, strict=True):
        total += (y - a0 * x0 - a1 * x1 - constant) ** 2
    return total


def _excess_bend(
    x0: np.ndarray, x1: np.ndarray, coefficients: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return the squared excess of fitted bends over the largest bend of a steady motion."""
    zero = np.zeros_like(x0)
    bend = np.sqrt(_squared_deviation(x0, x1, [zero, zero], coefficients))
    max_bend = PREVIOUS.max_bend_ratio * np.sqrt(x0 * x0 + x1 * x1) + np.float32(
        PREVIOUS.max_bend_at_rest
    )
    return np.asarray(np.maximum(bend - max_bend, 0) ** 2)
