"""One rigid motion of the camera, and inverse depth at every pixel: ``motion="camera"``."""

from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.confidence import confidence
from tisfm.egomotion import CameraMotion, camera_motion
from tisfm.interpretation import Status
from tisfm.occlusion import leaves_image
from tisfm.pyramid import Iteration, Pyramid, coarse_to_fine
from tisfm.reading import Reading, ended, unmoved
from tisfm.rigid import KnownPose, rigid_twist
from tisfm.rigid_depth import RigidSolution, rigid_depth
from tisfm.settings import Settings

START = 0.5  # sampling density of the flow field that the camera's motion is first found from
# Of the parallax over the residual of the fit. Where the camera only turned, noise alone leaves 2.
# On hand-held sequences depth below the other two was hardly better than a constant: less than a
# pixel of parallax drowns in what lens and shutter do, which the residual does not show.
SEEN, ENOUGH, ENOUGH_BELOW_A_PIXEL = 2.5, 6.0, 9.0
FINEST = 0.005  # px of the level: no flow is better than that
STILL = 0.1  # px: median flow of a camera that stands still


def camera_reading(
    pyramid: Pyramid, camera: Camera, settings: Settings, pose: KnownPose | None
) -> Reading:
    """Find one rigid motion and the inverse depth of every pixel, both from the images directly.

    A flow field of half the resolution gives a first motion (`tisfm.egomotion`). Depth and motion
    then are estimated jointly, coarse to fine (`tisfm.rigid_depth`).

    Parameters
    ----------
    pyramid : Pyramid
    camera : Camera
        A pinhole, of the finest level.
    settings : Settings
    pose : KnownPose or None
        What is known of the motion.
    """
    shape = pyramid.frames0[0].shape
    labels = np.zeros(shape, np.int32)
    if pose is not None and pose.translation is not None:
        if not pose.translation.any():
            return _without_depth(
                pyramid,
                camera,
                settings,
                rotation=pose.rotation,
                status=Status(
                    "pure_rotation",
                    "the pose given has no translation, so there is no parallax to see depth by",
                ),
            )
        matrix = np.column_stack([pose.rotation, pose.translation])
        solution = rigid_depth(pyramid, settings, camera, matrix[None], labels, refine="none")
        unit = float(np.linalg.norm(pose.translation))
        return _with_depth(solution, camera, settings, unit=unit)

    start = _start(pyramid, camera, settings, None if pose is None else pose.rotation)
    if start.status is not None:
        return _without_depth(
            pyramid, camera, settings, rotation=start.rotation, status=start.status, start=start
        )
    matrix = np.column_stack([start.rotation, start.translation])
    solution = rigid_depth(
        pyramid,
        settings,
        camera,
        matrix[None],
        labels,
        refine="motion" if pose is None else "translation",
    )
    return _with_depth(solution, camera, settings, unit=1.0)


@dataclass(frozen=True, kw_only=True)
class _Start:
    """The motion that a flow field shows, and why there is no depth to go on to, if so."""

    rotation: np.ndarray
    translation: np.ndarray
    history: list[tuple[int, int, Iteration]]
    status: Status | None


def _start(
    pyramid: Pyramid, camera: Camera, settings: Settings, rotation: np.ndarray | None
) -> _Start:
    """Fit a motion to the flow field of a coarser level."""
    levels = range(pyramid.levels)
    level = next((k for k in levels if pyramid.scale(k) <= START), levels[-1])
    solution = coarse_to_fine(
        pyramid,
        settings,
        components=settings.components,
        contrast=settings.contrast_for(camera.focal),
        finest=level,
    )
    still = _Start(
        rotation=np.eye(3) if rotation is None else rotation,
        translation=np.zeros(3),
        history=solution.history,
        status=unmoved(solution, textured=pyramid.contrast > 0),
    )
    if still.status is not None:
        return still
    field = solution.field
    flow = field.to_images(field.flow(field.grid.allocate(2)))
    with np.errstate(over="ignore", invalid="ignore"):  # where the field diverged
        trust = confidence(solution.minimiser.evidence(solution.terms), leaves_image(flow))
    flow = np.moveaxis(flow, 0, -1)
    scale = pyramid.scale(level)
    coarse = camera.scaled(scale, *pyramid.frames0[0].shape)
    try:
        found = camera_motion(flow, trust, coarse, rotation=rotation)
    except ValueError as error:
        message = f"{error}: take sharper frames of more texture"
        return replace(still, status=Status("no_texture", message))
    status = _parallax_status(found, scale, float(np.median(np.linalg.norm(flow, axis=-1))) / scale)
    if status == "no_motion":
        return replace(still, status=status)
    if status == "pure_rotation":
        return replace(still, status=status, rotation=found.rotation_alone)
    return replace(still, status=status, rotation=found.rotation, translation=found.translation)


