"""Writing and reading the file of an interpretation, with all checks when it is read.

`docs/formats.md` describes the file.
"""

import json
import math
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.checks import refuse_masked
from tisfm.errors import InputError, OutOfMemoryError
from tisfm.formats import FormatError
from tisfm.formats.npz import NpzFile, write_npz
from tisfm.formats.packing import STEP, Packing, pack, unpack
from tisfm.frames import MIN_SIDE
from tisfm.settings import Settings
from tisfm.status import History, Status

FORMAT = 9  # increased with every change of the entries; earlier files are refused
_MAX_PIXELS = 2**24  # pixels of a packed frame, unless the file has more bytes than this
_MAX_ABOUT_BYTES = 2**20  # bytes of the entry "about", which usually has a thousandth of that
_MAX_HALF = 65504.0  # largest number of float16
_HISTORY_ENTRIES = tuple(f"history_{record.name}" for record in fields(History))
_REQUIRED_ARRAYS = ("rho", "flow", "inverse_depth", "confidence", "occlusion", "frame")
_RIGID_ARRAYS = ("inverse_depth_std", "motions", "labels")  # stored unless motion="field"
_ENTRIES = ("about", *_REQUIRED_ARRAYS, *_RIGID_ARRAYS, *_HISTORY_ENTRIES)
_ABOUT_ENTRIES = (
    "format", "version", "camera", "settings", "status", "message", "packed", "focal_deviation",
    "focal_effect", "focal_spread",
)  # fmt: skip
# Numbers about the focal length, and their values where the file has null.
_FOCAL_NUMBERS = {"focal_deviation": math.inf, "focal_effect": math.nan, "focal_spread": math.nan}
_RIGID_STATUSES = (
    "pose_mismatch", "little_parallax", "pure_rotation", "two_motions", "behind_camera",
    "unexplained", "uncertain", "contradicted",
)  # fmt: skip
_STATUSES_WITHOUT_DEPTH = (
    "no_motion", "no_texture", "little_parallax", "pure_rotation", "unrelated", "aperture",
)  # fmt: skip
_STATUSES_WITHOUT_MOTION = ("no_motion", "no_texture")  # no depth either, even for motion="field"
_UNUSABLE_STATUSES = ("diverged", "pose_mismatch")  # statuses whose numbers may be useless

_FLOAT16, _FLOAT32, _FLOAT64, _INT32 = (np.dtype(kind) for kind in ("<f2", "<f4", "<f8", "<i4"))
_MEMORY_TYPES = {
    "rho": _FLOAT32,
    "flow": _FLOAT32,
    "inverse_depth": _FLOAT32,
    "inverse_depth_std": _FLOAT32,
    "confidence": _FLOAT32,
    "occlusion": np.dtype(np.bool_),
    "labels": _INT32,
    "motions": _FLOAT64,
    "frame": np.dtype("u1"),
    "history_level": _INT32,
    "history_warp": _INT32,
    "history_energy": _FLOAT64,
    "history_half_quadratic": _FLOAT64,
    "history_change": _FLOAT64,
}
_STORED_TYPES = {name: (kind,) for name, kind in _MEMORY_TYPES.items()} | {
    "rho": (_FLOAT16, _FLOAT32),
    "confidence": (_FLOAT16,),
    "labels": (np.dtype("u1"), np.dtype("<u2"), _INT32),
}
_FIXED_POINT_TYPES, _TRUNCATED_TYPES = ("int16", "int32"), ("uint32",)
_PACKED_TYPES = {  # integer types that each array may be packed as
    "rho": _FIXED_POINT_TYPES,
    "flow": _FIXED_POINT_TYPES,
    "confidence": _FIXED_POINT_TYPES,
    "inverse_depth": _TRUNCATED_TYPES,
    "inverse_depth_std": _TRUNCATED_TYPES,
    "occlusion": ("uint8",),
    "labels": ("uint8", "uint16", "int32"),
    "frame": ("uint8",),
}


