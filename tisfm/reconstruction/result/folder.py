"""The folder of a reconstruction.

``reconstruction.json`` is the last file that is written: a folder without this file is incomplete.
Until then, ``reconstruction.begun`` marks the folder as one of tisfm. ``docs/formats.md`` describes
the files.
"""

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.camera_file import FILE_NAME as CAMERA
from tisfm.errors import InputError
from tisfm.folders.files import REPORT, TIMINGS
from tisfm.folders.result_folder import make_subfolder
from tisfm.formats import FormatError, atomic_write
from tisfm.formats.image_headers import MAX_IMAGE_PIXELS, refuse_large_image
from tisfm.formats.images import decode_with_opencv, write_png
from tisfm.formats.label_picture import read_label_picture, write_label_png
from tisfm.formats.npz import NpzFile, write_npz
from tisfm.formats.reading import read_bytes, read_json
from tisfm.reconstruction.result.calibration import as_json, from_json
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.settings import Settings
from tisfm.status import Status
from tisfm.trajectory.poses import check_poses

FORMAT = 6  # version of the format of the record
OBJECTS_FORMAT = 1  # version of the format of the file of moving objects
RECORD = "reconstruction.json"
MARKER = "reconstruction.begun"
PATH = "path.npz"
DEPTH = "depth"
PICTURES = "frames"
CACHE = "cache"
MASKS = "masks"
OBJECTS = "objects.json"
FIXED_MASK = "mask.png"
MAX_HALF = 60000.0  # largest stored float16 value; the largest possible value is 65504
# Errors from reading damaged JSON, or numbers outside NumPy's range.
_READ_ERRORS = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
PARTS = (RECORD, PATH, DEPTH, PICTURES, CAMERA, MASKS, OBJECTS, FIXED_MASK)
_DEVIATIONS = ("position_deviation", "rotation_deviation")
_HALF_ARRAYS = ("inverse_depth", "inverse_depth_std")
REQUEST = "asked.json"  # the request of `tisfm reconstruct`
OPTIONAL_FILES = (
    REQUEST, "poses.txt", "trajectory.txt", "points.ply", "mesh.ply", "mesh.glb", REPORT, TIMINGS
)  # fmt: skip


def write_depth(
    folder: Path,
    number: int,  # number of the frame
    # inverse_depth, deviation: (H, W) float32; NaN and infinity without depth
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
) -> None:
    """Write the depth of a frame, with 11 significant bits."""
    scale = max_finite(inverse_depth) / MAX_HALF or 1.0
    # A finite deviation stays finite: an infinite one means that depth is filled.
    largest = np.float32(MAX_HALF * scale)
    deviation = np.where(np.isfinite(deviation), np.minimum(deviation, largest), deviation)
    with np.errstate(over="ignore"):
        halves = [
            (values / np.float32(scale)).astype("<f2") for values in (inverse_depth, deviation)
        ]
    arrays = {"inverse_depth": halves[0], "inverse_depth_std": halves[1], "scale": np.array(scale)}
    write_npz(depth_path(folder, number), arrays)


def max_finite(values: np.ndarray) -> float:
    """Return the largest finite value; 0 without finite values."""
    return float(np.max(values, where=np.isfinite(values), initial=0.0))


