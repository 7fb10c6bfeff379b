"""The path of the camera in the formats of TUM and KITTI."""

import os
from collections.abc import Iterable
from pathlib import Path

from tisfm.exports.export_request import frame_times, piece_files, piece_frames
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
    """Write the path for the tools of TUM and for evo: ``trajectory.tum``.

    A line has time tx ty tz qx qy qz qw, camera to world, in the unit of the poses. Frames without
    a pose have no line.

    Parameters
    ----------
    result : Reconstruction
    folder : path
        It has to exist. If the sequence has several pieces, the largest is ``trajectory.tum``, the
        next ``trajectory-piece2.tum``, and so on.
    frames : iterable of int, optional
        Frame numbers; by default all.
    frames_per_second : float, optional
        Times are then frame numbers divided by it. By default they are the times of the source, s,
        or frame numbers if these are unknown.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ValueError, IndexError
        If no frame has a pose, or a frame does not exist.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_tum_paths
    >>> [str(file) for file in write_tum_paths(tisfm.Reconstruction.load("walk"), ".")]
    ['trajectory.tum']
    """
    pieces = piece_frames(result, frames)
    times = frame_times(result.times, frames_per_second)
    files = piece_files(Path(folder), TUM, pieces)
    for file, piece in zip(files, pieces, strict=True):
        write_tum(file, result.poses[piece], times[piece], note=result.warning(piece))
    return files


def write_kitti_paths(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    frames: Iterable[int] | None = None,
    frames_per_second: float | None = None,
) -> list[Path]:
    """Write the path for the tools of KITTI and for evo: ``poses.kitti`` and ``poses.times``.

    A line of ``poses.kitti`` has twelve numbers, the rows of (R | t), camera to world; the same
    line of ``poses.times`` has the time of the frame. Frames without a pose have no line in either
    file, because programs stop at a line without numbers.

    Parameters
    ----------
    result, folder, frames, frames_per_second
        As for `write_tum_paths`.

    Returns
    -------
    list of Path
        The files.

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
    pieces = piece_frames(result, frames)
    times = frame_times(result.times, frames_per_second)
    pose_files = piece_files(Path(folder), KITTI, pieces)
    times_files = piece_files(Path(folder), KITTI_TIMES, pieces)
    for file, times_file, piece in zip(pose_files, times_files, pieces, strict=True):
        write_kitti(file, result.poses[piece])
        with atomic_write(times_file) as stream:
            stream.write("".join(f"{time!r}\n" for time in times[piece].tolist()).encode())
    return [*pose_files, *times_files]