def write_interpretation(
    path: str | os.PathLike[str], result: Any, *, compact: bool = False
) -> None:
    """Write a result to an ``.npz`` file; see `Interpretation.save`."""
    about: dict[str, Any] = {
        "format": FORMAT,
        "version": result.version,
        "camera": asdict(result.camera),
        "settings": asdict(result.settings),
        "status": str(result.status),
        "message": result.status.message,
        "packed": {},
        **{name: _number_or_none(getattr(result, name)) for name in _FOCAL_NUMBERS},
    }
    arrays = {name: getattr(result, name) for name in (*_REQUIRED_ARRAYS, *_RIGID_ARRAYS)}
    arrays.update({f"history_{name}": array for name, array in vars(result.history).items()})
    stored_arrays = {name: array for name, array in arrays.items() if array is not None}
    for name, array in stored_arrays.items():
        refuse_masked(array, name)
    layout = {name: (array.shape, array.dtype) for name, array in stored_arrays.items()}
    _check_layout(layout, {name: (kind,) for name, kind in _MEMORY_TYPES.items()}, result.settings)
    _check_values(stored_arrays, result.status)
    if "labels" in stored_arrays:
        max_label = len(stored_arrays["motions"]) - 1
        kinds = (kind for kind in _STORED_TYPES["labels"] if max_label <= np.iinfo(kind).max)
        stored_arrays["labels"] = stored_arrays["labels"].astype(next(kinds))
    if compact and str(result.status) not in _UNUSABLE_STATUSES:
        _pack(stored_arrays, about["packed"])
    if "rho" not in about["packed"] and (
        max(stored_arrays["rho"].max(), -stored_arrays["rho"].min()) <= _MAX_HALF  # False for NaN
    ):
        stored_arrays["rho"] = _round_to_half(stored_arrays["rho"])
    if "confidence" not in about["packed"]:
        stored_arrays["confidence"] = _round_to_half(stored_arrays["confidence"])
    write_npz(path, {"about": np.array(json.dumps(about)), **stored_arrays})


def _pack(arrays: dict[str, NDArray[Any]], packed: dict[str, Any]) -> None:
    """Pack the arrays that can be packed; both arguments are modified in place."""
    for name, kinds in _PACKED_TYPES.items():
        if name not in arrays:
            continue
        step = STEP if kinds == _FIXED_POINT_TYPES else None
        array = arrays[name]
        if name == "confidence":  # positive values must not be rounded to 0
            array = np.maximum(array, np.float32(STEP), out=array.copy(), where=array > 0)
        result = pack(array, row_axis=_row_axis(name), step=step)
        if result is not None:
            arrays[name], packing = result
            packed[name] = packing.to_json()


def _row_axis(name: str) -> int:
    """Return the axis of image rows of an array: 1 for (6, H, W), else 0."""
    return 1 if name == "rho" else 0