def read_depth(folder: Path, number: int, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse depth and deviation of a frame, (H, W) float32; NaN, infinity without depth.

    Raises FileNotFoundError if the depth folder is missing.

    Raises tisfm.formats.FormatError if the file is damaged.
    """
    path = depth_path(folder, number)
    if not path.exists():
        if not path.parent.is_dir():
            raise FileNotFoundError(f"there is no {path.parent}: the folder is not complete")
        return np.full(shape, np.nan, np.float32), np.full(shape, np.inf, np.float32)
    with NpzFile(path) as file:
        for name in (*_HALF_ARRAYS, "scale"):
            layout = file.header(name)
            expected = (shape, np.dtype("<f2")) if name in _HALF_ARRAYS else ((), np.dtype("<f8"))
            if layout != expected:
                raise FormatError(f"{path} has {name} of {layout}: expected {expected}")
        scale = np.float32(file.read("scale"))
        if not (np.isfinite(scale) and scale > 0):
            raise FormatError(f"{path} has the scale {scale}: expected a finite positive number")
        arrays = [file.read(name) for name in _HALF_ARRAYS]
    inverse_depth, deviation = (values.astype(np.float32) * scale for values in arrays)
    return inverse_depth, deviation


def write_labels(folder: Path, number: int, labels: np.ndarray) -> None:
    """Write the object id of each pixel of a frame, (H, W) uint8."""
    make_subfolder(folder / MASKS)
    write_label_png(mask_path(folder, number), labels)


def read_labels(folder: Path, number: int, shape: tuple[int, int]) -> np.ndarray:
    """Return the object id of each pixel of a frame, (H, W) uint8; 0 without labels."""
    path = mask_path(folder, number)
    if not has_labels(folder):
        return np.zeros(shape, np.uint8)
    labels = read_label_picture(path)
    if labels.shape != shape:
        raise FormatError(f"{path} is {labels.shape}: expected {shape}")
    return labels


def has_labels(folder: Path) -> bool:
    """Return whether a result has object ids of the pixels of its frames."""
    return (folder / MASKS).is_dir()


def delete_labels(folder: Path) -> None:
    """Delete the object ids of the pixels of all frames."""
    shutil.rmtree(folder / MASKS, ignore_errors=True)


def write_mask(folder: Path, mask: np.ndarray) -> None:
    """Write the pixels that are masked in all frames, (H, W) bool: black in a PNG."""
    write_png(folder / FIXED_MASK, np.where(mask, 0, 255).astype(np.uint8))


def read_mask(folder: Path, shape: tuple[int, int]) -> np.ndarray | None:
    """Return the pixels that are masked in all frames, (H, W) bool; None if there are none."""
    path = folder / FIXED_MASK
    if not path.exists():
        return None
    data = read_bytes(path)
    refuse_large_image(str(path), data)
    picture = decode_with_opencv(str(path), data, cv2.IMREAD_GRAYSCALE)
    if picture is None or picture.shape != shape:
        raise FormatError(f"{path} is damaged: it is not a mask of {shape[1]}×{shape[0]} px")
    return np.asarray(picture == 0)


def mask_path(folder: Path, number: int) -> Path:
    """Return the path of the labels of a frame."""
    return folder / MASKS / f"{number:06d}.png"


def write_objects(folder: Path, objects: Sequence[MovingObject]) -> None:
    """Write the moving objects as JSON."""
    record = {"format": OBJECTS_FORMAT, "objects": [obj.as_json() for obj in objects]}
    with atomic_write(folder / OBJECTS) as file:
        file.write(json.dumps(record, allow_nan=False).encode())


def _read_objects(folder: Path, settings: Settings, count: int) -> tuple[MovingObject, ...]:
    """Return the moving objects of a folder; none without ``motion="objects"``."""
    path = folder / OBJECTS
    if settings.motion != "objects":
        return ()
    for part in (path, folder / MASKS):
        if not part.exists():
            raise FormatError(f"{folder} has no {part.name}: it is not complete")
    with _raise_format_error(path):
        record = read_json(path)
        if record["format"] != OBJECTS_FORMAT:
            raise InputError(
                f"it is of format {record['format']}, this version reads {OBJECTS_FORMAT}: "
                "reconstruct the source again"
            )
        objects = tuple(MovingObject.from_json(obj) for obj in record["objects"])
        for obj in objects:
            if not set(obj.frames) <= set(range(count)):
                raise InputError(f"object {obj.id} is labelled in frames that do not exist")
    return objects


def depth_path(folder: Path, number: int) -> Path:
    """Return the path of the depth of a frame."""
    return folder / DEPTH / f"{number:06d}.npz"


def read_picture(folder: Path, number: int) -> np.ndarray:
    """Return the picture of a frame, (H, W) or (H, W, 3) RGB uint8."""
    path = folder / PICTURES / f"{number:06d}.jpg"
    if not path.exists():
        raise FileNotFoundError(f"there is no {path}: the folder is not complete")
    data = read_bytes(path)
    refuse_large_image(str(path), data)
    picture = decode_with_opencv(str(path), data, cv2.IMREAD_UNCHANGED)
    if picture is None or picture.dtype != np.uint8 or picture.shape[2:] not in ((), (3,)):
        raise FormatError(f"{path} is damaged: it is not a picture with 8 bits")
    return picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def write_record(folder: Path, result: Any) -> None:
    """Write the path of a reconstruction, and last the record."""
    times = np.array([np.nan if time is None else time for time in result.times])
    path = {
        "poses": result.poses,
        "piece": result.piece,
        "times": times,
        "unit": np.array(result.unit, np.float64),
        "position_deviation": result.position_deviation,
        "rotation_deviation": result.rotation_deviation,
    }
    write_npz(folder / PATH, path)
    record = {
        "format": FORMAT,
        "version": result.version,
        "camera": asdict(result.camera),
        "calibration": as_json(result.calibration),
        "zoom": None if result.zoom is None else result.zoom.tolist(),
        "settings": asdict(result.settings),
        "shape": list(result.shape),
        "names": list(result.names),
        "status": [[str(status), status.message] for status in result.status],
        "grade": [str(grade) for grade in result.grades],  # for other programs
        "depth_error": [
            None if np.isnan(error) else error for error in result.depth_error.tolist()
        ],
        "depth_share": result.depth_share.tolist(),
        "keyframes": list(result.keyframes),
        "skipped": [list(item) for item in result.skipped],
        "notes": list(result.notes),
        "checks": [check.as_json() for check in result.checks],
    }
    if result.settings.motion == "objects":
        write_objects(folder, result.objects)
    with atomic_write(folder / RECORD) as file:
        file.write(json.dumps(record, indent=1).encode())
    (folder / MARKER).unlink(missing_ok=True)


def read_record(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the fields of a reconstruction that `write_record` wrote.

    Raises FileNotFoundError if it is not the folder of a complete reconstruction.

    Raises tisfm.formats.FormatError if a file is damaged, or of a format this version cannot read.
    """
    path = Path(folder)
    if not (path / RECORD).is_file():
        reason = "is not complete" if (path / DEPTH).is_dir() else "has no reconstruction"
        raise FileNotFoundError(f"the folder {path} {reason}: it has no {RECORD}")
    with _raise_format_error(path / RECORD):
        record = read_json(path / RECORD)
        if record["format"] != FORMAT:
            raise InputError(
                f"it is of format {record['format']}, written by tisfm {record.get('version')}; "
                f"this version reads format {FORMAT}: reconstruct the source again"
            )
        dtype_kinds = {"poses": "f", "piece": "i", "times": "f", "unit": "f"}
        dtype_kinds |= dict.fromkeys(_DEVIATIONS, "f")
        with NpzFile(path / PATH) as file:
            arrays = {name: file.read(name) for name in dtype_kinds}
        for name, values in arrays.items():
            if values.dtype.kind != dtype_kinds[name]:
                raise InputError(f"{name} of {PATH} has the type {values.dtype}")
        poses, piece, times, unit, *deviations = arrays.values()
        count = len(record["names"])
        if poses.shape != (count, 4, 4) or piece.shape != (count,) or times.shape != (count,):
            raise InputError(f"{PATH} does not have {count} frames")
        _check_deviations(deviations, count)
        if unit.shape != (int(piece.max(initial=-1)) + 1,):
            raise InputError(f"{PATH} does not have a unit for every piece")
        if len(record["status"]) != count:
            raise InputError(f"it has {len(record['status'])} statuses for {count} frames")
        if not set(record["keyframes"]) <= set(range(count)):
            raise InputError(f"a keyframe has a number that is not below {count}")
        camera = record["camera"]
        stiffness = tuple(record["settings"]["stiffness"])
        settings = Settings(**{**record["settings"], "stiffness": stiffness})
        return dict(
            poses=check_poses(poses),
            piece=piece.astype(np.int32),
            unit=tuple(map(float, unit)),
            **dict(zip(_DEVIATIONS, deviations, strict=True)),
            depth_error=_read_shares(record, "depth_error", count),
            depth_share=_read_shares(record, "depth_share", count),
            times=tuple(None if np.isnan(time) else float(time) for time in times),
            status=tuple(Status(code, message) for code, message in record["status"]),
            keyframes=tuple(int(k) for k in record["keyframes"]),
            skipped=tuple((int(index), str(reason)) for index, reason in record["skipped"]),
            notes=tuple(map(str, record["notes"])),
            names=tuple(map(str, record["names"])),
            shape=_shape(record["shape"]),
            camera=Camera(
                focal=camera["focal"],
                center=None if camera["center"] is None else tuple(camera["center"]),
                distortion=camera["distortion"],
                aspect=camera["aspect"],
                readout=camera["readout"],
            ),
            calibration=from_json(record["calibration"]),
            zoom=_read_zoom(record, count),
            settings=settings,
            version=str(record["version"]),
            objects=_read_objects(path, settings, count),
            checks=tuple(PathCheck.from_json(check) for check in record["checks"]),
        )


def _read_shares(record: dict[str, Any], name: str, count: int) -> np.ndarray:
    """Return numbers of a record from 0 to 1, one a frame, (N,) float64; NaN for null."""
    values = np.array([np.nan if x is None else float(x) for x in record[name]], np.float64)
    if values.shape != (count,):
        raise InputError(f"{name} has {len(values)} numbers for {count} frames")
    if not (np.isnan(values) | ((values >= 0) & (values <= 1))).all():
        raise InputError(f"{name} has a number that is not from 0 to 1")
    return values


def _check_deviations(deviations: Sequence[np.ndarray], count: int) -> None:
    """Refuse deviations of poses that are not (N, 3), or negative; NaN is allowed."""
    for name, values in zip(_DEVIATIONS, deviations, strict=True):
        if values.shape != (count, 3):
            raise InputError(f"{name} of {PATH} is {values.shape}: expected {(count, 3)}")
        if (values < 0).any():
            raise InputError(f"{name} of {PATH} has a negative number")


def _read_zoom(record: dict[str, Any], count: int) -> np.ndarray | None:
    """Return the zoom of each frame of a record, (N,) float64; None if it is constant."""
    if record["zoom"] is None:
        return None
    zoom = np.array([float(value) for value in record["zoom"]], np.float64)
    if zoom.shape != (count,):
        raise InputError(f"zoom has {len(zoom)} numbers for {count} frames")
    if not (np.isfinite(zoom) & (zoom > 0)).all():
        raise InputError("zoom has a number that is not positive and finite")
    return zoom


@contextmanager
def _raise_format_error(path: Path) -> Iterator[None]:
    try:
        yield
    except FormatError:
        raise
    except _READ_ERRORS as error:
        reason = " ".join(str(error).split())
        raise FormatError(f"{path} is damaged or of another kind: {reason}") from error


def _shape(values: Any) -> tuple[int, int]:
    """Return height and width of frames; ValueError for other values."""
    height, width = map(int, values)
    if height < 1 or width < 1 or height * width > MAX_IMAGE_PIXELS:
        raise InputError(
            f"its frames are {height} × {width} px: expected 1 to {MAX_IMAGE_PIXELS} px"
        )
    return height, width
