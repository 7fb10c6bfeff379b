"""Texts of numbers, and the poses in their rows."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.formats import FormatError
from tisfm.formats.text import read_text
from tisfm.rigid import is_rotation


def read_lines(path: Path) -> list[tuple[int, list[str]]]:
    """Return the words of every line of a text, with its number.

    Lines that are empty or begin with # do not count.
    """
    lines = read_text(path).splitlines()
    words = [(number, line.split()) for number, line in enumerate(lines, 1)]
    return [(number, line) for number, line in words if line and not line[0].startswith("#")]


def read_rows(path: Path, *, columns: int) -> list[tuple[int, list[float]]]:
    """Return the numbers of every line of a text, with its number.

    Parameters
    ----------
    path : Path
    columns : int
        Numbers that each line must have. Lines that are empty or begin with # do not count.

    Raises
    ------
    FormatError
        If a line has others; it is named.
    OSError
        If the file does not exist or cannot be read.
    """
    rows = []
    for number, words in read_lines(path):
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise FormatError(f"{path}, line {number}: {error}, expected numbers") from error
        if len(values) != columns:
            raise FormatError(
                f"{path}, line {number} has {len(values)} numbers, expected {columns}"
            )
        rows.append((number, values))
    return rows


def pose_of_twelve(numbers: list[float]) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of its upper three rows."""
    return np.vstack([np.reshape(numbers, (3, 4)), [0, 0, 0, 1]])


def checked_pose(pose: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """Return a (4, 4) pose, or raise FormatError, which begins with `where`, if it is none."""
    if not np.isfinite(pose).all():
        raise FormatError(f"{where} is not finite: there is no pose of this frame")
    if not is_rotation(pose[:3, :3]):
        raise FormatError(
            f"{where} holds no rotation: expected an orthonormal matrix in the first three columns"
        )
    return pose
