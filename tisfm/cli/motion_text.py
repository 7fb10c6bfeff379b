"""Rigid motions as lines of twelve numbers."""

import os

import numpy as np

from tisfm.formats import atomic_write
from tisfm.interpretation import Interpretation
from tisfm.rigid import rigid_motion


def motion_rows(result: Interpretation, *, pose: np.ndarray | None = None) -> np.ndarray | None:
    """Return the rigid motions of a result as rows of numbers.

    Parameters
    ----------
    result : Interpretation
    pose : (4, 4), optional
        The motion that the interpretation was given. It stands for the first one, because
        `Interpretation.motions` has lost its length.

    Returns
    -------
    (K, 12) float64 or None
        The rows of (R | t), one after the other: P₁ = R P₀ + t, with t in the unit of
        `Interpretation.depth`; NaN where the interpretation diverged. None for
        ``motion="field"``.
    """
    if result.motions is None:
        return None
    rows = np.full((len(result.motions), 12), np.nan)
    for row, twist in zip(rows, result.motions, strict=True):
        if np.isfinite(twist).all():
            rotation, translation = rigid_motion(twist)
            row[:] = np.column_stack([rotation, translation]).ravel()
    if pose is not None:
        rows[0] = np.asarray(pose, np.float64)[:3].ravel()
    return rows


def write_motions(path: str | os.PathLike[str], rows: np.ndarray) -> None:
    """Write motions as text, a line of twelve numbers for each, whole or not at all.

    Parameters
    ----------
    path : path
    rows : (K, 12)

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    lines = (" ".join(f"{number:.9g}" for number in row) for row in rows)
    with atomic_write(path) as file:
        file.write("".join(f"{line}\n" for line in lines).encode("ascii"))
