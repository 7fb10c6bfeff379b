"""Depth of a pair whose labels are known: diverged parts, textureless background, scales.

The data hardly determine the motion of a small object. If a refined motion takes the object's
pixels out of the image, no data are left to correct it, so labels and pixels whose flow diverges
are restored. Depth of a partly textureless background is carried across. Objects take the scale of
the background at their contacts with it.
"""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.egomotion import triangulate
from tisfm.motion.estimate import Estimate
from tisfm.motion.joined_depth import SolutionWithDeviation, join_solutions
from tisfm.motion.objects.layers import fill_nearest
from tisfm.motion.objects.settings import OBJECTS
from tisfm.motion.rigid_depth import (
    RigidSolution,
    motion_precision,
    rigid_depth,
    scaled_translations,
)
from tisfm.motion.settings import DEPTH
from tisfm.motion.textureless_depth import textureless_depth, textureless_share
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid


def restore_diverged_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    motions: np.ndarray,  # (K, 3, 4) array: R and t of each motion, the largest label's first
    labels: np.ndarray,  # (H, W) int32
    expected_flow: np.ndarray,  # (2, H, W) float32: flow of the layers
    estimate_solution: Callable[[RigidSolution], Estimate],  # returns the estimate of a solution
) -> tuple[RigidSolution, Estimate]:  # the solution and its estimate
    """Estimate motions and depth of several labels, and restore diverged labels and pixels.

    A label whose flow diverges keeps the motion and the depth of its layer; the largest label is
    never restored. If few pixels diverge, they take the depth of the nearest other pixels of their
    label, or 0 if their label has none. The precision of restored pixels is computed anew.
    """
    side = max(labels.shape)
    solution = rigid_depth(pyramid, settings, motions, labels)
    estimate = estimate_solution(solution)
    difference = _flow_difference(estimate, expected_flow)
    diverged_labels = [
        label
        for label in range(1, len(motions))
        if np.median(difference[labels == label]) > OBJECTS.max_label_difference * side
    ]
    is_restored = np.isin(labels, diverged_labels)
    if diverged_labels:
        solution = _restore_layers(
            solution, motions, labels, expected_flow, diverged_labels, pyramid.cameras[0]
        )
        difference = _flow_difference(estimate_solution(solution), expected_flow)
    is_diverged = difference > OBJECTS.max_pixel_difference * side
    if 0 < is_diverged.mean() <= OBJECTS.max_diverged_share:
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
    return solution, estimate_solution(solution)


def _update_precision(
    pyramid: ImagePyramid,
    settings: Settings,
    solution: RigidSolution,
    labels: np.ndarray,
    is_restored: np.ndarray,  # (H, W) bool: the part
) -> RigidSolution:
    """Return a solution whose precision is computed anew on a part of the image."""
    depth = solution.inverse_depth
    finite_depth = np.where(np.isfinite(depth), depth, 0)
    precision = motion_precision(pyramid, settings, solution.motions, labels, finite_depth)
    return replace(solution, precision=np.where(is_restored, precision, solution.precision))


def _restore_layers(
    solution: RigidSolution,
    motions: np.ndarray,  # (K, 3, 4): motions of the layers
    labels: np.ndarray,  # (H, W)
    expected_flow: np.ndarray,  # (2, H, W): flow of the layers, px/frame
    diverged_labels: list[int],
    camera: Camera,
) -> RigidSolution:
    """Return a solution whose diverged labels have the motion and depth of their layers."""
    restored_motions = solution.motions.copy()
    restored_motions[diverged_labels] = scaled_translations(motions, labels, camera)[
        diverged_labels
    ]
    depth = solution.inverse_depth.copy()
    cx, cy = camera.center_for(*labels.shape)
    for label in diverged_labels:
        is_label = labels == label
        rows, columns = np.nonzero(is_label)
        positions = np.stack([columns - cx, rows - cy], axis=-1)
        ones = np.ones((len(positions), 1))
        rays0, rays1 = (
            np.hstack([points / camera.focal, ones])
            for points in (positions, positions + expected_flow[:, is_label].T)
        )
        rotation, translation = restored_motions[label, :, :3], restored_motions[label, :, 3]
        if translation.any():
            depth[is_label] = camera.focal * triangulate(rays0, rays1, rotation, translation)
    return replace(solution, motions=restored_motions, inverse_depth=depth)


def _flow_difference(estimate: Estimate, expected_flow: np.ndarray) -> np.ndarray:
    """Return the distance of every pixel's flow from the expected flow, (H, W), px."""
    with np.errstate(over="ignore", invalid="ignore"):
        difference = np.hypot(*(estimate.flow - expected_flow))
    return np.where(np.isfinite(difference), difference, np.inf)


