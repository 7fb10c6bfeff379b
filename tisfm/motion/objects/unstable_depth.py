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
from tisfm.motion.objects.layers import fill_nearest
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


def restore_diverged_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    motions: np.ndarray,  # (K, 3, 4) array: R and t of each motion, the largest label's first
    labels: np.ndarray,  # (H, W) int32
    expected: np.ndarray,  # (2, H, W) float32: flow of the layers
    estimate_of: Callable[[RigidSolution], Estimate],  # returns the estimate of a solution
) -> tuple[RigidSolution, Estimate]:  # the solution and its estimate
    """Estimate motions and depth of several labels, and restore diverged labels and pixels.

    A label whose flow diverges keeps the motion and the depth of its layer; the largest label is
    never restored. If few pixels diverge, they take the depth of the nearest good pixels of their
    label, or 0 if there are none. The precision of restored pixels is computed anew.
    """
    side = max(labels.shape)
    solution = rigid_depth(pyramid, settings, motions, labels)
    estimate = estimate_of(solution)
    difference = _flow_difference(estimate, expected)
    diverged = [
        label
        for label in range(1, len(motions))
        if np.median(difference[labels == label]) > LABEL_AWAY * side
    ]
    is_restored = np.isin(labels, diverged)
    if diverged:
        solution = _restore_layers(
            solution, motions, labels, expected, diverged, pyramid.cameras[0]
        )
        difference = _flow_difference(estimate_of(solution), expected)
    is_diverged = difference > PIXEL_AWAY * side
    if 0 < is_diverged.mean() <= FEW:
        depth = solution.inverse_depth.copy()
        for label in np.unique(labels[is_diverged]):
            is_label, is_reliable = labels == label, (labels == label) & ~is_diverged
            depth[is_label & is_diverged] = (
                fill_nearest(depth, is_reliable)[is_label & is_diverged] if is_reliable.any() else 0
            )
        solution = replace(solution, inverse_depth=depth)
        is_restored |= is_diverged
    if not is_restored.any():
        return solution, estimate
    solution = _update_precision(pyramid, settings, solution, labels, is_restored)
    return solution, estimate_of(solution)


def _update_precision(
    pyramid: ImagePyramid,
    settings: Settings,
    solution: RigidSolution,
    labels: np.ndarray,
    is_restored: np.ndarray,
) -> RigidSolution:
    """Return a solution whose precision is computed anew on a part of the image."""
    depth = solution.inverse_depth
    finite_depth = np.where(np.isfinite(depth), depth, 0)
    precision = motion_precision(pyramid, settings, solution.motions, labels, finite_depth)
    return replace(solution, precision=np.where(is_restored, precision, solution.precision))


def _restore_layers(
    solution: RigidSolution,
    motions: np.ndarray,
    labels: np.ndarray,
    expected: np.ndarray,
    diverged: list[int],
    camera: Camera,
) -> RigidSolution:
    """Return a solution where the labels `diverged` have the motion and depth of their layers."""
    restored_motions = solution.motions.copy()
    restored_motions[diverged] = scaled_translations(motions, labels, camera)[diverged]
    depth = solution.inverse_depth.copy()
    cx, cy = camera.center_for(*labels.shape)
    for label in diverged:
        is_label = labels == label
        rows, columns = np.nonzero(is_label)
        positions = np.stack([columns - cx, rows - cy], axis=-1)
        ones = np.ones((len(positions), 1))
        before, after = (
            np.hstack([points / camera.focal, ones])
            for points in (positions, positions + expected[:, is_label].T)
        )
        rotation, translation = restored_motions[label, :, :3], restored_motions[label, :, 3]
        if translation.any():
            depth[is_label] = camera.focal * triangulate(before, after, rotation, translation)
    return replace(solution, motions=restored_motions, inverse_depth=depth)


def _flow_difference(estimate: Estimate, expected: np.ndarray) -> np.ndarray:
    """Return the distance of every pixel's flow from the expected flow, (H, W), px."""
    with np.errstate(over="ignore", invalid="ignore"):
        difference = np.hypot(*(estimate.flow - expected))
    return np.where(np.isfinite(difference), difference, np.inf)
