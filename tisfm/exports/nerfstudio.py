"""A reconstruction as a ``transforms.json`` for nerfstudio and other NeRF trainers."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict
from os import PathLike
from typing import Any

import numpy as np

from tisfm.errors import InputError
from tisfm.exports.colmap import ExportedModel, model_frames, model_summary
from tisfm.exports.model_folder import (
    IMAGES,
    MASKS,
    POINTS,
    TRANSFORMS,
    Images,
    check_images,
    has_masks,
    open_export,
    picture_name,
    write_masks,
    write_pictures,
)
from tisfm.exports.tracks import count_cells, measure_tracks
from tisfm.formats import atomic_write
from tisfm.point_cloud import PointCloud
from tisfm.reconstruction.mapping.database import PIXEL_CENTRE
from tisfm.reconstruction.result.reconstruction import Reconstruction

# From the axes of a reconstruction, Y down, to a world with Z up.
TO_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
OPENGL_AXES = np.diag([1.0, -1, -1, 1])  # axes of a camera: X right, Y up, Z backward


def write_nerfstudio(
    reconstruction: Reconstruction,
    folder: str | PathLike[str],
    *,
    piece: int | None = None,
    images: Images = "copy",
    spacing: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ExportedModel:
    """Write ``transforms.json``, the frames of one piece, and its sparse points.

    Cameras have the axes of OpenGL, X right, Y up, Z backward, in a world whose Z is up in the
    first frame of the piece; ``applied_transform`` leads there from the axes of the reconstruction.
    ``sparse_points.ply`` has the points of measured tracks, as for `write_colmap`, in the same
    world: trainers initialise Gaussian splats with them. With ``motion="objects"``, or with masked
    pixels that move, ``masks/`` has the static scene in white.

    Parameters
    ----------
    reconstruction : Reconstruction
    folder : path
        A new or empty folder, or one with an earlier export, which is replaced at the end.
    piece : int, optional
        By default the largest.
    images : {"copy", "link", "none"}
        Whether ``images/`` has copies of the frames or hard links to them, or is left out.
    spacing : float, optional
        Distance of new points in a frame, px; by default 1/80 of the longer side.
    progress : callable, optional
        Called with the number of finished frames and of all frames.

    Returns
    -------
    ExportedModel
        A summary of the written model.

    Raises
    ------
    ValueError
        If an option is impossible, or no two frames of the piece have poses.
    FileExistsError
        If the folder holds other files.
    FileNotFoundError, tisfm.formats.FormatError
        If files of the reconstruction are missing or damaged.
    OSError
        If the folder cannot be written to, or another run writes to it.

    References
    ----------
    https://docs.nerf.studio/quickstart/data_conventions.html.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_nerfstudio
    >>> model = write_nerfstudio(tisfm.Reconstruction.load("walk"), "nerfstudio")
    >>> model.images
    9
    """
    check_images(images)
    count_cells(reconstruction.shape, spacing)
    pieces = model_frames(reconstruction)
    piece_number = next(iter(pieces)) if piece is None else piece
    if piece_number not in pieces:
        raise InputError(
            f"piece is {piece_number}: expected a piece of several frames, "
            f"{', '.join(map(str, pieces))}"
        )
    frames = pieces[piece_number]
    record: dict[str, Any] = {"kind": "nerfstudio", "version": reconstruction.version}
    with open_export(folder, record) as new_folder:
        tracks = measure_tracks(reconstruction, piece_number, spacing=spacing, progress=progress)
        cloud = PointCloud(
            positions=(tracks.positions @ TO_Z_UP[:3, :3].T).astype(np.float32),
            colors=tracks.colors,
            confidence=np.ones(len(tracks), np.float32),
            note=reconstruction.warning(frames),
        )
        cloud.save(new_folder / POINTS)
        with atomic_write(new_folder / TRANSFORMS) as file:
            file.write(json.dumps(_transforms_record(reconstruction, frames), indent=1).encode())
        if images != "none":
            write_pictures(reconstruction, frames, new_folder / IMAGES, images)
        if has_masks(reconstruction):
            write_masks(reconstruction, frames, new_folder / MASKS, ".png")
        model = model_summary(TRANSFORMS, piece_number, frames, tracks)
        record["models"] = [asdict(model)]
        record["warning"] = reconstruction.warning(frames)
    return model


def _transforms_record(result: Reconstruction, frames: list[int]) -> dict[str, Any]:
    """Return the contents of ``transforms.json``."""
    height, width = result.shape
    focal = result.camera.focal
    cx, cy = result.camera.center_for(height, width)
    entries = []
    for frame in frames:
        name = picture_name(frame)
        entry: dict[str, Any] = {"file_path": f"{IMAGES}/{name}"}
        if has_masks(result):
            entry["mask_path"] = f"{MASKS}/{name.removesuffix('.jpg')}.png"
        entry["transform_matrix"] = (TO_Z_UP @ result.poses[frame] @ OPENGL_AXES).tolist()
        entries.append(entry)
    return {
        "camera_model": "PINHOLE",
        "fl_x": focal,
        "fl_y": focal,
        "cx": cx + PIXEL_CENTRE,
        "cy": cy + PIXEL_CENTRE,
        "w": width,
        "h": height,
        "camera_angle_x": 2 * math.atan(width / (2 * focal)),
        "camera_angle_y": 2 * math.atan(height / (2 * focal)),
        "applied_transform": TO_Z_UP[:3].tolist(),
        "ply_file_path": POINTS,
        **({"tisfm_warning": warning} if (warning := result.warning(frames)) else {}),
        "frames": entries,
    }
