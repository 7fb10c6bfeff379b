"""Coarse to fine: large motions become small ones on a smaller image."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import cv2
import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import LaneGrid
from tisfm.kernels.layout.launch import Replay
from tisfm.runtime import lane_grid
from tisfm.settings import Settings
from tisfm.solver.data_term import DataTerm
from tisfm.solver.half_quadratic import HalfQuadratic, Iteration
from tisfm.solver.resampling import enlarged
from tisfm.solver.sampling import spline_taps
from tisfm.solver.smoothness import image_edges_in_lanes, mean_step
from tisfm.solver.unknowns import Field
from tisfm.visibility.occlusion import occlusion

COARSEST_SIDE = 12  # px
BESIDE = 1 << 16  # pixels from which on a second thread pays


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What coarse to fine leaves at the level that it ends on.

    Attributes
    ----------
    field : Field
        ρ̂, px/frame.
    minimiser : HalfQuadratic
        With the weights b of the last iteration.
    history : list of (level, warp, Iteration)
        Every half-quadratic iteration; level 0 is the finest.
    converged : bool
        Whether the last warp of that level ceased to evolve.
    """

    field: Field
    minimiser: HalfQuadratic
    history: list[tuple[int, int, Iteration]]
    converged: bool


@cache
def _second_thread() -> Executor:
    from concurrent.futures import ThreadPoolExecutor  # impossible after the main thread has ended

    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="tisfm-pyramid")


