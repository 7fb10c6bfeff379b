"""Horn and Schunck's optical flow with coarse-to-fine warping: the paper's baseline."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.frames import grey_pair
from tisfm.settings import Settings, check_settings

__all__ = ["horn_schunck"]


def horn_schunck(
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    smoothness: float = 100.0,
    settings: Settings | None = None,
) -> np.ndarray:
    """Estimate optical flow with a quadratic, isotropic smoothness term.

    Pyramid, warping, derivatives and solver are the same as in `tisfm.interpret`. The unknown is
    the flow itself. All pairs of neighbouring pixels have the same weight of smoothness.

    Parameters
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) array
        As for `tisfm.interpret`.
    smoothness : float
        Horn and Schunck's α², in squared grey levels of the 8-bit scale.
    settings : Settings, optional
        Pyramid, warps, iterations, derivatives and presmoothing are used, the other settings are
        not. By default the preset ``"balanced"``.

    Returns
    -------
    (H, W, 2) float32
        Flow (u, v), px/frame.

    Raises
    ------
    TypeError, ValueError
        As `tisfm.interpret`; also if `smoothness` is not a positive number.

    References
    ----------
    Horn, Schunck, "Determining optical flow", Artificial Intelligence 17 (1981) 185–203,
    doi 10.1016/0004-3702(81)90024-2.

    Examples
    --------
    >>> from tisfm.horn_schunck import horn_schunck
    >>> from tisfm.metrics import endpoint_error
    >>> from tisfm.scenes import static_scene
    >>> scene = static_scene("sideways", 96, 128)
    >>> flow = horn_schunck(scene.frame0, scene.frame1)
    >>> endpoint_error(flow, scene.flow) < 0.5  # px
    True
    """
    settings = check_settings(settings)
    settings = replace(
        settings,
        smoothness=smoothness,
        beta=1,
        stiffness=(1,) * 6,
        image_edges=0,
        brightness=1,
        gradient=0,
        normalization=None,
        data_contrast=None,
    )
    grey0, grey1 = grey_pair(frame0, frame1)

    runtime.start()
    from tisfm.motion.problems import flow_problem, pyramid_of
    from tisfm.solver.coarse_to_fine import coarse_to_fine, resize_to_finest

    pyramid = pyramid_of(grey0, grey1, Camera(), settings)
    problem = flow_problem(settings, Camera().focal, stiffness=(1.0, 1.0))
    quadratic = replace(problem.smoothness, contrast=math.inf)
    problem = replace(problem, smoothness=quadratic)
    solution = coarse_to_fine(pyramid, problem, last=pyramid.last, release=True)
    flow = resize_to_finest(pyramid, solution.unknowns, pyramid.last)
    return np.ascontiguousarray(np.moveaxis(flow, 0, -1))
