"""The moving camera for Blender and Nuke, and its lens."""

import json
import math
import os
import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tisfm.exports.camera_axes import lens_record, vertical_angle, y_up
from tisfm.exports.clock import frame_rate
from tisfm.exports.gltf import camera_document
from tisfm.exports.pieces import chosen_frames, piece_files, pieces_of
from tisfm.formats import atomic_write
from tisfm.reconstruction.result.reconstruction import Reconstruction

GLTF, CHAN, LENS = "camera.gltf", "camera.chan", "lens.json"


def write_gltf_cameras(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    frames: Iterable[int] | None = None,
    frames_per_second: float | None = None,
) -> list[Path]:
    """Write the camera as an animation, ``camera.gltf``, and its lens, ``lens.json``.

    Y points up, the camera looks along −Z, as in the GLB files of points and meshes. Frame n is
    shown at n / `frames_per_second` seconds; between frames with a pose, programs interpolate.

    Parameters
    ----------
    result : Reconstruction
    folder : path
        It has to exist. Each piece of a sequence has a file of its own, as in `write_tum_paths`.
    frames : iterable of int, optional
        Numbers of frames; by default all.
    frames_per_second : float, optional
        By default what the times of the source say, or 25.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ValueError, IndexError
        If no frame has a pose, or there is no such frame; if the frame rate is none.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_gltf_cameras
    >>> [str(file) for file in write_gltf_cameras(tisfm.Reconstruction.load("walk"), ".")]
    ['camera.gltf', 'lens.json']
    """
    chosen = chosen_frames(frames, len(result))
    pieces = pieces_of(result, chosen)
    rate = frame_rate(result.times, range(len(result)), frames_per_second)
    height, width = result.shape
    files = piece_files(Path(folder), GLTF, pieces)
    about = {**lens_record(result.camera, result.shape), "frames_per_second": rate}
    for file, piece in zip(files, pieces, strict=True):
        document = camera_document(
            y_up(result.poses[piece]),
            np.array(piece) / rate,
            vertical_angle=vertical_angle(result.camera, height),
            aspect=width / height,
            about=about,
        )
        with atomic_write(file) as stream:
            stream.write(document)
    return [*files, _write_lens(result, Path(folder))]


def write_chan(
    result: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    frames: Iterable[int] | None = None,
) -> list[Path]:
    """Write the camera as Nuke reads it, ``camera.chan``, and its lens, ``lens.json``.

    A line has frame tx ty tz rx ry rz vfov. Y points up, the camera looks along −Z; angles are
    degrees, in the rotation order ZXY: about Z first, then X, then Y. Frames have their numbers,
    from 0; those without a pose have no line.

    Parameters
    ----------
    result, folder, frames
        As for `write_gltf_cameras`.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ValueError, IndexError, OSError
        As for `write_gltf_cameras`.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_chan
    >>> [str(file) for file in write_chan(tisfm.Reconstruction.load("walk"), ".")]
    ['camera.chan', 'lens.json']
    """
    pieces = pieces_of(result, frames)
    angle = math.degrees(vertical_angle(result.camera, result.shape[0]))
    files = piece_files(Path(folder), CHAN, pieces)
    for file, piece in zip(files, pieces, strict=True):
        poses = y_up(result.poses[piece])
        rows = np.column_stack([poses[:, :3, 3], _zxy_degrees(poses[:, :3, :3])]).tolist()
        text = "".join(
            f"{frame} {' '.join(map(repr, row))} {angle!r}\n"
            for frame, row in zip(piece, rows, strict=True)
        )
        with atomic_write(file) as stream:
            stream.write(text.encode())
    return [*files, _write_lens(result, Path(folder))]


def _zxy_degrees(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles rx, ry, rz of R = Ry Rx Rz, (N, 3), degrees, without jumps of a turn."""
    with warnings.catch_warnings():  # looking straight up, one of many answers is taken
        warnings.simplefilter("ignore", UserWarning)
        turned = Rotation.from_matrix(rotations).as_euler("YXZ")
    return np.degrees(np.unwrap(turned, axis=0)[:, [1, 0, 2]])


def _write_lens(result: Reconstruction, folder: Path) -> Path:
    file = folder / LENS
    with atomic_write(file) as stream:
        stream.write((json.dumps(lens_record(result.camera, result.shape), indent=1)).encode())
    return file
