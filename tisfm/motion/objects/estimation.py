"""Several rigid motions, a label per pixel, and depth of every object: ``motion="objects"``."""

from dataclasses import replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.camera import first_motion_estimate
from tisfm.motion.estimate import Estimate, make_estimate
from tisfm.motion.first_motion import FirstMotion, first_motion, motion_from_matches
from tisfm.motion.objects.boundaries import sharpen_labels
from tisfm.motion.objects.candidates import motion_candidates, smallest_object
from tisfm.motion.objects.depth import align_scales, carry_background_depth, restore_diverged_depth
from tisfm.motion.objects.layers import Layering, Layers, remove_specks
from tisfm.motion.objects.settings import OBJECTS
from tisfm.motion.problems import pyramid_of
from tisfm.motion.rigid_depth import RigidSolution
from tisfm.motion.settings import EGOMOTION
from tisfm.motion.sparse_start import sparse_start
from tisfm.settings import MAX_SMOOTHNESS, Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.occlusion import leaves_image, pyramid_occlusion


def objects_estimate(
    pyramid: ImagePyramid,
    settings: Settings,
    # grey0, grey1: (H, W) float32, grey levels of the frames on the 8-bit scale
    grey0: np.ndarray,
    grey1: np.ndarray,
) -> Estimate:
    """Find rigid motions, a label for each pixel, and inverse depth in the unit of each motion.

    The largest motion, the background's, is fitted to the flow field. If frames are too far apart
    for a flow field, the rotation of frame 1 is undone first (`wide_baseline_motion`). Other
    motions are fitted to the unexplained flow (`candidates`). The images decide which motions are
    needed and where their boundaries lie (`layers`). Parts that would float at rest are added
    (`floating_parts`), and boundaries are made sharp (`boundaries`). Then depth and motions are
    estimated jointly, as for one motion (`tisfm.motion.rigid_depth`), and diverged labels and
    pixels are restored (`restore_diverged_depth`). If much of the frame has no texture, depth of
    the background is carried across (`carry_background_depth`).
    """
    # A wrong label is worse than wrong depth, so flow and surfaces get more iterations.
    settings = replace(
        settings,
        finest_level=0,
        warps=max(settings.warps, 2),
        outer_iterations=max(settings.outer_iterations, 10),
        sweeps=max(settings.sweeps, 8),
    )
    camera = pyramid.cameras[0]
    start = first_motion(pyramid, settings, min_pixels=OBJECTS.min_pixels)
    light = start.light
    is_unclear = start.status == "unrelated" and not start.is_cut
    if is_unclear and start.level > 0:
        start = first_motion(pyramid, settings)
        light += start.light
    for change in light:
        grey1 = change.undo(grey1)
    if is_unclear and start.status == "unrelated":
        start = wide_baseline_motion(pyramid, settings, start, grey0, grey1)
        if start.uses_matches:
            for change in start.light:
                grey1 = change.undo(grey1)
                pyramid.set_frames1([change.undo(frame) for frame in pyramid.frames1])
            light += start.light
    start = replace(start, light=light)
    has_no_flow = start.status in ("no_texture", "unrelated", "aperture")
    if has_no_flow or (start.status == "no_motion" and not start.flow.any()):
        assert start.status is not None
        return first_motion_estimate(pyramid, settings, start, start.status, level=0)
    level = start.level
    layers = _estimate_layers(pyramid, settings, grey0, start)
    motions = layers.motions
    hidden = _resize_labels(layers.hidden, pyramid.shape)
    labels, flows = _sharpen_levels(pyramid, level, layers, grey0, grey1, start.residual)
    if not labels.any() and start.status is not None:
        return first_motion_estimate(pyramid, settings, start, start.status, level=0)
    areas = np.bincount(labels.ravel(), minlength=len(motions))
    order = np.argsort(-areas, kind="stable")[: np.count_nonzero(areas)]
    rank = np.zeros(len(motions), np.int32)
    rank[order] = np.arange(len(order))
    expected_flow = np.take_along_axis(flows, labels[None, None], axis=0)[0]
    labels = rank[labels]
    # Next to objects with reliable depth, rough depth of the background is left out.
    is_rough = start.status is not None or (len(order) > 1 and start.doubt == "uncertain")
    depthless_label = int(rank[0]) if is_rough and areas[0] else None

    def estimate_solution(solution: RigidSolution) -> Estimate:
        return make_estimate(solution, labels, camera, settings, depthless_label=depthless_label)

    solution, estimate = restore_diverged_depth(
        pyramid,
        replace(
            settings,
            depth_smoothness=min(
                OBJECTS.smoothness_factor * settings.depth_smoothness, MAX_SMOOTHNESS
            ),
        ),
        np.stack([motions[k] for k in order]),
        labels,
        expected_flow,
        estimate_solution,
    )
    if depthless_label != 0:
        carried_solution = carry_background_depth(
            pyramid, settings, solution, labels, motions[order[0]]
        )
        estimate = estimate if carried_solution is None else estimate_solution(carried_solution)
    history = start.history + estimate.history
    estimate = replace(
        estimate, history=history, uses_matches=start.uses_matches, light=start.light
    )
    if len(order) == 1 and start.doubt is not None:
        estimate = replace(estimate, status=start.doubt)
    return align_scales(estimate, hidden) if settings.align_scales else estimate