def read_interpretation(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the fields of a file that `write_interpretation` wrote; see `Interpretation.load`."""
    name = os.fspath(path)
    try:
        with NpzFile(path) as file:
            try:
                return _read(file)
            except ValueError as error:
                reason = " ".join(str(error).split()).removeprefix(f"{name} ")
                raise FormatError(
                    f"{name} is not a complete interpretation written by tisfm: {reason}"
                ) from error
    except MemoryError as error:
        raise OutOfMemoryError(
            f"there is not enough memory to load {name}, of {os.path.getsize(name):,} bytes"
        ) from error


def _read(file: NpzFile) -> dict[str, Any]:
    about = _read_about(file)
    file.require_only(_ENTRIES)
    missing_names = sorted({*_REQUIRED_ARRAYS, *_HISTORY_ENTRIES}.difference(file))
    if missing_names:
        raise InputError(f"it has no {', '.join(missing_names)}")
    camera, settings = _read_camera(about["camera"]), _read_settings(about["settings"])
    packings = _read_packings(file, about["packed"])
    names = [name for name in _MEMORY_TYPES if name in file]
    layout = {
        name: (packings[name].shape, packings[name].dtype)
        if name in packings
        else file.header(name)
        for name in names
    }
    kinds = {name: (packing.dtype,) for name, packing in packings.items()}
    _check_layout(layout, _STORED_TYPES | kinds, settings)
    if packings:
        _refuse_too_many_pixels(file, layout["frame"][0])
    arrays = {name: _read_array(file, name, packings.get(name)) for name in names}
    _check_values(arrays, about["status"])
    history = {name: arrays.pop(name) for name in _HISTORY_ENTRIES}
    return dict(
        **arrays,
        camera=camera,
        settings=settings,
        status=Status(about["status"], about["message"]),
        history=History(
            **{name.removeprefix("history_"): array for name, array in history.items()}
        ),
        version=about["version"],
        **{
            name: unknown if about[name] is None else float(about[name])
            for name, unknown in _FOCAL_NUMBERS.items()
        },
    )


def _number_or_none(number: float) -> float | None:
    """Return a number as JSON has it: None in place of a number that is not finite."""
    return float(number) if np.isfinite(number) else None


def _read_packings(file: NpzFile, about: Any) -> dict[str, Packing]:
    """Return the packing of each packed array, by its name."""
    if not isinstance(about, dict) or not set(about) <= set(_PACKED_TYPES):
        raise InputError(
            f"its entry 'packed' is {about!r}, expected a dict of packings, whose keys are some of "
            f"{', '.join(_PACKED_TYPES)}: the file is damaged, so copy it again"
        )
    packings = {}
    for name, packing in about.items():
        try:
            packings[name] = Packing.from_json(packing, _PACKED_TYPES[name])
        except ValueError as error:
            raise InputError(f"{name} {error}") from error
        stored_shape, stored_type = file.header(name)
        if len(stored_shape) != 1 or stored_type != np.uint8:
            raise InputError(
                f"{name} is {stored_shape} {stored_type}, expected (N,) uint8, as it is packed"
            )
    return packings


def _refuse_too_many_pixels(file: NpzFile, frame_shape: tuple[int, ...]) -> None:
    """Refuse a small file with a huge frame: the size of the frame is the size of all maps."""
    pixels = frame_shape[0] * frame_shape[1]
    if pixels > max(_MAX_PIXELS, file.length):
        raise InputError(f"it has {pixels:,} pixels packed in {file.length:,} bytes")


def _read_array(file: NpzFile, name: str, packing: Packing | None) -> NDArray[Any]:
    """Return an array, unpacked and in its type in memory."""
    if packing is None:
        return file.read(name).astype(_MEMORY_TYPES[name], copy=False)
    try:
        return unpack(file.read(name), packing, _MEMORY_TYPES[name], row_axis=_row_axis(name))
    except ValueError as error:
        raise InputError(f"{name} {error}") from error


def _read_about(file: NpzFile) -> dict[str, Any]:
    """Return the entry "about", after the checks that need no other entry."""
    if "about" not in file:
        missing_names = sorted({"about", *_REQUIRED_ARRAYS}.difference(file))
        raise InputError(f"it has no {', '.join(missing_names)}")
    text = file.read("about", max_bytes=_MAX_ABOUT_BYTES)
    if text.dtype.kind != "U" or text.shape != ():
        raise InputError(
            f"its entry 'about' is an array of the shape {text.shape} and the type {text.dtype}, "
            "expected a single text: the file is damaged, so copy it again"
        )
    # NumPy accepts any numbers as characters, but Python's own functions fail on some.
    characters = np.frombuffer(text.tobytes(), np.dtype("u4").newbyteorder(text.dtype.byteorder))
    if (characters > sys.maxunicode).any():
        raise InputError("about has characters that Unicode does not define")
    try:
        about = json.loads(str(text))
    except RecursionError as error:
        raise InputError("about is nested too deeply") from error
    if not isinstance(about, dict):
        raise InputError(f"about is {about!r}, expected an object of JSON")
    if "format" in about and (about["format"] != FORMAT or type(about["format"]) is not int):
        raise InputError(
            f"its format is {about['format']!r} and this version reads format {FORMAT}: tisfm "
            f"{about.get('version')} wrote it; compute the interpretation again"
        )
    _check_names("about", about, _ABOUT_ENTRIES)
    for name in ("version", "status", "message"):
        if not isinstance(about[name], str):
            raise InputError(f"its {name} is {about[name]!r}, expected text")
    for name in _FOCAL_NUMBERS:
        number = about[name]
        if number is not None and not (
            isinstance(number, (int, float)) and not isinstance(number, bool) and number >= 0
        ):
            raise InputError(f"its {name} is {number!r}, expected 0 or more, or null")
    return about


def _read_camera(about: Any) -> Camera:
    """Return the camera; raise ValueError if an entry is missing or wrong."""
    _check_names("its camera", about, [part.name for part in fields(Camera)])
    try:
        return Camera(**about)
    except TypeError as error:
        raise InputError(str(error)) from error


def _read_settings(about: Any) -> Settings:
    """Return the settings; a missing setting is an error, as its default may have changed."""
    _check_names("its settings", about, [setting.name for setting in fields(Settings)])
    try:
        return Settings(**about)
    except TypeError as error:
        raise InputError(str(error)) from error


def _check_names(owner: str, values: Any, names: Iterable[str]) -> None:
    if not isinstance(values, dict):
        raise InputError(f"{owner} is {values!r}: expected an object of JSON")
    missing_names, unknown_names = set(names).difference(values), set(values).difference(names)
    if missing_names:
        raise InputError(f"missing in {owner}: {', '.join(sorted(missing_names))}")
    if unknown_names:
        raise InputError(f"unknown in {owner}: {', '.join(sorted(unknown_names))}")


def _check_layout(
    layout: Mapping[str, tuple[tuple[int, ...], np.dtype]],
    types: Mapping[str, tuple[np.dtype, ...]],
    settings: Settings,
) -> None:
    """Raise ValueError unless shapes and types fit each other and the settings."""
    frame_shape = layout["frame"][0]
    if (
        len(frame_shape) not in (2, 3)
        or min(frame_shape[:2]) < MIN_SIDE
        or frame_shape[2:] not in ((), (3,))
    ):
        raise InputError(
            f"frame is {frame_shape}, expected (H, W) or (H, W, 3) with sides of at least "
            f"{MIN_SIDE} px"
        )
    rigid_arrays = [name for name in _RIGID_ARRAYS if name in layout]
    if rigid_arrays != ([] if settings.motion == "field" else list(_RIGID_ARRAYS)):
        raise InputError(
            f"it has {', '.join(rigid_arrays) or 'no motions'}, but its settings say motion="
            f'"{settings.motion}": expected {", ".join(_RIGID_ARRAYS)} for rigid motions and none '
            "of them for a field"
        )
    height, width = frame_shape[:2]
    (iteration_count, *_) = (*layout["history_level"][0], 0)
    (motion_count, *_) = (*layout.get("motions", ((), None))[0], 0)
    if rigid_arrays and not motion_count:
        raise InputError("motions is empty, expected at least one motion, (K, 6)")
    shapes: dict[str, tuple[int, ...]] = {
        "frame": frame_shape,
        "rho": (6, height, width),
        "flow": (height, width, 2),
        "motions": (motion_count, 6),
        **{name: (iteration_count,) for name in _HISTORY_ENTRIES},
    }
    for name, (shape, kind) in layout.items():
        expected_shape = shapes.get(name, (height, width))
        if shape != expected_shape or kind not in types[name]:
            expected_types = " or ".join(str(kind) for kind in types[name])
            raise InputError(
                f"{name} is {shape} {kind}, expected {expected_shape} {expected_types}"
            )


def _check_values(arrays: Mapping[str, NDArray[Any]], status: str) -> None:
    """Raise ValueError unless the values fit each other and the status."""
    if "labels" in arrays:
        motion_count = len(arrays["motions"])
        min_label, max_label = arrays["labels"].min(), arrays["labels"].max()
        if min_label < 0 or max_label >= motion_count:
            raise InputError(
                f"labels are {min_label} to {max_label}, expected 0 to {motion_count - 1}"
            )
    if arrays["occlusion"].view(np.uint8).max() > 1:
        raise InputError("occlusion has bytes other than 0 and 1")
    for name in ("history_level", "history_warp"):
        if (arrays[name] < 0).any():
            raise InputError(f"{name} is negative at {np.argmax(arrays[name] < 0)}")
    if status in _RIGID_STATUSES and "motions" not in arrays:
        raise InputError(f'the status {status!r} does not occur with motion="field"')
    if status in _UNUSABLE_STATUSES:
        return
    confidence = arrays["confidence"]
    if not (confidence.min() >= 0 and confidence.max() <= 1):  # NaN fails as well
        raise InputError(
            f"confidence is {confidence.min():g} to {confidence.max():g}, expected 0 to 1"
        )
    if confidence[arrays["occlusion"]].any():
        raise InputError("confidence is above 0 at an occluded pixel")
    for name in ("rho", "flow", "inverse_depth", "motions"):
        if name in arrays and not np.isfinite(arrays[name]).all():
            raise InputError(f"{name} is not finite everywhere, but the status is {status!r}")
    if "inverse_depth_std" in arrays and not arrays["inverse_depth_std"].min() > 0:
        raise InputError("inverse_depth_std is not positive everywhere")
    for name in ("history_energy", "history_half_quadratic", "history_change"):
        if np.isnan(arrays[name]).any():  # infinity is allowed: an energy may overflow
            raise InputError(f"{name} is NaN, but the status is {status!r}")
    without_depth = _STATUSES_WITHOUT_DEPTH if "motions" in arrays else _STATUSES_WITHOUT_MOTION
    if not (np.isfinite(arrays["history_change"]) & (arrays["history_change"] >= 0)).all():
        raise InputError("history_change is negative or infinite: expected lengths of changes")
    if status in without_depth and arrays["inverse_depth"].any():
        raise InputError(f"inverse_depth is not 0 everywhere, but the status is {status!r}")


def _round_to_half(array: NDArray[np.float32]) -> NDArray[np.float16]:
    """Round to 11 significant bits, and to 2⁻²⁴ where the numbers are tiny."""
    flat_array = np.ascontiguousarray(array).reshape(-1, array.shape[-1])
    try:
        # Several times as fast as NumPy. −0 leaves every number as it is; 0 would change −0.
        rounded = cv2.add(flat_array, -0.0, dtype=cv2.CV_16F)  # type: ignore[call-overload]
    except cv2.error:  # this version of OpenCV cannot convert to float16
        rounded = flat_array.astype(np.float16)
    return rounded.reshape(array.shape)
