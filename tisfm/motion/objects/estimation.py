"""Several rigid motions, a label per pixel, and depth of every object: ``motion="objects"``."""

from dataclasses import replace

import cv2
import numpy as np

from tisfm.motion.camera import only_turned
from tisfm.motion.estimate import Estimate
from tisfm.motion.first_motion import STILL, FirstMotion, first_motion
from tisfm.motion.objects.background import with_carried_background
from tisfm.motion.objects.boundaries import sharpen_labels
from tisfm.motion.objects.candidates import motion_candidates, smallest_object
from tisfm.motion.objects.contacts import aligned
from tisfm.motion.objects.layers import Layering, Layers, without_specks
from tisfm.motion.objects.unstable_depth import stable_depth
from tisfm.motion.objects.wide_baseline import wide_baseline_motion
from tisfm.motion.rigid_depth import RigidSolution
from tisfm.motion.rigid_estimate import with_depth
from tisfm.settings import MOST_SMOOTHNESS, Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.visibility.occlusion import occlusion_in

# Factor of depth smoothness. Objects show less parallax than a static scene, so their depth has
# more noise.
SMOOTHER = 4 / 3
PIXELS = 2**16  # least pixels of the level on which motions and their pixels are found


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
    pixels are restored (`unstable_depth`). If much of the frame has no texture, depth of the
    background is carried across (`background`).
    """
    # A wrong label is worse than a wrong depth, so flow and surfaces get more iterations.
    settings = replace(
        settings,
        finest_level=0,
        warps=max(settings.warps, 2),
        outer_iterations=max(settings.outer_iterations, 10),
        sweeps=max(settings.sweeps, 8),
    )
    camera = pyramid.cameras[0]
    start = first_motion(pyramid, settings, pixels=PIXELS)
    if start.status == "unrelated" and not start.is_cut:
        start = first_motion(pyramid, settings) if start.level > 0 else start
        if start.status == "unrelated":
            start = wide_baseline_motion(pyramid, settings, start, grey0, grey1)
    nothing_seen = start.status in ("no_texture", "unrelated", "aperture")
    if nothing_seen or (start.status == "no_motion" and not start.flow.any()):
        assert start.status is not None
        return only_turned(pyramid, settings, start, start.status, level=0)
    level = start.level
    layers = _layers(pyramid, settings, grey0, start)
    motions = layers.motions
    hidden = _resized(layers.hidden, pyramid.shape)
    labels, flows = _to_the_pixel(pyramid, level, layers, grey0, grey1, start.residual)
    if not labels.any() and start.status is not None:
        return only_turned(pyramid, settings, start, start.status, level=0)
    areas = np.bincount(labels.ravel(), minlength=len(motions))
    order = np.argsort(-areas, kind="stable")[: np.count_nonzero(areas)]
    rank = np.zeros(len(motions), np.int32)
    rank[order] = np.arange(len(order))
    expected = np.take_along_axis(flows, labels[None, None], axis=0)[0]
    labels = rank[labels]
    # Next to objects with reliable depth, rough depth of the background is left out.
    rough = start.status is not None or (len(order) > 1 and start.doubt == "uncertain")
    unseen = int(rank[0]) if rough and areas[0] else None

    def finish(solution: RigidSolution) -> Estimate:
        return with_depth(solution, labels, camera, settings, unseen=unseen)

    solution, estimate = stable_depth(
        pyramid,
        replace(
            settings,
            depth_smoothness=min(SMOOTHER * settings.depth_smoothness, MOST_SMOOTHNESS),
        ),
        np.stack([motions[k] for k in order]),
        labels,
        expected,
        finish,
    )
    if unseen != 0:
        carried = with_carried_background(pyramid, settings, solution, labels, motions[order[0]])
        estimate = estimate if carried is None else finish(carried)
    history = start.history + estimate.history
    estimate = replace(estimate, history=history, matched=start.matched)
    if len(order) == 1 and start.doubt is not None:
        estimate = replace(estimate, status=start.doubt)
    return aligned(estimate, hidden) if settings.align_scales else estimate


def _layers(
    pyramid: ImagePyramid, settings: Settings, grey0: np.ndarray, start: FirstMotion
) -> Layers:
    """Return the layers on the level of a flow field: motions and rough labels."""
    coarse, scale = pyramid.coarser(start.level), pyramid.scales[start.level]
    frame = coarse.frames0[0] if start.level else grey0  # grey0 is sharper
    hidden = occlusion_in(coarse, np.ascontiguousarray(np.moveaxis(start.flow, -1, 0)), settings)
    motions, labels = motion_candidates(
        start.flow,
        np.where(hidden, 0, start.trust),
        coarse.cameras[0],
        frame,
        start.matrix,
        start.residual * scale,
        most=settings.max_objects,
    )
    layering = Layering(coarse, settings, frame, density=scale)
    layers = layering.fitted(motions, labels, hidden)
    if len(motions) > 1:
        layers = layering.pruned(layers)
        motions = layering.refitted(layers, start.flow, start.trust)
        layers = layering.pruned(layering.fitted(motions, layers.labels, layers.hidden))
    return layering.with_floating(layers, most=settings.max_objects)


def _to_the_pixel(
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
        least = max(STILL, 3 * residual) * pyramid.scales[level]
        labels = np.where(_as_background(layers, least), 0, labels)
    for k in range(level, -1, -1):
        shape = pyramid.frames0[k].shape
        if k < level:
            labels = _resized(labels, shape)
            flows = _finer(flows, shape, pyramid.scales[k] / pyramid.scales[k + 1])
        reach = np.stack([_resized(where, shape) for where in layers.reach])
        smallest = smallest_object(labels.size)
        frames = (grey0, grey1) if k == 0 else (pyramid.frames0[k], pyramid.frames1[k])
        labels = without_specks(labels, smallest)
        labels = without_specks(sharpen_labels(labels, flows, reach, *frames), smallest)
    return labels, flows


def _resized(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return labels or a mask on another level, (h, w), by nearest neighbours."""
    if image.shape == shape:
        return image
    small = image.astype(np.uint8)
    return cv2.resize(small, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(image.dtype)


def _finer(flows: np.ndarray, shape: tuple[int, ...], ratio: float) -> np.ndarray:
    """Return flows, (K, 2, h, w), on a finer level that is `ratio` times as dense."""
    return np.stack(
        [
            np.stack([cv2.resize(part, shape[::-1]) for part in np.nan_to_num(flow)])
            for flow in flows
        ]
    ) * np.float32(ratio)


def _as_background(layers: Layers, least: float) -> np.ndarray:
    """Return pixels whose flow differs from the background's by less than `least` px, (H, W) bool.

    Under a motion with translation, distant points move as under its rotation alone. So such a
    motion also explains a background that only rotates, by a wrong depth.
    """
    own = np.take_along_axis(layers.flows, layers.labels[None, None], axis=0)[0]
    return np.linalg.norm(own - layers.flows[0], axis=0) < least
