"""Points and surfaces of a reconstruction, as PLY and GLB files."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from tisfm.errors import InputError
from tisfm.exports.export_request import piece_files, piece_frames
from tisfm.formats import atomic_write
from tisfm.formats.glb import glb_points
from tisfm.fusion.agreement import Coverage
from tisfm.point_cloud import PointCloud
from tisfm.reconstruction.result.reconstruction import Reconstruction

Suffix = Literal["ply", "glb"]


def write_points(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    suffix: Suffix = "ply",
    frames: Iterable[int] | None = None,
    coverage: Coverage = "normal",
) -> list[Path]:
    """Write the fused coloured points of the keyframes: ``points.ply`` or ``points.glb``.

    Parameters
    ----------
    result : Reconstruction
    folder : path
        It has to exist. Each piece of a sequence has its own file, as in `write_tum_paths`.
    suffix : {"ply", "glb"}
        PLY has x, y, z, red, green, blue and confidence, in the axes of the world: Y points down.
        GLB has positions and colours, with Y up: Y and Z change sign.
    frames : iterable of int, optional
        The keyframes among these frames are fused, or all of them if there is no keyframe; by
        default all frames.
    coverage : {"normal", "strict", "complete"}
        How much of the surface is kept, as for `tisfm.Reconstruction.points`.

    Returns
    -------
    list of Path
        The files; a piece without points has none.

    Raises
    ------
    ValueError
        If no piece has a point.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_points
    >>> [str(file) for file in write_points(tisfm.Reconstruction.load("walk"), ".", suffix="glb")]
    ['points.glb']
    """
    pieces = piece_frames(result, frames)
    written_files = []
    for file, piece in zip(piece_files(Path(folder), f"points.{suffix}", pieces), pieces,
                           strict=True):  # fmt: skip
        points = result.points(_frames_to_fuse(result, piece), coverage=coverage)
        if len(points):
            save_points(points, file)
            written_files.append(file)
    if not written_files:
        raise InputError(
            f"{result.folder} gives no points, because it has too little depth or none: "
            "reconstruct with --depth-of all, from frames with more parallax"
        )
    return written_files


def write_meshes(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    suffix: Suffix = "ply",
    frames: Iterable[int] | None = None,
    coverage: Coverage = "normal",
) -> list[Path]:
    """Write the fused coloured surface of the keyframes: ``mesh.ply`` or ``mesh.glb``.

    Parameters
    ----------
    result, folder, suffix, frames, coverage
        As for `write_points`.

    Returns
    -------
    list of Path
        The files; a piece without a surface has none.

    Raises
    ------
    ImportError
        If scikit-image is not installed: ``pip install 'tisfm[mesh]'``.
    ValueError
        If no piece has a surface.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_meshes
    >>> [str(file) for file in write_meshes(tisfm.Reconstruction.load("walk"), ".")]
    ['mesh.ply']
    """
    pieces = piece_frames(result, frames)
    written_files = []
    for file, piece in zip(piece_files(Path(folder), f"mesh.{suffix}", pieces), pieces,
                           strict=True):  # fmt: skip
        mesh = result.mesh(_frames_to_fuse(result, piece), coverage=coverage)
        if len(mesh.faces):
            mesh.save(file)
            written_files.append(file)
    if not written_files:
        raise InputError(
            f"{result.folder} gives no surface, because it has too little depth or none: "
            "reconstruct with --depth-of all, from frames with more parallax"
        )
    return written_files


def save_points(points: PointCloud, path: str | os.PathLike[str]) -> None:
    """Write a cloud of points as PLY or GLB, by the suffix, whole or not at all.

    Raises ValueError if the suffix is neither ``.ply`` nor ``.glb``, or a GLB file would be empty.

    Raises OSError if the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".ply":
        points.save(path)
        return
    if suffix != ".glb" or not len(points):
        reason = (
            "a GLB file needs at least one point" if suffix == ".glb" else "expected .ply or .glb"
        )
        raise InputError(f"path is {os.fspath(path)}: {reason}")
    content = glb_points(
        points.positions * np.array([1, -1, -1], np.float32), points.colors, note=points.note
    )
    with atomic_write(path) as file:
        file.write(content)


def _frames_to_fuse(result: Reconstruction, piece: list[int]) -> list[int]:
    """Return the keyframes of a piece, or all its frames if it has no keyframe."""
    return [frame for frame in piece if frame in set(result.keyframes)] or piece
