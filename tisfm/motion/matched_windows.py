"""Displacements by matching windows of two frames, from coarse to fine, in both directions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from tisfm.kernels.rigid.flow_search import FlowSearch
from tisfm.kernels.rigid.windows import MAX_GREY, UNTEXTURED
from tisfm.motion.matched_planes import MAX_UNSAMPLED_PIXELS, grey_scale, noise_deviation
from tisfm.motion.settings import DEPTH, PROPOSALS
from tisfm.solver.data_term import Constancy
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.sampling import target_pixels

InitialFlow = tuple[np.ndarray, float]  # a flow, and the scale of its level


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Grey levels of both frames on one level, whose windows are compared."""

    # grey0, grey1: (h, w) float32, grey levels of both frames, in [0, 255]
    grey0: np.ndarray
    grey1: np.ndarray
    noise: float  # standard deviation of the noise of the noisier frame, grey levels
    scale: float  # sampling density relative to the finest level of the pyramid
    # valid0, valid1: (h, w) bool, pixels of both frames that are compared; None for all
    valid0: np.ndarray | None = None
    valid1: np.ndarray | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        height, width = self.grey0.shape
        return height, width

    def swap_frames(self) -> "Windows":
        """Return these windows with the frames exchanged."""
        return replace(
            self, grey0=self.grey1, grey1=self.grey0, valid0=self.valid1, valid1=self.valid0
        )

    def crop(self, crop: tuple[slice, slice]) -> "Windows":
        """Return these windows of some rows and columns."""
        valid0, valid1 = (
            None if valid is None else valid[crop] for valid in (self.valid0, self.valid1)
        )
        return replace(
            self, grey0=self.grey0[crop], grey1=self.grey1[crop], valid0=valid0, valid1=valid1
        )

    @cached_property
    def search(self) -> FlowSearch:
        """A search on this level."""
        return FlowSearch(self.grey0, self.grey1, noise=self.noise)

    def score_flow(
        self,
        flow: np.ndarray,  # (h, w, 2) float32: px/frame
        *,
        mask: np.ndarray | None = None,  # (h, w) bool: pixels that are searched, by default all
        # variance of a compared window divided by the variance of the noise
        min_variance: float = PROPOSALS.min_window_variance,
    ) -> np.ndarray:
        """Return a flow (h, w, 2) as the state of a search (`tisfm.kernels.rigid.flow_search`)."""
        state = np.zeros((*self.shape, 4), np.float32)
        state[..., :2] = flow
        state[..., 3] = True if mask is None else mask
        self.search.score(state, min_variance=min_variance)
        self.mark_invalid(state)
        return state

    def mark_invalid(self, state: np.ndarray) -> None:
        """Set the cost of a state to `UNTEXTURED` where a pixel or its target is ignored."""
        if self.valid0 is not None and self.valid1 is not None:
            target = target_pixels(np.moveaxis(state[..., :2], -1, 0))
            state[~(self.valid0 & self.valid1[target]), 2] = UNTEXTURED


