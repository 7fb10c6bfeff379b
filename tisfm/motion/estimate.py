"""The estimate of a pair: its fields, its status, and how they follow from rigid motions.

ρ̂ is the motion of a pixel as six unknowns, (τ, ω)·f, in px/frame: τ is the translation over depth,
ω the rotation, and f the focal length. D is the inverse depth in px/frame.
"""

from dataclasses import dataclass

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import LaneData, aligned_empty, on_host
from tisfm.kernels.model.readout import rigid_fields
from tisfm.motion.focal_evidence import FocalEvidence
from tisfm.motion.light import LightChange
from tisfm.motion.problems import flow_problem
from tisfm.motion.rigid_depth import RigidSolution
from tisfm.motion.settings import DEPTH
from tisfm.rigid import rigid_twist
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, Solution, data_term_on, minimiser_on, unknowns_on
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import History, Status
from tisfm.visibility.confidence import median


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The result of a motion model for a pair, before occlusion and confidence."""

    rho: np.ndarray  # (6, H, W) float32: ρ̂, px/frame
    flow: np.ndarray  # (2, H, W) float32: (u, v), px/frame
    inverse_depth: np.ndarray  # (H, W) float32
    # (7, h, w) float32: precision and residual of the data, and covariance of the flow given its
    # neighbours, as in `tisfm.kernels.solve.data_precision`, on the last level
    precision: np.ndarray
    level: int  # level of the pyramid whose frames decide which pixels are occluded
    is_normalized: bool  # whether the residual in `precision` is in squared px, not grey levels
    freedom: int  # {1, 2}: degrees of freedom of a pixel's flow
    history: Records  # list of (level, warp, Iteration)
    status: Status  # ``"converged"`` or ``"iteration_limit"``, or why no estimate was possible
    motions: np.ndarray | None = None  # (K, 6) float64 or None: twists (T, ω) of K rigid motions
    labels: np.ndarray | None = None  # (H, W) int32 or None: index of each pixel's motion
    inverse_depth_std: np.ndarray | None = None  # (H, W) float32 or None
    # factor in `inverse_depth_std` for errors of the flow that many pixels have in common
    deviation_factor: float = 1.0
    # whether the first motion came from matched points, as for frames far apart
    uses_matches: bool = False
    # (h, w, 2) float32 or None: flow field that gave the first rigid motion, px of its level; None
    # for an estimate without depth
    start_flow: np.ndarray | None = None
    start_level: int = 0  # level of `start_flow`
    light: tuple[LightChange, ...] = ()  # changes of light that were undone in the pyramid
    # what the first flow field or the matches say about the focal length; None if a pose is known
    focal_evidence: FocalEvidence | None = None
    # (h, w) bool or None: pixels that are fixed on the sensor, of a level; the estimate is then
    # incomplete, and has to be made again without these pixels
    fixed_pixels: np.ndarray | None = None


def no_motion_status(solution: Solution, *, is_textured: bool = True) -> Status | None:
    """Return the status of frames that show no motion, None if they show motion."""
    if not is_textured or not _has_nonzero(solution.system.tensor, 3):
        return Status(
            "no_texture",
            "frame 0 is uniform, so no motion can be seen: check that the frames are images of a "
            "textured scene",
        )
    if not _has_nonzero(solution.unknowns.rho, solution.unknowns.components):
        return Status(
            "no_motion",
            "the frames are equal or differ too little, so no motion is visible: take frames "
            "farther apart in time",
        )
    return None


def _has_nonzero(array: LaneData, components: int) -> bool:
    """Return whether the first components of a lane array have a value other than zero."""
    return any(component.any() for component in on_host(array)[:components])


def iteration_status(
    history: Records, converged: bool, settings: Settings, *, is_limit_adjustable: bool = True
) -> Status:
    """Return the status of the last iterations.

    `is_limit_adjustable` says whether the settings can raise the number of iterations.
    """
    last = history[-1][2]
    if not converged and not is_limit_adjustable:
        return Status(
            "iteration_limit",
            f"depth still changed by {last.change:.1e} of its norm in the last iteration "
            f"(tolerance {settings.tolerance:g}): accept a higher tolerance",
        )
    if settings.pyramid_levels == 1:  # the estimated distance from the minimum ended the iterations
        return _remaining_error_status(converged, settings)
    if not converged:
        option = "cycles" if settings.cycles else "sweeps"
        return Status(
            "iteration_limit",
            f"the unknowns still changed by {last.change:.1e} of their norm in the last of "
            f"{settings.outer_iterations} iterations (tolerance {settings.tolerance:g}): raise "
            f"outer_iterations or {option}, or accept a higher tolerance",
        )
    return Status(
        "converged",
        f"the unknowns changed by {last.change:.1e} of their norm in the last iteration",
    )


def _remaining_error_status(converged: bool, settings: Settings) -> Status:
    """Return the status of iterations that end near the minimum, by the estimated distance."""
    if converged:
        return Status(
            "converged",
            "the estimated distance of the unknowns from the minimum is at most "
            f"{settings.tolerance:g} of their norm",
        )
    faster_advice = "" if settings.cycles else ", set cycles to 1, which takes far fewer iterations"
    return Status(
        "iteration_limit",
        f"after {settings.outer_iterations} iterations the estimated distance of the unknowns from "
        f"the minimum was still above {settings.tolerance:g} of their norm (the tolerance): raise "
        f"outer_iterations{faster_advice}, or accept a higher tolerance",
    )


def history_of(records: Records) -> History:
    """Return records of iterations as arrays."""
    levels, warps, iterations = zip(*records, strict=True) if records else ((), (), ())
    return History(
        level=np.array(levels, np.int32),
        warp=np.array(warps, np.int32),
        **{
            name: np.array([getattr(iteration, name) for iteration in iterations])
            for name in ("energy", "half_quadratic", "change")
        },
    )


def make_estimate(
    solution: RigidSolution,
    labels: np.ndarray,  # (H, W) int32: index of each pixel's motion
    camera: Camera,
    settings: Settings,
    *,
    unit: float | None = None,  # ‖t‖ of a given motion; depth then has its unit
    depthless_label: int | None = None,  # the label whose parallax is too small to return its depth
    # px: robust standard deviation of the flow field from the nearest flow that the motion allows
    # at any depth. If it is larger than noise, many pixels have errors in common. One factor
    # enlarges the deviations of all pixels, so that the median deviation includes these errors.
    flow_residual: float = 0.0,
) -> Estimate:
    """Return the estimate of rigid motions with depth; ‖T‖ = 1 is the unit of depth."""
    twists = np.empty((len(solution.motions), 6))
    twist_units = np.empty(len(twists), np.float32)  # (inverse depth for ‖T‖ = 1) / D
    output_units = np.empty(len(twists), np.float32)  # (returned inverse depth) / D
    for label, motion in enumerate(solution.motions):
        length = float(np.linalg.norm(motion[:, 3]))
        if length == 0:
            twists[label] = rigid_twist(motion[:, :3], np.zeros(3))
            twist_units[label] = output_units[label] = 0
            continue
        twist = rigid_twist(motion[:, :3], motion[:, 3] / length)
        # length of the twist's translation T if the pose's translation t has length 1
        speed = float(np.linalg.norm(twist[:3]))
        twists[label] = [*(twist[:3] / speed), *twist[3:]]
        twist_units[label] = length * speed / camera.focal
        output_units[label] = twist_units[label] if unit is None else length / camera.focal / unit
    if depthless_label is not None:
        twist_units[depthless_label] = output_units[depthless_label] = 0
    factor = output_units[labels] if len(output_units) > 1 else output_units[0]
    deviation = solution.deviation()
    enlargement = deviation_factor(deviation, flow_residual)
    deviation *= factor * np.float32(enlargement)
    np.copyto(deviation, np.inf, where=factor == 0)
    flow, rho = _fields(
        solution.inverse_depth, labels, solution.motions, twists, twist_units, camera
    )
    return Estimate(
        rho=rho,
        flow=flow,
        inverse_depth=solution.inverse_depth * factor,
        inverse_depth_std=deviation,
        deviation_factor=enlargement,
        precision=solution.precision,
        level=solution.level,
        is_normalized=settings.depth_normalization is not None,
        freedom=1,
        history=solution.history,
        status=iteration_status(
            solution.history,
            solution.converged,
            settings,
            is_limit_adjustable=solution.is_limit_adjustable,
        ),
        motions=twists,
        labels=labels,
    )


def deviation_factor(deviation: np.ndarray, flow_residual: float) -> float:
    """Return the factor of deviations of D, (H, W) px, for the errors of a flow residual, px."""
    if flow_residual <= DEPTH.max_noise_residual:
        return 1.0
    excess = (flow_residual**2 - DEPTH.max_noise_residual**2) ** 0.5
    return float(np.hypot(1, DEPTH.excess_residual_factor * excess / median(deviation.ravel())))


def make_depthless_estimate(
    pyramid: ImagePyramid,
    settings: Settings,
    *,
    level: int,
    rotation: np.ndarray,  # (3, 3)
    translation: np.ndarray,  # (3,)
    status: Status,
    history: Records,
) -> Estimate:
    """Return an estimate without depth, with the flow of a rotation; the translation is stored."""
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
        is_normalized=settings.normalization is not None,
        freedom=2,
        history=history,
        status=status,
        motions=twists,
        labels=labels,
    )


def _fields(
    inverse_depth: np.ndarray,  # (H, W): D
    labels: np.ndarray,  # (H, W)
    motions: np.ndarray,  # (K, 3, 4)
    twists: np.ndarray,  # (K, 6)
    twist_units: np.ndarray,  # (K,)
    camera: Camera,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the flow of motions, (2, H, W), and the ρ̂ of their twists, (6, H, W).

    `twist_units` converts each motion's inverse depth to that of its twist.
    """
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    flow, rho = (aligned_empty((n, height, width)) for n in (2, 6))
    scaled_twists = camera.focal * twists
    scaled_twists[:, :3] *= twist_units[:, None]
    rigid_fields(
        inverse_depth,
        labels,
        ((np.arange(width) - cx) / camera.focal).astype(np.float32),
        ((np.arange(height) - cy) / camera.focal).astype(np.float32),
        flow,
        rho,
        motions=motions,
        twists=scaled_twists,
        focal=camera.focal,
        by_pixel=runtime.runs_on_gpu(),  # a thread for each pixel
    )
    return flow, rho
