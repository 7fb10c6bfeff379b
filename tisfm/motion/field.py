"""A motion ρ̂ of its own for every pixel, as in the paper: ``motion="field"``."""

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.kernels.model.readout import motion_fields
from tisfm.motion.estimate import Estimate, iteration_status, no_motion_status
from tisfm.motion.flow_proposals import flow_proposals
from tisfm.motion.previous_frame import PreviousFrame
from tisfm.motion.problems import flow_problem
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import coarse_to_fine, resize_to_finest
from tisfm.solver.image_pyramid import ImagePyramid


def field_estimate(
    pyramid: ImagePyramid,  # the splines of its coarse levels are freed after use
    settings: Settings,
    previous: PreviousFrame | None = None,  # data of the previous frame
) -> Estimate:
    """Estimate a ρ̂ of its own for every pixel."""
    camera = pyramid.cameras[0]
    problem = flow_problem(settings, camera.focal)
    solution = coarse_to_fine(
        pyramid,
        problem,
        last=pyramid.last,
        release=True,
        level_change=flow_proposals(pyramid, problem),
        additional_data=previous,
    )
    unknowns, history = solution.unknowns, solution.history
    precision = unknowns.precision(solution.system)
    status = no_motion_status(solution, is_textured=pyramid.contrast > 0) or iteration_status(
        history, solution.converged, settings
    )
    del solution  # frees most of the memory
    rho = resize_to_finest(pyramid, unknowns, pyramid.last)
    if status == "no_texture":  # the flow of a uniform frame 0 is from gradients of frame 1 alone
        rho[...] = 0
    flow, inverse_depth = _read_out(rho, camera)
    if len(rho) < 6:
        rho = np.concatenate([rho, np.zeros((6 - len(rho), *rho.shape[1:]), np.float32)])
    return Estimate(
        rho=rho,
        flow=flow,
        inverse_depth=inverse_depth,
        precision=precision,
        level=pyramid.last,
        is_normalized=settings.normalization is not None,
        freedom=2,
        history=history,
        status=status,
    )


def _read_out(rho: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return flow, (2, H, W), and inverse depth, (H, W), of ρ̂ on the finest level."""
    height, width = rho.shape[1:]
    cx, cy = camera.center_for(height, width)
    x_hat = ((np.arange(width) - cx) / camera.focal).astype(np.float32)
    y_hat = ((np.arange(height) - cy) / camera.focal).astype(np.float32)
    flow, inverse_depth = (aligned_empty((*n, height, width)) for n in ((2,), ()))
    motion_fields(
        rho, x_hat, y_hat, flow, inverse_depth, focal=camera.focal, by_pixel=runtime.runs_on_gpu()
    )
    return flow, inverse_depth