class WindowSearch:
    """A search on several levels, each about twice as dense as the previous level."""

    def __init__(
        self,
        pyramid: ImagePyramid,
        finest: int,  # level of the result
    ) -> None:
        self._pyramid = pyramid
        self._windows: dict[int, Windows] = {}
        step = max(1, round(np.log(0.5) / np.log(pyramid.factor)))
        levels = range(finest, pyramid.levels, step)
        # levels of the pyramid, the coarsest first
        self.levels = [k for k in levels if pyramid.frames0[k].size >= PROPOSALS.min_search_pixels][
            ::-1
        ] or [finest]
        # Noise is measured on the finest level: coarser levels have less noise, and more detail
        # that looks like noise. The gain scales the range of the frames, however small, to 255.
        frames = pyramid.frames0[finest], pyramid.frames1[finest]
        gain = grey_scale(*frames)[1]
        stride = 2 if frames[0].size > MAX_UNSAMPLED_PIXELS else 1
        valid = pyramid.valid_on(finest) or (None, None)
        noise = max(
            noise_deviation(gain * frame, stride=stride, valid=mask)
            for frame, mask in zip(frames, valid, strict=True)
        )
        self._noise = noise / (gain * pyramid.scales[finest])

    def windows(self, level: int) -> Windows:
        """Return the windows of a level; searched and coarser levels are cached."""
        if level in self._windows:
            return self._windows[level]
        frames = self._pyramid.frames0[level], self._pyramid.frames1[level]
        scale = self._pyramid.scales[level]
        low, gain = grey_scale(*frames)
        grey0, grey1 = (np.clip(gain * (frame - low), 0, MAX_GREY) for frame in frames)
        noise = max(gain * scale * self._noise, DEPTH.min_coarse_noise)
        valid0, valid1 = self._pyramid.valid_on(level) or (None, None)
        windows = Windows(
            grey0=grey0, grey1=grey1, noise=noise, scale=scale, valid0=valid0, valid1=valid1
        )
        if level >= self.levels[-1]:
            self._windows[level] = windows
        return windows

    def match_forward(
        self,
        levels: list[int],
        *,
        # sequence of ((…, …, 2) float32, float): initial flows, each in px/frame of a level, with
        # the scale of that level. At every pixel, the flow of least cost starts the search. By
        # default, displacements are random.
        initial_flows: Sequence[InitialFlow] = (),
        # array of bool: pixels that are searched, on any level; by default all
        mask: np.ndarray | None = None,
        # draws of all pixels together in a wide round, if few pixels are searched
        wide_draws: int = PROPOSALS.wide_draws,
    ) -> np.ndarray:
        """Match frame 0 in frame 1; return the state (h, w, 4) on the last of the levels."""
        return _search_levels(
            [self.windows(k) for k in levels], initial_flows, mask, wide_draws, seed=0
        )

    def match_backward(
        self,
        levels: list[int],
        *,
        initial_flows: Sequence[InitialFlow] = (),
        mask: np.ndarray | None = None,
        wide_draws: int = PROPOSALS.wide_draws,
    ) -> np.ndarray:
        """Match frame 1 in frame 0; parameters and result as for `match_forward`."""
        windows = [self.windows(k).swap_frames() for k in levels]
        return _search_levels(windows, initial_flows, mask, wide_draws, seed=1)


def resize_flow(
    flow: np.ndarray,  # (h', w', 2) float32: px/frame
    shape: tuple[int, int],  # height and width of the other level, px
    # sampling density of the other level divided by that of the flow's level; the ratio of the
    # rounded sizes may differ
    ratio: float,
) -> np.ndarray:
    """Return a flow (h, w, 2) on another level: means on a coarser level, else nearest values."""
    mode = cv2.INTER_AREA if ratio < 1 else cv2.INTER_NEAREST
    return np.float32(ratio) * np.asarray(cv2.resize(flow, shape[::-1], interpolation=mode))


