"""The estimate of a pair from rigid motions and depth: twists, flow, inverse depth, ρ̂."""

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.kernels.model.readout import rigid_fields
from tisfm.motion.estimate import Estimate, iteration_status
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
    hidden_label: int | None = None,  # the label whose parallax is too small to return its depth
    # Robust deviation of a flow field from the points that the motion allows, px. It shows errors
    # that pixels share, so all deviations are multiplied by one factor that adds these errors to
    # the median deviation.
    misfit: float = 0.0,
) -> Estimate:
    """Return the estimate of a solution, with ‖T‖ = 1 and depth in that unit."""
    twists = np.empty((len(solution.motions), 6))
    twist_units = np.empty(len(twists), np.float32)  # d / D, for ‖T‖ = 1
    output_units = np.empty(len(twists), np.float32)
    for label, motion in enumerate(solution.motions):
        length = float(np.linalg.norm(motion[:, 3]))
        if length == 0:
            twists[label] = rigid_twist(motion[:, :3], np.zeros(3))
            twist_units[label] = output_units[label] = 0
            continue
        twist = rigid_twist(motion[:, :3], motion[:, 3] / length)
        speed = float(np.linalg.norm(twist[:3]))  # ‖T‖ for ‖t‖ = 1
        twists[label] = [*(twist[:3] / speed), *twist[3:]]
        twist_units[label] = length * speed / camera.focal
        output_units[label] = twist_units[label] if unit is None else length / camera.focal / unit
    if hidden_label is not None:
        twist_units[hidden_label] = output_units[hidden_label] = 0
    factor = output_units[labels] if len(output_units) > 1 else output_units[0]
    deviation = solution.deviation()
    deviation_factor = _deviation_factor(deviation, misfit)
    deviation *= factor * np.float32(deviation_factor)
    np.copyto(deviation, np.inf, where=factor == 0)
    flow, rho = _fields(
        solution.inverse_depth, labels, solution.motions, twists, twist_units, camera
    )
    return Estimate(
        rho=rho,
        flow=flow,
        inverse_depth=solution.inverse_depth * factor,
        inverse_depth_std=deviation,
        deviation_factor=deviation_factor,
        precision=solution.precision,
        level=solution.level,
        normalized=settings.depth_normalization is not None,
        freedom=1,
        history=solution.history,
        status=iteration_status(
            solution.history, solution.converged, settings, is_adjustable=solution.is_adjustable
        ),
        motions=twists,
        labels=labels,
    )


def _deviation_factor(deviation: np.ndarray, misfit: float) -> float:
    """Return the factor of deviations of D, (H, W) px, for a misfit."""
    if misfit <= FITTING:
        return 1.0
    excess = (misfit**2 - FITTING**2) ** 0.5
    return float(np.hypot(1, MISFIT * excess / median(deviation.ravel())))


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
    zeros, labels = np.zeros((height, width), np.float32), np.zeros((height, width), np.int32)
    motion = np.column_stack([rotation, np.zeros(3)])
    flow, rho = _fields(zeros, labels, motion[None], twists, np.zeros(1), camera)
    unknowns.set_images(flow)
    data_term.bind_linearise(unknowns.rho)()
    minimiser.update()
    return Estimate(
        rho=rho,
        flow=flow,
        inverse_depth=zeros,
        inverse_depth_std=np.full_like(zeros, np.inf),
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
    twist_units: np.ndarray,
    camera: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the flow of motions, (2, H, W), and the ρ̂ of their twists, (6, H, W).

    `twist_units` converts each motion's inverse depth to that of its twist.
    """
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    flow, rho = (aligned_empty((n, height, width)) for n in (2, 6))
    scaled = camera.focal * twists
    scaled[:, :3] *= twist_units[:, None]
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
