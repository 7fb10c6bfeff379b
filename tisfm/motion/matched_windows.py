"""Displacements found by comparing windows of two frames, from coarse to fine, either way round."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.kernels.rigid.flow_search import FlowSearch
from tisfm.kernels.rigid.patch_match import LEVELS
from tisfm.motion.matched_planes import LEAST_NOISE, QUIETEST, noise_deviation
from tisfm.solver.image_pyramid import ImagePyramid

FEWEST = 2**12  # pixels of the coarsest level, at least
SEEN = 1.8  # times the variance of the noise: windows that vary by less are not compared
ROUNDS = (6, 3, 2)  # of improvement: on the coarsest level, on the next, and on all others
DRAWS, MOST_DRAWS = 7, 28  # on the coarsest level: of every pixel, and where few are sought
DRAWS_NEARBY = (3, 2)  # on the next, and on all others
REACH = 5  # px: how far away the further neighbours are
LARGEST = 0.35  # of the longer side: how far away a pixel is sought on the coarsest level
NEARBY, SHRINKING = 4.0, 0.6  # px: on the others; less with every round


@dataclass(frozen=True, kw_only=True)
class Windows:
    """What is compared on one level.

    Attributes
    ----------
    levels0, levels1 : (h, w) float32
        Grey levels of both frames, in [0, 255].
    noise : float
        Its standard deviation, levels.
    """

    levels0: np.ndarray
    levels1: np.ndarray
    noise: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        height, width = self.levels0.shape
        return height, width

    def turned(self) -> "Windows":
        """Return the same with the frames exchanged."""
        return Windows(levels0=self.levels1, levels1=self.levels0, noise=self.noise)

    def search(self, *, seen: float = SEEN) -> FlowSearch:
        """Return a search on this level."""
        return FlowSearch(self.levels0, self.levels1, noise=self.noise, seen=seen)

    def scored(
        self, flow: np.ndarray, *, sought: np.ndarray | None = None, seen: float = SEEN
    ) -> np.ndarray:
        """Return a flow (h, w, 2) as the state of a search (`tisfm.kernels.rigid.flow_search`).

        Parameters
        ----------
        flow : (h, w, 2) float32
            px/frame.
        sought : (h, w) bool, optional
            By default every pixel.
        seen : float
            Times the variance of the noise: what a window has to vary by.
        """
        state = np.zeros((*self.shape, 4), np.float32)
        state[..., :2] = flow
        state[..., 3] = True if sought is None else sought
        self.search(seen=seen).score(state)
        return state


class WindowSearch:
    """Windows of all levels that are searched, the coarsest first.

    Parameters
    ----------
    pyramid : ImagePyramid
    finest : int
        Level to end on.
    """

    def __init__(self, pyramid: ImagePyramid, finest: int) -> None:
        frames = pyramid.frames0, pyramid.frames1
        noise = max(noise_deviation(of[finest]) for of in frames)
        step = max(1, round(np.log(0.5) / np.log(pyramid.factor)))
        levels = range(finest, pyramid.levels, step)
        large = [k for k in levels if pyramid.frames0[k].size >= FEWEST] or [finest]
        ends = [extreme for of in frames for extreme in (of[finest].min(), of[finest].max())]
        low, gain = min(ends), LEVELS / max(float(max(ends) - min(ends)), LEAST_NOISE)
        self.windows = [
            Windows(
                levels0=np.float32(gain) * (pyramid.frames0[k] - low),
                levels1=np.float32(gain) * (pyramid.frames1[k] - low),
                noise=max(gain * noise * pyramid.scales[k] / pyramid.scales[finest], QUIETEST),
            )
            for k in reversed(large)
        ]

    def forward(self, flow: np.ndarray, sought: np.ndarray | None = None) -> np.ndarray:
        """Return the state (h, w, 4) of the finest level, where frame 0 is sought in frame 1.

        Parameters
        ----------
        flow : (h, w, 2) float32
            What is known, which is kept where nothing is better; px/frame of the finest level.
        sought : array of bool, optional
            Where; by default everywhere.
        """
        return _searched(self.windows, flow, sought, seed=0)

    def backward(self, sought: np.ndarray | None = None) -> np.ndarray:
        """Return the state (h, w, 4) of the finest level, where frame 1 is sought in frame 0."""
        turned = [windows.turned() for windows in self.windows]
        return _searched(turned, None, sought, seed=1)


def resized(flow: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a flow (h, w, 2) of a finer level as means over the pixels of a coarser one, px."""
    height, width = shape
    ratio = np.float32(width / flow.shape[1])
    smaller: np.ndarray = cv2.resize(flow, (width, height), interpolation=cv2.INTER_AREA)
    return ratio * smaller


def _searched(
    levels: list[Windows], flow: np.ndarray | None, sought: np.ndarray | None, *, seed: int
) -> np.ndarray:
    state: np.ndarray | None = None
    for k, windows in enumerate(levels):
        size = windows.shape[::-1]
        here = None if sought is None else _masked(sought, size)
        share = 1.0 if here is None else float(here.mean())
        states = []
        if state is not None:
            finer = cv2.resize(state, size, interpolation=cv2.INTER_NEAREST)[..., :2]
            ratio = np.float32(windows.shape[1] / state.shape[1])
            states.append(windows.scored(ratio * finer, sought=here))
        if flow is not None:
            states.append(windows.scored(resized(flow, windows.shape), sought=here))
        if not states:
            states.append(windows.scored(_drawn(windows.shape, seed), sought=here))
        state = states[0]
        for other in states[1:]:
            state = np.where((other[..., 2] < state[..., 2])[..., None], other, state)
        search = windows.search()
        for turn in range(ROUNDS[min(k, len(ROUNDS) - 1)]):
            if k == 0:
                draws = int(min(DRAWS / max(share, DRAWS / MOST_DRAWS), MOST_DRAWS))
                span = LARGEST * max(windows.shape)
            else:
                draws = DRAWS_NEARBY[min(k - 1, len(DRAWS_NEARBY) - 1)]
                span = NEARBY * SHRINKING**turn
            number = (seed * len(levels) + k) * max(ROUNDS) + turn
            search.improve(state, reach=REACH, draws=draws, span=span, seed=number)
    assert state is not None
    return state


def _masked(sought: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return where a mask of another level has any."""
    mask: np.ndarray = cv2.resize(sought.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return mask > 0


def _drawn(shape: tuple[int, int], seed: int) -> np.ndarray:
    """Return a flow (h, w, 2) float32 drawn at random, px/frame."""
    random = np.random.default_rng(seed).random((*shape, 2), np.float32)
    return (2 * random - 1) * np.float32(LARGEST * max(shape))
