"""Scales of objects from their contacts with the background, where both have the same depth."""

from dataclasses import replace

import numpy as np

from tisfm.motion.estimate import Estimate

APART = 3  # px: distance from the boundary at which depths are read, on both sides
FEWEST_COLUMNS = 8  # least number of columns of a contact
LOWEST = 0.5  # of an object's rows: only the lower half touches the floor


def align_scales(
    estimate: Estimate,  # with motions, labels and inverse depth; the background is label 0
    hidden: np.ndarray,  # (H, W) bool: pixels whose depth is not used
) -> Estimate:
    """Bring objects to the scale of the background on which they stand.

    From motion alone, every object has a scale of its own. In each column of an object, the lowest
    pixel counts as a contact if it is in the lower half of the object's rows and the background is
    below it. Object and background are assumed equally far away there. The object's scale is the
    median ratio over the columns. Objects without contact keep their own scale, and so do all
    objects if the background has no depth.

    Returns inverse depth, its deviation and T of objects are in the background's unit, so the
    length of an object's T is no longer 1.
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
    per_pixel = scales.astype(np.float32)[labels]
    return replace(
        estimate,
        motions=twists,
        inverse_depth=estimate.inverse_depth * per_pixel,
        inverse_depth_std=estimate.inverse_depth_std * per_pixel,
    )


def contact_scale(
    # (H, W) float32: in the object's own unit at its pixels, and in the background's unit elsewhere
    inverse_depth: np.ndarray,
    labels: np.ndarray,  # (H, W) int array: 0 for the background
    hidden: np.ndarray,  # (H, W) bool: pixels whose depth is not used
    label: int,  # the object's label
) -> float | None:
    """Return the ratio of background's to object's inverse depth at contacts, None without them."""
    height = len(labels)
    is_object = labels == label
    columns = np.flatnonzero(is_object.any(axis=0))
    if not len(columns):
        return None
    rows = np.flatnonzero(is_object.any(axis=1))
    lowest = height - 1 - is_object[::-1].argmax(axis=0)[columns]
    above, below = lowest - APART, lowest + APART
    is_low = (lowest >= rows[0] + LOWEST * (rows[-1] - rows[0])) & (below < height) & (above >= 0)
    columns, above, below = columns[is_low], above[is_low], below[is_low]
    is_contact = (labels[below, columns] == 0) & is_object[above, columns]
    is_contact &= ~hidden[below, columns] & ~hidden[above, columns]
    columns, above, below = columns[is_contact], above[is_contact], below[is_contact]
    # Double precision avoids overflow of the quotient.
    object_depth, background_depth = (
        inverse_depth[rows, columns].astype(float) for rows in (above, below)
    )
    is_known = (object_depth != 0) & np.isfinite(object_depth) & np.isfinite(background_depth)
    ratio = background_depth[is_known] / object_depth[is_known]
    ratio = ratio[ratio > 0]
    return float(np.median(ratio)) if len(ratio) >= FEWEST_COLUMNS else None
