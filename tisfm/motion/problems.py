"""The solver's problems by the settings: one for a flow field, and one for depth."""

import math

import numpy as np

from tisfm.camera import Camera
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Problem
from tisfm.solver.data_term import Constancy
from tisfm.solver.half_quadratic import Effort
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.smoothness import Smoothness


def pyramid_of(
    grey0: np.ndarray,
    grey1: np.ndarray,
    camera: Camera,
    settings: Settings,
    valid: tuple[np.ndarray, np.ndarray] | None = None,
) -> ImagePyramid:
    """Return the pyramid of a pair of grey frames, (H, W) float32 on the 8-bit scale.

    `valid`, (H, W) bool each, are the used pixels of each frame, by default all.
    """
    return ImagePyramid(
        grey0,
        grey1,
        camera,
        factor=settings.pyramid_factor,
        levels=settings.pyramid_levels,
        presmoothing=settings.presmoothing,
        last=settings.finest_level,
        valid=valid,
    )


def flow_problem(
    settings: Settings,
    focal: float,  # focal length of the finest level, px
    stiffness: tuple[float, ...] | None = None,  # stiffness of other unknowns than the model's
) -> Problem:
    """Return the problem of free motion, by default with the unknowns of the settings' model."""
    return _problem(
        settings,
        brightness=settings.brightness,
        normalization=settings.normalization,
        alpha=settings.alpha,
        contrast=settings.contrast_for(focal),
        stiffness=stiffness or settings.stiffness[: settings.components],
    )


def depth_problem(
    settings: Settings,
    focal: float,  # focal length of the level, px
) -> Problem:
    """Return the problem of inverse depth under known motions."""
    return _problem(
        settings,
        brightness=settings.depth_brightness,
        normalization=settings.depth_normalization,
        alpha=settings.depth_smoothness,
        contrast=settings.contrast_for(focal),
        stiffness=(1.0,),
    )


def _problem(
    settings: Settings,
    *,
    brightness: float,
    normalization: float | None,
    alpha: float,
    contrast: float,
    stiffness: tuple[float, ...],
) -> Problem:
    return Problem(
        constancy=Constancy(
            brightness=brightness,
            gradient=settings.gradient,
            normalization=normalization,
            contrast=math.inf if settings.data_contrast is None else settings.data_contrast,
            derivatives=settings.derivatives,
        ),
        smoothness=Smoothness(
            alpha=alpha,
            contrast=contrast,
            stiffness=stiffness,
            joint=settings.joint_edges,
            image_edges=settings.image_edges,
        ),
        effort=Effort(
            outer_iterations=settings.outer_iterations,
            sweeps=settings.sweeps,
            cycles=settings.cycles,
            relaxation=settings.relaxation,
            tolerance=settings.tolerance,
            solver=settings.solver,
            is_thorough=settings.pyramid_levels == 1,
        ),
        warps=settings.warps_on,
    )