def _estimate_layers(
    pyramid: ImagePyramid, settings: Settings, grey0: np.ndarray, start: FirstMotion
) -> Layers:
    """Return the layers on the level of a flow field: motions and rough labels."""
    coarse_pyramid, scale = pyramid.coarser(start.level), pyramid.scales[start.level]
    frame = coarse_pyramid.frames0[0] if start.level else grey0  # `grey0` is sharper
    hidden = pyramid_occlusion(
        coarse_pyramid, np.ascontiguousarray(np.moveaxis(start.flow, -1, 0)), settings
    )
    motions, labels = motion_candidates(
        start.flow,
        np.where(hidden, 0, start.trust),
        coarse_pyramid.cameras[0],
        frame,
        start.matrix,
        start.residual * scale,
        max_motions=settings.max_objects,
    )
    layering = Layering(coarse_pyramid, settings, frame, density=scale)
    layers = layering.fit(motions, labels, hidden)
    if len(motions) > 1:
        layers = layering.prune(layers)
        motions = layering.refit_motions(layers, start.flow, start.trust)
        layers = layering.prune(layering.fit(motions, layers.labels, layers.hidden))
    return layering.add_floating_parts(layers, max_layers=settings.max_objects)


def _sharpen_levels(
    pyramid: ImagePyramid,
    level: int,
    layers: Layers,
    grey0: np.ndarray,
    grey1: np.ndarray,
    residual: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return labels, (H, W) int32, and the flow of every layer, (K, 2, H, W), on the finest level.

    Boundaries are sharpened level by level. On each level they are wrong by little more than a
    pixel of the previous level.
    """
    labels, flows = layers.labels, layers.flows
    if not layers.motions[0][:, 3].any():
        min_difference = max(EGOMOTION.max_still_flow, 3 * residual) * pyramid.scales[level]
        labels = np.where(_moves_like_background(layers, min_difference), 0, labels)
    for k in range(level, -1, -1):
        shape = pyramid.frames0[k].shape
        if k < level:
            labels = _resize_labels(labels, shape)
            flows = _resize_flows(flows, shape, pyramid.scales[k] / pyramid.scales[k + 1])
        is_allowed = np.stack([_resize_labels(mask, shape) for mask in layers.is_allowed])
        min_size = smallest_object(labels.size)
        frames = (grey0, grey1) if k == 0 else (pyramid.frames0[k], pyramid.frames1[k])
        labels = remove_specks(labels, min_size)
        labels = remove_specks(sharpen_labels(labels, flows, is_allowed, *frames), min_size)
    return labels, flows


def _resize_labels(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return labels or a mask on another level, (h, w), by nearest neighbours."""
    if image.shape == shape:
        return image
    label_image = image.astype(np.uint8)
    return cv2.resize(label_image, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(image.dtype)


def _resize_flows(flows: np.ndarray, shape: tuple[int, ...], ratio: float) -> np.ndarray:
    """Return flows, (K, 2, h, w), on a finer level that is `ratio` times as dense."""
    return np.stack(
        [
            np.stack([cv2.resize(part, shape[::-1]) for part in np.nan_to_num(flow)])
            for flow in flows
        ]
    ) * np.float32(ratio)


def _moves_like_background(layers: Layers, min_difference: float) -> np.ndarray:
    """Return the pixels, (H, W) bool, whose flow is within `min_difference` px of the background's.

    Under a motion with translation, distant points move as under its rotation alone. So a motion
    with translation also explains a background that only rotates, with a wrong depth.
    """
    own_flow = np.take_along_axis(layers.flows, layers.labels[None, None], axis=0)[0]
    return np.linalg.norm(own_flow - layers.flows[0], axis=0) < min_difference


def wide_baseline_motion(
    pyramid: ImagePyramid,
    settings: Settings,
    start: FirstMotion,  # first motion of a flow field alone, on the finest level
    # grey0, grey1: (H, W) float32, grey levels of the frames
    grey0: np.ndarray,
    grey1: np.ndarray,
) -> FirstMotion:
    """Return a first motion and a flow field for frames where a flow field alone fails.

    Matches give the rotation of the camera. Frame 1 is resampled without this rotation. Then it
    differs from frame 0 only by parallax and moving objects, which a flow field shows. The flow of
    pixels outside frame 1 is not trusted. If this flow field fails as well, the result is the
    motion of the matches and its flow. The light of the result is yet to be undone.
    """
    match_start = sparse_start(pyramid, start.level, None)
    if match_start is None:
        return start
    matched_motion = motion_from_matches(start, match_start)
    if matched_motion.status == "unrelated":
        return matched_motion
    camera = pyramid.cameras[0]
    homography = _rotation_homography(matched_motion.rotation, camera, *grey0.shape)
    rotated1 = cv2.warpPerspective(
        grey1,
        homography,
        grey0.shape[::-1],
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    height, width = grey0.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    positions = np.stack([columns, rows], axis=-1)
    leaves = leaves_image(
        np.moveaxis(cv2.perspectiveTransform(positions, homography) - positions, -1, 0)
    )
    hidden = (
        cv2.dilate(
            leaves.astype(np.uint8),
            np.ones((OBJECTS.outside_window, OBJECTS.outside_window), np.uint8),
        )
        > 0
    )
    flow_motion = first_motion(
        pyramid_of(grey0, rotated1, camera, settings, _rotated_valid_pixels(pyramid, homography)),
        settings,
        hidden=hidden,
    )
    if flow_motion.status in ("unrelated", "no_texture", "aperture"):
        return matched_motion
    flow = cv2.perspectiveTransform(positions + flow_motion.flow, homography) - positions
    status = flow_motion.status
    if status == "no_motion":
        # The original frame 1 shows motion: the camera rotated.
        status = Status(
            "pure_rotation",
            "too little parallax for depth: the camera only rotated; move the camera between "
            "frames",
        )
    return replace(
        flow_motion,
        rotation=matched_motion.rotation @ flow_motion.rotation,
        translation=matched_motion.rotation @ flow_motion.translation,
        status=status,
        flow=flow,
        trust=np.where(leaves_image(np.moveaxis(flow, -1, 0)), 0, flow_motion.trust),
        history=matched_motion.history + flow_motion.history,
        uses_matches=True,
        light=tuple(change.warp(homography, grey0.shape) for change in flow_motion.light),
    )


def _rotated_valid_pixels(
    pyramid: ImagePyramid, homography: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the used pixels of frame 0 and of the rotated frame 1; None for all."""
    if pyramid.masks is None:
        return None
    valid0, valid1 = pyramid.masks.original
    rotated_valid1 = cv2.warpPerspective(
        valid1.astype(np.float32),
        homography,
        valid0.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return valid0, rotated_valid1 == 1


def _rotation_homography(
    rotation: np.ndarray, camera: Camera, height: int, width: int
) -> np.ndarray:
    """Return the homography of pixels under a rotation, (3, 3)."""
    cx, cy = camera.center_for(height, width)
    matrix = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    return matrix @ rotation @ np.linalg.inv(matrix)
