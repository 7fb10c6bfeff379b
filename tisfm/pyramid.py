"""Coarse to fine: large motions become small ones on a smaller image."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.data_term import DataTerm
from tisfm.field import Field
from tisfm.half_quadratic import HalfQuadratic, Iteration
from tisfm.image_edges import image_edges_in_lanes, mean_step
from tisfm.kernels.lanes import LaneGrid
from tisfm.runtime import lanes
from tisfm.settings import Settings

COARSEST_SIDE = 12  # px


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What coarse to fine leaves at the finest level.

    Attributes
    ----------
    field : Field
        ρ̂, px/frame.
    minimiser : HalfQuadratic
        With the weights b of the last iteration.
    terms : lane array, 6 components for each data term
        Motion tensors of the last warp.
    history : list of (level, warp, Iteration)
        Every half-quadratic iteration; level 0 is the finest.
    converged : bool
        Whether the last warp of the finest level ceased to evolve.
    """

    field: Field
    minimiser: HalfQuadratic
    terms: np.ndarray
    history: list[tuple[int, int, Iteration]]
    converged: bool


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


def coarse_to_fine(
    grey0: np.ndarray,
    grey1: np.ndarray,
    camera: Camera,
    settings: Settings,
    *,
    components: int,
    contrast: float,
) -> Solution:
    """Estimate ρ̂ from the coarsest level to the finest, from zero.

    Parameters
    ----------
    grey0, grey1 : (H, W) float32
        Grey levels on the 8-bit scale.
    camera : Camera
    settings : Settings
    components : {6, 3, 2}
        Unknowns per pixel.
    contrast : float
        δ, px/frame of every level.
    """
    height, width = grey0.shape
    lane_number = lanes()
    levels = level_count(height, width, settings)
    factor = settings.pyramid_factor
    pyramid0 = gaussian_pyramid(smooth(grey0, settings.presmoothing), factor, levels)
    pyramid1 = gaussian_pyramid(smooth(grey1, settings.presmoothing), factor, levels)
    normalization = settings.normalization
    if normalization is not None:
        normalization *= mean_step(pyramid0[0])
    history: list[tuple[int, int, Iteration]] = []
    coarse: np.ndarray | None = None
    for level in reversed(range(levels)):
        frame0, frame1 = pyramid0.pop(), pyramid1.pop()
        grid = LaneGrid(*frame0.shape, lanes=lane_number)
        field = Field(grid, camera.scaled(factor**level, height, width), components)
        if coarse is not None:
            field.start_from(coarse, factor)
        if settings.image_edges > 0:
            field.edges = image_edges_in_lanes(grid, frame0, settings.image_edges)
        data_term = DataTerm(
            grid,
            frame0,
            frame1,
            scheme=settings.derivatives,
            brightness=settings.brightness,
            gradient=settings.gradient,
            normalization=normalization,
            contrast=math.inf if settings.data_contrast is None else settings.data_contrast,
        )
        minimiser = HalfQuadratic(
            field,
            alpha=settings.alpha,
            contrast=contrast,
            outer_iterations=settings.outer_iterations,
            sweeps=settings.sweeps,
            relaxation=settings.relaxation,
            tolerance=settings.tolerance,
            solver=settings.solver,
            scales=data_term.scales,
            stiffness=settings.stiffness[:components],
            joint=settings.joint_edges,
        )
        for warp in range(settings.warps_on(level)):
            terms = data_term.linearise(field)
            iterations, converged = minimiser.minimise(terms)
            history += [(level, warp, iteration) for iteration in iterations]
        if level > 0:
            coarse = field.images()
    return Solution(
        field=field, minimiser=minimiser, terms=terms, history=history, converged=converged
    )