def carry_background_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    solution: RigidSolution,
    labels: np.ndarray,  # (H, W) int32: 0 for the background
    # (3, 4) array: R and t of the background's layer, because wrong depth of textureless surfaces
    # spoils the refined motion
    motion: np.ndarray,
) -> SolutionWithDeviation | None:
    """Return a solution with carried depth of the background, if the frame is partly textureless.

    Pixels of other labels keep their motion and depth. They are neither matched nor constrained
    under the background's motion.

    Returns None if little of the frame is textureless, if the parallax of the background differs
    too little between near and far, or if too little of the background could be matched.
    """
    if (
        textureless_share(pyramid.frames0[pyramid.last], pyramid.valid0(pyramid.last))
        < DEPTH.min_textureless_share
    ):
        return None
    is_background = labels == 0
    low, high = np.percentile(solution.inverse_depth[is_background], DEPTH.range_percentiles)
    if not high - low >= DEPTH.min_carried_range * max(labels.shape):
        return None
    interior = (
        cv2.erode(
            is_background.astype(np.uint8),
            np.ones((OBJECTS.background_rim, OBJECTS.background_rim), np.uint8),
        )
        > 0
    )
    motions = solution.motions.copy()
    motions[0] = scaled_translations(motion[None], labels, pyramid.cameras[0])[0]
    new_solution = textureless_depth(pyramid, settings, motions[0], support=interior)
    if new_solution is None:
        return None
    return join_solutions(
        solution,
        new_solution,
        is_background,
        motions=motions,
        status_from_other=solution.converged or not labels.any(),
    )


def align_scales(
    estimate: Estimate,  # with motions, labels and inverse depth; the background is label 0
    hidden: np.ndarray,  # (H, W) bool: pixels whose depth is not used
) -> Estimate:
    """Bring objects to the scale of the background on which they stand.

    From motion alone, every object has a scale of its own. In each column of an object, the lowest
    pixel counts as a contact if it is in the lower half of the object's rows and the background is
    below it. At a contact, object and background are assumed equally far away. The object's scale
    is the median ratio over the columns. Objects without contact keep their own scale, and so do
    all objects if the background has no depth.

    Inverse depth, its deviation and T of an object get the unit of the background, so ‖T‖ of an
    object differs from 1.
    """
    motions, labels = estimate.motions, estimate.labels
    if motions is None or labels is None or estimate.inverse_depth_std is None:
        return estimate
    scales = np.ones(len(motions))
    for label in range(1, len(motions)):
        scale = contact_scale(estimate.inverse_depth, labels, hidden, label)
        if scale is not None and motions[label, :3].any():
            scales[label] = scale
    twists = motions.copy()
    twists[:, :3] /= scales[:, None]
    pixel_scales = scales.astype(np.float32)[labels]
    return replace(
        estimate,
        motions=twists,
        inverse_depth=estimate.inverse_depth * pixel_scales,
        inverse_depth_std=estimate.inverse_depth_std * pixel_scales,
    )


def contact_scale(
    # (H, W) float32: in the object's own unit at its pixels, and in the background's unit elsewhere
    inverse_depth: np.ndarray,
    labels: np.ndarray,  # (H, W) int array: 0 for the background
    hidden: np.ndarray,  # (H, W) bool: pixels whose depth is not used
    label: int,  # the object's label
) -> float | None:
    """Return inverse depth of the background divided by that of the object at contacts, or None."""
    height = len(labels)
    is_object = labels == label
    columns = np.flatnonzero(is_object.any(axis=0))
    if not len(columns):
        return None
    rows = np.flatnonzero(is_object.any(axis=1))
    bottom = height - 1 - is_object[::-1].argmax(axis=0)[columns]
    object_rows, floor_rows = bottom - OBJECTS.contact_distance, bottom + OBJECTS.contact_distance
    is_low = (
        (bottom >= rows[0] + OBJECTS.min_contact_height * (rows[-1] - rows[0]))
        & (floor_rows < height)
        & (object_rows >= 0)
    )
    columns, object_rows, floor_rows = columns[is_low], object_rows[is_low], floor_rows[is_low]
    is_contact = (labels[floor_rows, columns] == 0) & is_object[object_rows, columns]
    is_contact &= ~hidden[floor_rows, columns] & ~hidden[object_rows, columns]
    columns, object_rows, floor_rows = (
        columns[is_contact],
        object_rows[is_contact],
        floor_rows[is_contact],
    )
    # Double precision avoids overflow of the quotient.
    object_depth, background_depth = (
        inverse_depth[rows, columns].astype(float) for rows in (object_rows, floor_rows)
    )
    is_usable = (object_depth != 0) & np.isfinite(object_depth) & np.isfinite(background_depth)
    ratio = background_depth[is_usable] / object_depth[is_usable]
    ratio = ratio[ratio > 0]
    return float(np.median(ratio)) if len(ratio) >= OBJECTS.min_contact_columns else None
