"""The estimate of a pair from rigid motions and depth: twists, flow, inverse depth, ρ̂."""

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.kernels.model.readout import rigid_fields
from tisfm.motion.estimate import Estimate, ended
from tisfm.motion.problems import flow_problem
from tisfm.motion.rigid_depth import RigidSolution
from tisfm.rigid import rigid_twist
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, data_term_on, minimiser_on, unknowns_on
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import median

# px: misfit of flow fields of rendered scenes, which comes from noise alone. A larger misfit is an
# error of lens, shutter or pose. And error of D for each px of that excess.
FITTING, MISFIT = 0.016, 1.5


def with_depth(
    solution: RigidSolution,
    labels: np.ndarray,  # (H, W) int32: index of each pixel's motion
    camera: Camera,
    settings: Settings,
    *,
    unit: float | None = None,  # ‖t‖ of a given motion; depth is then in its unit
    unseen: int | None = None,  # the label whose parallax is too small to return its depth
    # Robust deviation of a flow field from the points that the motion allows, px. It shows errors
    # that pixels share, so all deviations are multiplied by one factor that adds these errors to
    # the median deviation.
    misfit: float = 0.0,
) -> Estimate:
    """Return the estimate of a solution, with ‖T‖ = 1 and depth in that unit."""
    twists = np.empty((len(solution.motions), 6))
    for_twist = np.empty(len(twists), np.float32)  # d / D, for ‖T‖ = 1
    for_output = np.empty(len(twists), np.float32)
    for label, motion in enumerate(solution.motions):
        length = float(np.linalg.norm(motion[:, 3]))
        if length == 0:
            twists[label] = rigid_twist(motion[:, :3], np.zeros(3))
            for_twist[label] = for_output[label] = 0
            continue
        twist = rigid_twist(motion[:, :3], motion[:, 3] / length)
        speed = float(np.linalg.norm(twist[:3]))  # ‖T‖ for ‖t‖ = 1
        twists[label] = [*(twist[:3] / speed), *twist[3:]]
        for_twist[label] = length * speed / camera.focal
        for_output[label] = for_twist[label] if unit is None else length / camera.focal / unit
    if unseen is not None:
        for_twist[unseen] = for_output[unseen] = 0
    factor = for_output[labels] if len(for_output) > 1 else for_output[0]
    deviation = solution.deviation()
    widening = _widening(deviation, misfit)
    deviation *= factor * np.float32(widening)
    np.copyto(deviation, np.inf, where=factor == 0)
    flow, rho = _fields(solution.inverse_depth, labels, solution.motions, twists, for_twist, camera)
    return Estimate(
        rho=rho,
        flow=flow,
        inverse_depth=solution.inverse_depth * factor,
        inverse_depth_std=deviation,
        widening=widening,
        precision=solution.precision,
        level=solution.level,
        normalized=settings.depth_normalization is not None,
        freedom=1,
        history=solution.history,
        status=ended(
            solution.history, solution.converged, settings, adjustable=solution.adjustable
        ),
        motions=twists,
        labels=labels,
    )


def _widening(deviation: np.ndarray, misfit: float) -> float:
    """Return the factor of deviations of D, (H, W) px, for a misfit."""
    if misfit <= FITTING:
        return 1.0
    beyond = (misfit**2 - FITTING**2) ** 0.5
    return float(np.hypot(1, MISFIT * beyond / median(deviation.ravel())))


def without_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    *,
    level: int,
    rotation: np.ndarray,
    translation: np.ndarray,
    status: Status,
    history: Records,
) -> Estimate:
    """Return an estimate without depth, with the flow of a rotation; translation is only stored."""
    height, width = pyramid.shape
    camera = pyramid.cameras[0]
    problem = flow_problem(settings, camera.focal, stiffness=(1.0, 1.0))  # for (u, v)
    unknowns = unknowns_on(pyramid, 0, problem)
    data_term = data_term_on(pyramid, 0, problem, unknowns)
    minimiser = minimiser_on(problem, unknowns, data_term)
    twists = rigid_twist(rotation, translation)[None]
    if twists[0, :3].any():
        twists[0, :3] /= np.linalg.norm(twists[0, :3])
    nothing, labels = np.zeros((height, width), np.float32), np.zeros((height, width), np.int32)
    motion = np.column_stack([rotation, np.zeros(3)])
    flow, rho = _fields(nothing, labels, motion[None], twists, np.zeros(1), camera)
    unknowns.set_images(flow)
    data_term.bind_linearise(unknowns.rho)()
    minimiser.update()
    return Estimate(
        rho=rho,
        flow=flow,
        inverse_depth=nothing,
        inverse_depth_std=np.full_like(nothing, np.inf),
        precision=unknowns.precision(minimiser.system),
        level=level,
        normalized=settings.normalization is not None,
        freedom=2,
        history=history,
        status=status,
        motions=twists,
        labels=labels,
    )


def _fields(
    inverse_depth: np.ndarray,
    labels: np.ndarray,
    motions: np.ndarray,
    twists: np.ndarray,
    for_twist: np.ndarray,
    camera: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the flow of motions, (2, H, W), and the ρ̂ of their twists, (6, H, W).

    `for_twist` converts each motion's inverse depth to that of its twist.
    """
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    flow, rho = (aligned_empty((n, height, width)) for n in (2, 6))
    scaled = camera.focal * twists
    scaled[:, :3] *= for_twist[:, None]
    rigid_fields(
        inverse_depth,
        labels,
        ((np.arange(width) - cx) / camera.focal).astype(np.float32),
        ((np.arange(height) - cy) / camera.focal).astype(np.float32),
        flow,
        rho,
        motions=motions,
        twists=scaled,
        focal=camera.focal,
        by_pixel=runtime.on_gpu(),
    )
    return flow, rho
