"""Restores labels and pixels whose flow diverges when motions and depth are refined.

The data hardly determine the motion of a small object. If the motion takes the object's pixels out
of the image, no data are left to correct it.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tisfm.camera import Camera
from tisfm.motion.egomotion import triangulate
from tisfm.motion.estimate import Estimate
from tisfm.motion.objects.layers import nearest_known
from tisfm.motion.rigid_depth import (
    RigidSolution,
    motion_precision,
    rigid_depth,
    scaled_translations,
)
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid

# Of the longer side: largest distance of a label's flow (median) and of a pixel's flow from the
# flow of the layer.
LABEL_AWAY, PIXEL_AWAY = 0.01, 0.05
FEW = 0.02  # of the pixels: if more diverge, the whole pair has diverged, and pixels stay


def stable_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    motions: np.ndarray,  # (K, 3, 4) array: R and t of each motion, the largest label's first
    labels: np.ndarray,  # (H, W) int32
    expected: np.ndarray,  # (2, H, W) float32: flow of the layers
    finish: Callable[[RigidSolution], Estimate],  # returns the estimate of a solution
) -> tuple[RigidSolution, Estimate]:  # the solution and its estimate
    """Estimate motions and depth of several labels, and restore diverged labels and pixels.

    A label whose flow diverges keeps the motion and the depth of its layer; the largest label is
    never restored. If few pixels diverge, they take the depth of the nearest good pixels of their
    label, or 0 if there are none. The precision of restored pixels is computed anew.
    """
    side = max(labels.shape)
    solution = rigid_depth(pyramid, settings, motions, labels)
    estimate = finish(solution)
    away = _away(estimate, expected)
    lost = [
        label
        for label in range(1, len(motions))
        if np.median(away[labels == label]) > LABEL_AWAY * side
    ]
    brought_back = np.isin(labels, lost)
    if lost:
        solution = _with_layers(solution, motions, labels, expected, lost, pyramid.cameras[0])
        away = _away(finish(solution), expected)
    far = away > PIXEL_AWAY * side
    if 0 < far.mean() <= FEW:
        depth = solution.inverse_depth.copy()
        for label in np.unique(labels[far]):
            mine, near = labels == label, (labels == label) & ~far
            depth[mine & far] = nearest_known(depth, near)[mine & far] if near.any() else 0
        solution = replace(solution, inverse_depth=depth)
        brought_back |= far
    if not brought_back.any():
        return solution, estimate
    solution = _judged(pyramid, settings, solution, labels, brought_back)
    return solution, finish(solution)


def _judged(
    pyramid: ImagePyramid,
    settings: Settings,
    solution: RigidSolution,
    labels: np.ndarray,
    where: np.ndarray,
) -> RigidSolution:
    """Return a solution whose precision is computed anew on a part of the image."""
    depth = solution.inverse_depth
    known = np.where(np.isfinite(depth), depth, 0)
    precision = motion_precision(pyramid, settings, solution.motions, labels, known)
    return replace(solution, precision=np.where(where, precision, solution.precision))


def _with_layers(
    solution: RigidSolution,
    motions: np.ndarray,
    labels: np.ndarray,
    expected: np.ndarray,
    lost: list[int],
    camera: Camera,
) -> RigidSolution:
    """Return a solution where the labels `lost` have the motion and depth of their layers."""
    held = solution.motions.copy()
    held[lost] = scaled_translations(motions, labels, camera)[lost]
    depth = solution.inverse_depth.copy()
    cx, cy = camera.center_for(*labels.shape)
    for label in lost:
        mine = labels == label
        rows, columns = np.nonzero(mine)
        start = np.stack([columns - cx, rows - cy], axis=-1)
        ones = np.ones((len(start), 1))
        before, after = (
            np.hstack([place / camera.focal, ones])
            for place in (start, start + expected[:, mine].T)
        )
        rotation, translation = held[label, :, :3], held[label, :, 3]
        if translation.any():
            depth[mine] = camera.focal * triangulate(before, after, rotation, translation)
    return replace(solution, motions=held, inverse_depth=depth)


def _away(estimate: Estimate, expected: np.ndarray) -> np.ndarray:
    """Return the distance of every pixel's flow from the expected flow, (H, W), px."""
    with np.errstate(over="ignore", invalid="ignore"):
        away = np.hypot(*(estimate.flow - expected))
    return np.where(np.isfinite(away), away, np.inf)
