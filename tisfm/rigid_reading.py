"""What rigid motions and depth leave of a pair: twists, inverse depth, ρ̂."""

import numpy as np

from tisfm.camera import Camera
from tisfm.interpretation import Status
from tisfm.pyramid import Iteration, Pyramid
from tisfm.reading import Reading, ended
from tisfm.rigid import rigid_twist
from tisfm.rigid_depth import RigidSolution
from tisfm.settings import Settings


def with_depth(
    solution: RigidSolution,
    labels: np.ndarray,
    camera: Camera,
    settings: Settings,
    *,
    unit: float | None = None,
    unseen: int | None = None,
) -> Reading:
    """Bring a solution to ‖T‖ = 1 and depth in that unit.

    Parameters
    ----------
    solution : RigidSolution
    labels : (H, W) int32
        Which of its motions a pixel has.
    camera : Camera
    settings : Settings
    unit : float, optional
        ‖t‖ of a given motion, in whose unit depth then is.
    unseen : int, optional
        The label whose parallax is too little to return its depth.
    """
    twists = np.empty((len(solution.motions), 6))
    for_twist = np.empty(len(twists), np.float32)  # d over D, for ‖T‖ = 1
    for_output = np.empty(len(twists), np.float32)
    for label, motion in enumerate(solution.motions):
        length = float(np.linalg.norm(motion[:, 3]))
        if length == 0:
            twists[label] = rigid_twist(motion[:, :3], np.zeros(3))
            for_twist[label] = for_output[label] = 0
            continue
        twist = rigid_twist(motion[:, :3], motion[:, 3] / length)
        speed = float(np.linalg.norm(twist[:3]))  # ‖T‖ of ‖t‖ = 1
        twists[label] = [*(twist[:3] / speed), *twist[3:]]
        for_twist[label] = length * speed / camera.focal
        for_output[label] = for_twist[label] if unit is None else length / camera.focal / unit
    if unseen is not None:
        for_twist[unseen] = for_output[unseen] = 0
    evidence = solution.minimiser.evidence()
    factor = for_output[labels]
    deviation = solution.deviation(evidence) * factor
    deviation[factor == 0] = np.inf
    return Reading(
        rho=rho_of(
            solution.inverse_depth * for_twist[labels], solution.flow, twists, labels, camera
        ),
        flow=solution.flow,
        inverse_depth=solution.inverse_depth * factor,
        inverse_depth_std=deviation,
        evidence=evidence,
        normalized=settings.depth_normalization is not None,
        freedom=1,
        history=solution.history,
        status=ended(solution.history, solution.converged, settings),
        motions=twists,
        labels=labels,
    )


def without_depth(
    pyramid: Pyramid,
    camera: Camera,
    settings: Settings,
    *,
    rotation: np.ndarray,
    translation: np.ndarray,
    status: Status,
    history: list[tuple[int, int, Iteration]],
) -> Reading:
    """Return the flow of a rotation, without depth; the translation is only reported."""
    height, width = pyramid.frames0[0].shape
    field = pyramid.field(0, 2, None)
    data_term = pyramid.data_term(
        0,
        field.grid,
        brightness=settings.brightness,
        gradient=settings.gradient,
        normalization=settings.normalization,
    )
    minimiser = pyramid.minimiser(
        field,
        data_term,
        settings,
        alpha=settings.alpha,
        contrast=settings.contrast_for(camera.focal),
        stiffness=(1.0, 1.0),
    )
    flow = rotation_flow(rotation, camera, height, width)
    field.set_images(flow)
    minimiser.renew(data_term.linearise(field.flow(field.grid.allocate(2))))
    twists = rigid_twist(rotation, translation)[None]
    if twists[0, :3].any():
        twists[0, :3] /= np.linalg.norm(twists[0, :3])
    nothing, labels = np.zeros((height, width), np.float32), np.zeros((height, width), np.int32)
    return Reading(
        rho=rho_of(nothing, flow, twists, labels, camera),
        flow=flow,
        inverse_depth=nothing,
        inverse_depth_std=np.full_like(nothing, np.inf),
        evidence=minimiser.evidence(),
        normalized=settings.normalization is not None,
        freedom=2,
        history=history,
        status=status,
        motions=twists,
        labels=labels,
    )


def rotation_flow(rotation: np.ndarray, camera: Camera, height: int, width: int) -> np.ndarray:
    """Return the flow of a rotation, (2, H, W) float32, px/frame; exactly 0 for none."""
    cx, cy = camera.center_for(height, width)
    x = (np.arange(width) - cx) / camera.focal
    y = (np.arange(height)[:, None] - cy) / camera.focal
    # Of (R − 1) x̂, so that no rotation gives exactly none.
    turn = rotation - np.eye(3)
    p1, p2, p3 = (row[0] * x + row[1] * y + row[2] for row in turn)
    flow = np.stack([p1 - x * p3, p2 - y * p3]) * (camera.focal / (1 + p3))
    return flow.astype(np.float32)


def rho_of(
    inverse_depth: np.ndarray,
    flow: np.ndarray,
    twists: np.ndarray,
    labels: np.ndarray,
    camera: Camera,
) -> np.ndarray:
    """Return the ρ̂ of twists and inverse depth, (6, H, W), corrected to give exactly a flow.

    To first order ρ̂ = f·(d T, ω). What the finite displacement has beyond Gρ̂ is added to its
    first two components, which move a pixel right and down.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        For the lengths of T.
    flow : (2, H, W) float32
    twists : (K, 6) float64
    labels : (H, W) int32
    camera : Camera
    """
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    x = ((np.arange(width) - cx) / camera.focal).astype(np.float32)
    y = ((np.arange(height)[:, None] - cy) / camera.focal).astype(np.float32)
    rho = np.empty((6, height, width), np.float32)
    for k, component in enumerate((camera.focal * twists.T).astype(np.float32)):
        rho[k] = component[labels] if len(component) > 1 else component[0]
    rho[:3] *= inverse_depth
    # (u, v) = G ρ̂ for the components 3 to 6; the first two take the rest.
    _, _, t3, w1, w2, w3 = rho
    rho[0] = flow[0] - (-x * t3 - x * y * w1 + (1 + x * x) * w2 - y * w3)
    rho[1] = flow[1] - (-y * t3 - (1 + y * y) * w1 + x * y * w2 + x * w3)
    return rho