def _beside(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Start a call in the second thread; return what waits for its result."""
    try:
        return _second_thread().submit(function, *arguments).result
    except RuntimeError:  # the main thread has ended, and with it the second
        return cache(partial(function, *arguments))


def smooth(image: np.ndarray, sigma: float) -> np.ndarray:
    """Return the image convolved with a Gaussian of `sigma` px, its border reflected."""
    if sigma == 0:
        return image
    return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)


def level_count(height: int, width: int, settings: Settings) -> int:
    """Return the number of levels: those asked for, as far as `COARSEST_SIDE` admits them."""
    side = min(height, width)
    most = 1
    if side > COARSEST_SIDE:
        most += int(math.log(COARSEST_SIDE / side) / math.log(settings.pyramid_factor))
    return most if settings.pyramid_levels is None else min(most, settings.pyramid_levels)


def gaussian_pyramid(image: np.ndarray, factor: float, levels: int) -> list[np.ndarray]:
    """Return `levels` images, the given one first, each `factor` times as densely sampled.

    The scale is `factor` exactly, in both directions, whatever the rounding of the sizes: pixel
    x of a level lies at (x + ½)/factor − ½ on the one before. Each level is smoothed beforehand
    by a Gaussian of 0.6·√(1/factor² − 1) px, so that it keeps the sharpness of the first.

    Parameters
    ----------
    image : (H, W) float32
    factor : float
    levels : int

    References
    ----------
    Sánchez, Meinhardt-Llopis, Facciolo, "TV-L1 optical flow estimation", IPOL 2013, section 2.5,
    doi 10.5201/ipol.2013.26.
    """
    sigma = 0.6 * math.sqrt(1 / factor**2 - 1)
    pyramid = [image]
    for _ in range(levels - 1):
        smoothed = smooth(pyramid[-1], sigma)
        pyramid.append(
            cv2.resize(smoothed, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
        )
    return pyramid


class Pyramid:
    """Both frames at every level, 0 the finest.

    Parameters
    ----------
    grey0, grey1 : (H, W) float32
        Grey levels on the 8-bit scale.
    camera : Camera
    settings : Settings
        Presmoothing and the levels.

    Attributes
    ----------
    camera : Camera
        Of the finest level.
    frames0, frames1 : list of (h, w) float32
        Smoothed beforehand, the finest first.
    contrast : float
        Mean |ΔI| between neighbours of frame 0 at the finest level.
    """

    def __init__(
        self, grey0: np.ndarray, grey1: np.ndarray, camera: Camera, settings: Settings
    ) -> None:
        self.camera, self._settings = camera, settings
        if grey0.min() == grey0.max() and grey1.min() == grey1.max():
            # What rounding leaves of a uniform frame would be all the data there is.
            grey0, grey1 = np.zeros_like(grey0), np.zeros_like(grey1)
        height, width = grey0.shape
        levels, factor = level_count(height, width, settings), settings.pyramid_factor

        def frames(grey: np.ndarray) -> list[np.ndarray]:
            return gaussian_pyramid(smooth(grey, settings.presmoothing), factor, levels)

        beside = runtime.threads() > 1 and grey0.size >= BESIDE
        if beside:
            # OpenCV's filters take one thread each, and so do kernels on coarse levels.
            others = _beside(frames, grey1)
            self.frames0, self.frames1 = frames(grey0), others()
        else:
            self.frames0, self.frames1 = frames(grey0), frames(grey1)
        self._taps1 = [self._spline(level) for level in range(levels)]
        if beside:
            for level in reversed(range(self.last(settings), levels)):  # the coarsest comes first
                self._taps1[level] = _beside(spline_taps, self.frames1[level])
        self.contrast = mean_step(self.frames0[0])

    def taps1(self, level: int) -> np.ndarray:
        """Return `tisfm.solver.sampling.spline_taps` of frame 1 at a level."""
        return self._taps1[level]()

    def release_taps1(self, level: int) -> None:
        """Let go of the taps of a level: whoever asks for them again has them computed again."""
        self._taps1[level] = self._spline(level)

    def _spline(self, level: int) -> Callable[[], np.ndarray]:
        return cache(partial(spline_taps, self.frames1[level]))

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self.frames0)

    def scale(self, level: int) -> float:
        """Return the sampling density of a level relative to the finest."""
        return self._settings.pyramid_factor**level

    def field(self, level: int, components: int, coarse: Field | None) -> Field:
        """Return the unknown of a level, from that of the next coarser one or from zero."""
        frame0 = self.frames0[level]
        grid = lane_grid(*frame0.shape)
        camera = self.camera.scaled(self.scale(level), *self.frames0[0].shape)
        field = Field(grid, camera, components)
        if coarse is not None:
            field.start_from(coarse, self._settings.pyramid_factor)
        if self._settings.image_edges > 0:
            field.edges = image_edges_in_lanes(grid, frame0, self._settings.image_edges)
        return field

    def last(self, settings: Settings) -> int:
        """Return the level to end on."""
        return min(settings.finest_level, self.levels - 1)

    def images(self, field: Field, level: int) -> np.ndarray:
        """Return the unknown of a level at the pixels of the finest, (components, H, W) float32."""
        if level == 0:
            return field.images()
        if self._settings.pyramid_factor != 0.5:
            fine = Field(lane_grid(*self.frames0[0].shape), self.camera, field.components)
            fine.start_from(field, self.scale(level))
            return fine.images()
        return enlarged(2**level * field.images(), 2**level, *self.frames0[0].shape)

    def data_term(
        self, level: int, grid: LaneGrid, settings: Settings, *, depth: bool = False
    ) -> DataTerm:
        """Return the data term of a level: that of free motion, or the one for `depth`."""
        brightness, share = settings.brightness, settings.normalization
        if depth:
            brightness, share = settings.depth_brightness, settings.depth_normalization
        return DataTerm(
            grid,
            self.frames0[level],
            self.frames1[level],
            self.taps1(level),
            scheme=settings.derivatives,
            brightness=brightness,
            gradient=settings.gradient,
            normalization=None if share is None else share * self.contrast,
            contrast=math.inf if settings.data_contrast is None else settings.data_contrast,
        )

    def occlusion(
        self, flow: np.ndarray, leaves: np.ndarray | None = None, *, level: int = 0
    ) -> np.ndarray:
        """Return which pixels a flow of the finest level, (2, H, W), hides: (H, W) bool.

        `leaves` are those that it takes out of the image, if they are at hand. The frames of
        `level` tell how well the flow meets them, where its pixels are whole numbers of others.
        """
        if self._settings.pyramid_factor != 0.5:
            level = 0
        return occlusion(
            self.frames0[level],
            self.frames1[level],
            flow,
            self._settings,
            factor=2**level,
            taps1=self.taps1(level),
            leaves=leaves,
        )

    def minimiser(
        self,
        field: Field,
        data_term: DataTerm,
        settings: Settings,
        *,
        alpha: float,
        contrast: float,
        stiffness: Sequence[float],
    ) -> HalfQuadratic:
        """Return the minimiser of a level's unknown; iterations are those of the settings."""
        return HalfQuadratic(
            field,
            alpha=alpha,
            contrast=contrast,
            outer_iterations=settings.outer_iterations,
            sweeps=settings.sweeps,
            cycles=settings.cycles,
            relaxation=settings.relaxation,
            tolerance=settings.tolerance,
            solver=settings.solver,
            scales=data_term.scales,
            stiffness=stiffness,
            joint=settings.joint_edges,
        )


def coarse_to_fine(
    pyramid: Pyramid, settings: Settings, *, components: int, contrast: float, finest: int = 0
) -> Solution:
    """Estimate ρ̂ from the coarsest level to the finest, from zero.

    Parameters
    ----------
    pyramid : Pyramid
    settings : Settings
    components : {6, 3, 2}
        Unknowns per pixel.
    contrast : float
        δ, px/frame of every level.
    finest : int
        The level to end with.
    """
    history: list[tuple[int, int, Iteration]] = []
    field: Field | None = None
    solution: Solution | None = None
    for level in reversed(range(finest, pyramid.levels)):
        solution = None  # of the level before, only its field is needed
        field = pyramid.field(level, components, field)
        warps = settings.warps_on(level - finest)
        solution = _on_level(pyramid, settings, field, level, contrast=contrast, warps=warps)
        history += solution.history
        if level > finest and settings.motion == "field":  # other motions go on from there
            pyramid.release_taps1(level)
    assert solution is not None
    return replace(solution, history=history)


def _on_level(
    pyramid: Pyramid, settings: Settings, field: Field, level: int, *, contrast: float, warps: int
) -> Solution:
    """Estimate ρ̂ on one level, from what it is."""
    data_term = pyramid.data_term(level, field.grid, settings)
    minimiser = pyramid.minimiser(
        field,
        data_term,
        settings,
        alpha=settings.alpha,
        contrast=contrast,
        stiffness=settings.stiffness[: field.components],
    )
    flow = field.grid.allocate(2, zeros=False)
    linearise = Replay(
        lambda: data_term.linearise(field.flow(flow), minimiser.tensor),
        on_device=field.grid.on_device,
    )
    history: list[tuple[int, int, Iteration]] = []
    for warp in range(warps):
        iterations, converged = minimiser.minimise(linearise(), renewed=warp > 0)
        history += [(level, warp, iteration) for iteration in iterations]
    minimiser.release()
    return Solution(field=field, minimiser=minimiser, history=history, converged=converged)