def _parallax_status(found: CameraMotion, scale: float, moved: float) -> Status | None:
    """Tell whether the flow shows more than a rotation; lengths of `found` are of a level."""
    parallax, residual = found.parallax / scale, max(found.residual, FINEST) / scale
    share = parallax / residual
    if share >= (ENOUGH if parallax >= 1 else ENOUGH_BELOW_A_PIXEL):
        return None
    seen = f"what rotation leaves of the motion is {parallax:.2g} px, noise {residual:.2g} px"
    if share >= SEEN:
        return Status(
            "little_parallax",
            f"too little parallax to see depth by: {seen}; take frames further apart, or move the "
            "camera sideways",
        )
    if moved < max(STILL, 3 * residual):
        return Status(
            "no_motion",
            f"too little parallax to see depth by: the image moves by {moved:.2g} px, no more than "
            "noise; take frames further apart in time",
        )
    return Status(
        "pure_rotation",
        f"too little parallax to see depth by: the camera only turned, {seen}; it has to change "
        "its place",
    )


def _with_depth(
    solution: RigidSolution, camera: Camera, settings: Settings, *, unit: float
) -> Reading:
    """Bring a solution to ‖T‖ = 1 and depth in multiples of ‖T‖/`unit`."""
    (motion,) = solution.motions
    length = float(np.linalg.norm(motion[:, 3]))
    twist = rigid_twist(motion[:, :3], motion[:, 3] / length)
    speed = float(np.linalg.norm(twist[:3]))  # ‖T‖ of ‖t‖ = 1
    twist[:3] /= speed
    # D = f·d for the translation of `length`.
    per_unit = np.float32(length / camera.focal)
    inverse_depth = solution.inverse_depth * per_unit
    rho = rho_of(inverse_depth * np.float32(speed), solution.flow, twist, camera)
    evidence = solution.minimiser.evidence(solution.terms)
    factor = per_unit * np.float32(1 / unit if unit != 1 else speed)
    return Reading(
        rho=rho,
        flow=solution.flow,
        inverse_depth=solution.inverse_depth * factor,
        inverse_depth_std=solution.deviation(evidence) * factor,
        evidence=evidence,
        freedom=1,
        history=solution.history,
        status=ended(solution.history, solution.converged, settings),
        motions=twist[None],
        labels=np.zeros(inverse_depth.shape, np.int32),
    )


def _without_depth(
    pyramid: Pyramid,
    camera: Camera,
    settings: Settings,
    *,
    rotation: np.ndarray,
    status: Status,
    start: _Start | None = None,
) -> Reading:
    """Return the flow of a rotation, without depth."""
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
        alpha=settings.alpha,
        contrast=settings.contrast_for(camera.focal),
        stiffness=(1.0, 1.0),
    )
    flow = rotation_flow(rotation, camera, height, width)
    field.set_images(flow)
    translation = np.zeros(3) if start is None else start.translation
    twist = rigid_twist(rotation, translation)
    if twist[:3].any():
        twist[:3] /= np.linalg.norm(twist[:3])
    nothing = np.zeros((height, width), np.float32)
    return Reading(
        rho=rho_of(nothing, flow, twist, camera),
        flow=flow,
        inverse_depth=nothing,
        inverse_depth_std=np.full_like(nothing, np.inf),
        evidence=minimiser.evidence(data_term.linearise(field.flow(field.grid.allocate(2)))),
        freedom=2,
        history=[] if start is None else start.history,
        status=status,
        motions=twist[None],
        labels=np.zeros((height, width), np.int32),
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
    inverse_depth: np.ndarray, flow: np.ndarray, twist: np.ndarray, camera: Camera
) -> np.ndarray:
    """Return the ρ̂ of a twist and inverse depth, (6, H, W), corrected to give exactly a flow.

    To first order ρ̂ = f·(d T, ω). What the finite displacement has beyond Gρ̂ is added to its
    first two components, which move a pixel right and down.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        For the length of T.
    flow : (2, H, W) float32
    twist : (6,) float64
    camera : Camera
    """
    height, width = inverse_depth.shape
    cx, cy = camera.center_for(height, width)
    x = ((np.arange(width) - cx) / camera.focal).astype(np.float32)
    y = ((np.arange(height)[:, None] - cy) / camera.focal).astype(np.float32)
    t1, t2, t3, w1, w2, w3 = (np.float32(camera.focal * component) for component in twist)
    rho = np.empty((6, height, width), np.float32)
    for k, component in enumerate((t1, t2, t3)):
        np.multiply(inverse_depth, component, out=rho[k])
    for k, component in enumerate((w1, w2, w3)):
        rho[3 + k] = component
    # (u, v) = G ρ̂ for the components 3 to 6; the first two take the rest.
    rho[0] = flow[0] - (-x * rho[2] - x * y * w1 + (1 + x * x) * w2 - y * w3)
    rho[1] = flow[1] - (-y * rho[2] - (1 + y * y) * w1 + x * y * w2 + x * w3)
    return rho
