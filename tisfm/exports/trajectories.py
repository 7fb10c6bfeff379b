"""The path of the camera as TUM's and KITTI's tools read it."""

import os
from collections.abc import Iterable
from pathlib import Path

from tisfm.exports.clock import frame_times
from tisfm.exports.pieces import piece_files, pieces_of
from tisfm.formats import atomic_write
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.trajectory import write_kitti, write_tum

TUM, KITTI, KITTI_TIMES = "trajectory.tum", "poses.kitti", "poses.times"


def write_tum_paths(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    frames: Iterable[int] | None = None,
    frames_per_second: float | None = None,
) -> list[Path]:
    """Write the path as TUM's tools and evo read it: ``trajectory.tum``.

    A line has time tx ty tz qx qy qz qw, camera to world, in the unit of the poses. Frames without
    a pose have none.

    Parameters
    ----------
    result : Reconstruction
    folder : path
        It has to exist. Where the sequence fell into pieces, the largest is ``trajectory.tum``,
        the next ``trajectory-piece2.tum``, and so on.
    frames : iterable of int, optional
        Numbers of frames; by default all.
    frames_per_second : float, optional
        Times are then the numbers of frames over it. By default they are those of the source, s,
        or the numbers of the frames where these are not known.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ValueError, IndexError
        If no frame has a pose, or there is no such frame.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_tum_paths
    >>> [str(file) for file in write_tum_paths(tisfm.Reconstruction.load("walk"), ".")]
    ['trajectory.tum']
    """
    pieces = pieces_of(result, frames)
    times = frame_times(result.times, frames_per_second)
    files = piece_files(Path(folder), TUM, pieces)
    for file, piece in zip(files, pieces, strict=True):
        write_tum(file, result.poses[piece], times[piece])
    return files


def write_kitti_paths(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    frames: Iterable[int] | None = None,
    frames_per_second: float | None = None,
) -> list[Path]:
    """Write the path as KITTI's tools and evo read it: ``poses.kitti`` and ``poses.times``.

    A line of the first has twelve numbers, the rows of (R | t), camera to world; the same line of
    the other has the time of the frame. Frames without a pose have no line in either, as programs
    stop at one without numbers.

    Parameters
    ----------
    result, folder, frames, frames_per_second
        As for `write_tum_paths`.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ValueError, IndexError, OSError
        As for `write_tum_paths`.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_kitti_paths
    >>> [str(file) for file in write_kitti_paths(tisfm.Reconstruction.load("walk"), ".")]
    ['poses.kitti', 'poses.times']
    """
    pieces = pieces_of(result, frames)
    times = frame_times(result.times, frames_per_second)
    poses = piece_files(Path(folder), KITTI, pieces)
    stamps = piece_files(Path(folder), KITTI_TIMES, pieces)
    for file, other, piece in zip(poses, stamps, pieces, strict=True):
        write_kitti(file, result.poses[piece])
        with atomic_write(other) as stream:
            stream.write("".join(f"{time!r}\n" for time in times[piece].tolist()).encode())
    return [*poses, *stamps]
