"""The pieces that a sequence fell into, of which each gets files of its own."""

from collections.abc import Iterable, Sequence
from operator import index
from pathlib import Path

import numpy as np

from tisfm.errors import InputError, OutOfRangeError
from tisfm.reconstruction.result.reconstruction import Reconstruction


def chosen_frames(frames: Iterable[int] | None, count: int) -> list[int]:
    """Return numbers of frames in their order, all of them by default.

    Raises
    ------
    IndexError
        If there is no such frame.
    ValueError
        If no frame is left.
    """
    chosen = sorted({index(frame) for frame in (range(count) if frames is None else frames)})
    if not chosen:
        raise InputError(f"no frame is chosen of {count}: expected some, from 0 to {count - 1}")
    for frame in (chosen[0], chosen[-1]):
        if not 0 <= frame < count:
            raise OutOfRangeError(f"frame is {frame}: expected 0 to {count - 1}")
    return chosen


def pieces_of(result: Reconstruction, frames: Iterable[int] | None = None) -> list[list[int]]:
    """Return the frames of each piece that have a pose, the piece of most frames first.

    Raises
    ------
    IndexError
        If there is no such frame.
    ValueError
        If none of the frames has a pose.
    """
    chosen = chosen_frames(frames, len(result))
    found: dict[int, list[int]] = {}
    for frame in chosen:
        if result.piece[frame] >= 0 and np.isfinite(result.poses[frame]).all():
            found.setdefault(int(result.piece[frame]), []).append(frame)
    if not found:
        raise InputError(
            f"none of {len(chosen)} frames in {result.folder} has a pose: see the statuses of "
            "the reconstruction"
        )
    return sorted(found.values(), key=len, reverse=True)


def piece_files(folder: Path, name: str, pieces: Sequence[object]) -> list[Path]:
    """Return a file for each piece: that of the first has the name, others a number besides."""
    stem, dot, suffix = name.partition(".")
    return [
        folder / (name if number == 1 else f"{stem}-piece{number}{dot}{suffix}")
        for number in range(1, len(pieces) + 1)
    ]