def _search_levels(
    levels: list[Windows],
    initial_flows: Sequence[InitialFlow],
    mask: np.ndarray | None,
    wide_draws: int,
    *,
    seed: int,
) -> np.ndarray:
    state: np.ndarray | None = None
    for k, windows in enumerate(levels):
        level_mask = None if mask is None else resize_mask(mask, windows.shape)
        is_first = state is None
        flows = [
            resize_flow(flow, windows.shape, windows.scale / scale) for flow, scale in initial_flows
        ]
        if state is not None:
            ratio = windows.scale / levels[k - 1].scale
            flows.append(resize_flow(state[..., :2], windows.shape, ratio))
        state = _cheapest_states(
            [
                windows.score_flow(flow, mask=level_mask)
                for flow in flows or [_random_flow(windows, seed)]
            ]
        )
        search = windows.search
        pixel_count = windows.grey0.size if level_mask is None else np.count_nonzero(level_mask)
        for round_number in range(
            PROPOSALS.rounds[0] if is_first else PROPOSALS.rounds[min(k, 1) + 1]
        ):
            draws, spans = (
                PROPOSALS.near_draws,
                (PROPOSALS.near_span * PROPOSALS.span_shrinkage**round_number,) * 2,
            )
            if is_first and round_number < PROPOSALS.wide_rounds:
                draws = max(
                    PROPOSALS.min_wide_draws,
                    min(wide_draws // max(pixel_count, 1), PROPOSALS.max_wide_draws),
                )
                spans = PROPOSALS.max_wide_span * max(windows.shape), PROPOSALS.min_wide_span
            search.improve(
                state,
                neighbour_distance=PROPOSALS.neighbour_distance,
                draws=draws,
                spans=(spans[0], spans[1]),
                seed=(seed * len(levels) + k) * max(PROPOSALS.rounds) + round_number,
            )
    assert state is not None
    levels[-1].mark_invalid(state)
    return state


def _cheapest_states(states: list[np.ndarray]) -> np.ndarray:
    """Return the state of least cost at every pixel."""
    cheapest = states[0]
    for state in states[1:]:
        cheapest = np.where((state[..., 2] < cheapest[..., 2])[..., None], state, cheapest)
    return cheapest


def resize_mask(mask: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a mask on another level, with all pixels that lie partly in the given mask."""
    if mask.shape == shape:
        return mask
    coverage = cv2.resize(mask.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(coverage) > 0


def _random_flow(windows: Windows, seed: int) -> np.ndarray:
    """Return a random flow (h, w, 2) float32, px/frame."""
    values = np.random.default_rng(seed).random((*windows.shape, 2), np.float32)
    return (2 * values - 1) * np.float32(PROPOSALS.max_wide_span * max(windows.shape))


class ResidualComparison:
    """Residuals of frame 1 along a flow, in standard deviations of the noise."""

    def __init__(
        self,
        windows: Windows,
        constancy: Constancy,  # its weights of brightness and of the gradient are used
    ) -> None:
        weights = (constancy.brightness, constancy.gradient, constancy.gradient)
        self._weights = [weight / sum(weights) for weight in weights]
        self._noise = windows.noise
        self._frames0, self._frames1 = map(_frame_and_slopes, (windows.grey0, windows.grey1))

    def is_better(
        self,
        # flow, other_flow: (h, w, 2) float32, px/frame
        flow: np.ndarray,
        other_flow: np.ndarray,
        *,
        # px: side of the square in which residuals are averaged with Gaussian weights, so that a
        # pixel at the corner of an object takes part in that object
        window: int,
        min_gain: float = 0.0,  # smallest difference, deviations of the noise
    ) -> np.ndarray:
        """Return where a flow has a smaller residual than another flow, (h, w) bool."""
        residual, other_residual = (
            cv2.GaussianBlur(self._residual(field), (window, window), 0)
            for field in (flow, other_flow)
        )
        return np.asarray(residual < other_residual - min_gain)

    def _residual(self, flow: np.ndarray) -> np.ndarray:
        height, width = flow.shape[:2]
        x = flow[..., 0] + np.arange(width, dtype=np.float32)
        y = flow[..., 1] + np.arange(height, dtype=np.float32)[:, None]
        residual = np.zeros((height, width), np.float32)
        for weight, frame0, frame1 in zip(self._weights, self._frames0, self._frames1, strict=True):
            warped = cv2.remap(frame1, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            residual += weight * np.minimum(
                np.abs(warped - frame0) / self._noise, PROPOSALS.max_residual
            )
        return residual


def _frame_and_slopes(grey: np.ndarray) -> list[np.ndarray]:
    """Return a frame divided by √2, and its slopes.

    The difference of two frames has √2 times the noise of a single frame.
    """
    kernel = np.array([[-0.5, 0, 0.5]], np.float32)
    slope_x, slope_y = (cv2.filter2D(grey, cv2.CV_32F, k) for k in (kernel, kernel.T))
    return [grey / np.float32(2**0.5), slope_x, slope_y]
