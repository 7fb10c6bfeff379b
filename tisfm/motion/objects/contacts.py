"""Where objects touch the background, their depths agree: scales aligned at contacts."""

from dataclasses import replace

import numpy as np

from tisfm.motion.estimate import Estimate

APART = 3  # px from the boundary, on both sides, where depths are read
FEWEST_COLUMNS = 8  # columns that a contact needs
LOWEST = 0.5  # of an object's rows: what touches the floor is its lower half


def aligned(estimate: Estimate, hidden: np.ndarray) -> Estimate:
    """Bring objects to the scale of the background below them, where they stand on it.

    From motion alone every object has a scale of its own. In each column of an object the lowest
    pixel is taken, if the background lies below it, in the lower half of the object's rows; there
    both are taken to be equally far away. The median of the ratio over columns is the object's
    scale. Objects that show no such contact, and all where the background shows no depth, keep
    their own.

    Parameters
    ----------
    estimate : Estimate
        With motions, labels and inverse depth; the background is label 0.
    hidden : (H, W) bool
        Where depth is not to be read.

    Returns
    -------
    Estimate
        Inverse depth and its deviation in the background's unit; an object's T likewise, so that
        its length is no longer 1.
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
    inverse_depth: np.ndarray, labels: np.ndarray, hidden: np.ndarray, label: int
) -> float | None:
    """Return the background's inverse depth over an object's where they touch; None if nowhere.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        Of the object where it is labelled, in its own unit, and of the background elsewhere.
    labels : (H, W) int array
        0 for the background.
    hidden : (H, W) bool
        Where depth is not to be read.
    label : int
        Of the object.
    """
    height = len(labels)
    mine = labels == label
    columns = np.flatnonzero(mine.any(axis=0))
    if not len(columns):
        return None
    rows = np.flatnonzero(mine.any(axis=1))
    lowest = height - 1 - mine[::-1].argmax(axis=0)[columns]
    above, below = lowest - APART, lowest + APART
    seen = (lowest >= rows[0] + LOWEST * (rows[-1] - rows[0])) & (below < height) & (above >= 0)
    columns, above, below = columns[seen], above[seen], below[seen]
    touches = (labels[below, columns] == 0) & mine[above, columns]
    touches &= ~hidden[below, columns] & ~hidden[above, columns]
    columns, above, below = columns[touches], above[touches], below[touches]
    # In double precision no quotient overflows.
    standing, ground = (inverse_depth[rows, columns].astype(float) for rows in (above, below))
    known = (standing != 0) & np.isfinite(standing) & np.isfinite(ground)
    ratio = ground[known] / standing[known]
    ratio = ratio[ratio > 0]
    return float(np.median(ratio)) if len(ratio) >= FEWEST_COLUMNS else None
