"""Arrays in few bytes: rounded, as differences of rows, split into byte planes, and deflated.

The low bytes of a measured number are noise, which no method compresses. Its high bytes change
little from one row to the next. NumPy's compressed .npz files mix both. Packed, the files of a run
are a quarter as long as the arrays themselves, and ISA-L's deflate takes a fifth to a tenth of
zlib's time: hence a format of our own, which ``docs/formats.md`` describes.
"""

import math
import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from tisfm.errors import InputError

STEP = 2.0**-10
"""Step that values are rounded to: image motion, px/frame, and values from 0 to 1."""

SIGNIFICANT_BITS = 12
"""Significant bits of a number that is rounded without a step."""

_DROPPED_BITS = 24 - SIGNIFICANT_BITS  # float32 has 24 significant bits
_COMPRESSION_LEVEL = 1  # of ISA-L's levels 0 to 3
_MAX_STEPS = 2.0**30  # largest value in steps: it fits int32
_MAX_FLOAT = 3e38  # rounding a larger float32 may give infinity
_FIXED_POINT_TYPES = ("int16", "int32")
_BLOCK_SIZE = 2**17  # bytes that are processed at a time: they stay in the cache


@dataclass(frozen=True, kw_only=True)
class Packing:
    """How an array was packed."""

    shape: tuple[int, ...]
    integer_type: str  # type of the integers in the stream: uint8, uint16, int16, int32 or uint32
    # Factor from the integers to the values of a float32 array. None if the integers are the array
    # itself, or (uint32 for float32) its sign, exponent and leading bits.
    step: float | None

    @property
    def dtype(self) -> np.dtype:
        """The type of the integers."""
        return np.dtype(self.integer_type).newbyteorder("<")

    def to_json(self) -> dict[str, Any]:
        """Return a dict for `from_json`."""
        return {"shape": list(self.shape), "of": self.integer_type, "step": self.step}

    @classmethod
    def from_json(cls, about: Any, types: Collection[str]) -> "Packing":
        """Return the packing that `to_json` wrote; its integers must be of one of these types.

        Raises ValueError if `about` is anything else.
        """
        if not isinstance(about, dict) or set(about) != {"shape", "of", "step"}:
            raise InputError(
                f"has the packing {about!r}, expected a dict with the keys 'shape', 'of' and "
                "'step': the file is damaged, so copy it again"
            )
        shape, integer_type, step = about["shape"], about["of"], about["step"]
        if not isinstance(shape, list) or any(type(side) is not int or side < 1 for side in shape):
            raise InputError(
                f"has the packed shape {shape!r}: expected a list of positive whole numbers, such "
                "as [480, 640]"
            )
        if integer_type not in types:
            raise InputError(f"is packed as {integer_type!r}, expected {' or '.join(types)}")
        if integer_type in _FIXED_POINT_TYPES and types == _FIXED_POINT_TYPES:
            if not (isinstance(step, float) and 0 < step <= 1):
                raise InputError(f"is packed in steps of {step!r}, expected 0 to 1")
        elif step is not None:
            raise InputError(f"is packed in steps of {step!r}, expected none")
        return cls(shape=tuple(shape), integer_type=integer_type, step=step)


def pack(
    array: NDArray[Any],  # ndarray of float32, or of integers or booleans of at most 4 bytes
    *,
    row_axis: int,  # the axis along which differences are taken
    # A power of two: float32 values are rounded to multiples of it, or of a smaller power of two
    # if all values are small: at most 2⁻¹² of the largest value. Without a step, each value is
    # rounded to 12 significant bits.
    step: float | None = None,
) -> tuple[NDArray[np.uint8], Packing] | None:
    """Return an array as a zlib stream, and its packing; None if it cannot be packed."""
    if array.dtype != np.float32:
        integers = array.view(np.uint8) if array.dtype == np.bool_ else array
    elif step is None:
        if not np.max(np.abs(array), where=np.isfinite(array), initial=0) <= _MAX_FLOAT:
            return None
        integers = _leading_bits(array)
    else:
        max_magnitude = _max_magnitude(array)
        if not max_magnitude <= step * _MAX_STEPS:  # so also if `max_magnitude` is NaN
            return None
        step = _step_for(max_magnitude, step)
        integers = _fixed_point(array, step, max_magnitude)
    packing = Packing(shape=array.shape, integer_type=integers.dtype.name, step=step)
    return _compress(integers, row_axis), packing


def unpack(
    stream: NDArray[np.uint8],  # (N,) uint8
    packing: Packing,
    kind: np.dtype,  # type of the array
    *,
    row_axis: int,  # as for `pack`
) -> NDArray[Any]:
    """Return the array that was packed.

    Raises ValueError if the stream is damaged, or has another number of integers. No more bytes are
    unpacked than the array has.
    """
    integers = _decompress(stream, packing.shape, packing.dtype, row_axis)
    if packing.step is not None:
        return np.multiply(integers, np.float32(packing.step), dtype=np.float32)
    if kind == np.float32:
        return (integers << np.uint32(_DROPPED_BITS)).view(np.float32)
    has_same_size = integers.itemsize == kind.itemsize
    return integers.view(kind) if has_same_size else integers.astype(kind)


def round_as_packed(values: NDArray[np.float32], step: float) -> NDArray[np.float32]:
    """Return float32 values as they are after packing with a step and unpacking."""
    max_magnitude = _max_magnitude(values)
    if not max_magnitude <= step * _MAX_STEPS:
        return values
    step = _step_for(max_magnitude, step)
    return np.multiply(
        _fixed_point(values, step, max_magnitude), np.float32(step), dtype=np.float32
    )


def _max_magnitude(values: NDArray[np.float32]) -> float:
    """Return the largest absolute value; NaN if any value is NaN."""
    return float(max(values.max(initial=0.0), -values.min(initial=0.0)))


def _step_for(max_magnitude: float, step: float) -> float:
    """Return the step for values up to the largest one, at most `step`.

    Rounding values that were rounded with this step changes nothing.
    """
    if max_magnitude == 0:
        return step
    power = 2.0 ** math.frexp(max_magnitude)[1]
    fine_step = 2.0 ** -(SIGNIFICANT_BITS + 1) * power
    if round(max_magnitude / fine_step) * fine_step >= power:  # rounding increases the exponent
        fine_step *= 2
    return min(step, max(fine_step, 2.0**-126))


def _fixed_point(
    values: NDArray[np.float32], step: float, max_magnitude: float
) -> NDArray[np.signedinteger]:
    """Return the nearest multiples of a step, as int16 if they are small enough, else as int32."""
    is_small = max_magnitude / step < np.iinfo(np.int16).max
    depth, kind = (cv2.CV_16S, np.int16) if is_small else (cv2.CV_32S, np.int32)
    flat_values = np.ascontiguousarray(values).reshape(-1, values.shape[-1])
    # OpenCV rounds half to even as NumPy does, several times as fast.
    multiples = cv2.addWeighted(flat_values, 1 / step, flat_values, 0, 0, dtype=depth)
    return multiples.reshape(values.shape).astype(kind, copy=False)


def _leading_bits(values: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return sign, exponent and leading bits, rounded half to even; infinity stays infinity."""
    bits = np.ascontiguousarray(values).view(np.uint32)
    odd_bit = bits >> _DROPPED_BITS & 1
    return bits + (odd_bit + np.uint32(2 ** (_DROPPED_BITS - 1) - 1)) >> _DROPPED_BITS


def _compress(integers: NDArray[np.integer], row_axis: int) -> NDArray[np.uint8]:
    """Return the differences of rows as byte planes in a zlib stream."""
    width = integers.itemsize
    numbers = np.ascontiguousarray(integers).view(f"<u{width}")
    images = numbers.reshape(math.prod(integers.shape[:row_axis]), integers.shape[row_axis], -1)
    planes = np.empty((width, *images.shape), np.uint8)
    rows = max(1, _BLOCK_SIZE // (images.shape[2] * width))
    scratch = np.empty((rows, images.shape[2]), numbers.dtype)
    all_bits = 0
    for number, image in enumerate(images):
        for first_row in range(0, len(image), rows):
            codes = scratch[: len(image) - first_row]
            _encode_rows(image, first_row, codes)
            all_bits |= int(np.bitwise_or.reduce(codes, axis=None))
            for plane, part in zip(planes, _byte_planes(codes), strict=True):
                plane[number, first_row : first_row + len(codes)] = part
    used_planes = max(1, -(-all_bits.bit_length() // 8))
    return np.frombuffer(
        isal_zlib.compress(planes[:used_planes].reshape(-1), _COMPRESSION_LEVEL), np.uint8
    )


def _encode_rows(image: NDArray[Any], first_row: int, codes: NDArray[Any]) -> None:
    """Write the codes of the differences of some rows of an image, from row `first_row` on."""
    if first_row == 0:
        codes[0] = image[0]
    begin, end = max(first_row, 1), first_row + len(codes)
    np.subtract(image[begin:end], image[begin - 1 : end - 1], out=codes[begin - first_row :])
    # Small differences of either sign get small codes: 0, -1, 1, -2, 2 become 0, 1, 2, 3, 4.
    signs = codes.view(f"<i{codes.itemsize}") >> 8 * codes.itemsize - 1
    codes <<= 1
    codes ^= signs.view(codes.dtype)


def _decompress(
    stream: NDArray[np.uint8], shape: tuple[int, ...], kind: np.dtype, row_axis: int
) -> NDArray[Any]:
    """Return the integers of a stream."""
    count, width = math.prod(shape), kind.itemsize
    decompressor = zlib.decompressobj()
    try:
        data = decompressor.decompress(stream.tobytes(), width * count + 1)
    except zlib.error as error:
        raise InputError(f"is not a zlib stream: {error}") from error
    planes = len(data) // count
    is_complete = decompressor.eof and not decompressor.unused_data and len(data) == planes * count
    if not (is_complete and 1 <= planes <= width):
        raise InputError(f"is not a zlib stream of {count} numbers of at most {width} bytes")
    codes = np.zeros(count, f"<u{width}")
    columns = codes.view(np.uint8).reshape(count, width)
    for plane, values in enumerate(np.frombuffer(data, np.uint8).reshape(planes, count)):
        columns[:, plane] = values
    signs = np.negative(codes & codes.dtype.type(1))
    codes >>= 1
    codes ^= signs
    numbers: NDArray[Any] = codes.reshape(shape)
    np.cumsum(numbers, axis=row_axis, dtype=numbers.dtype, out=numbers)
    return numbers.view(kind)


def _byte_planes(numbers: NDArray[Any]) -> Sequence[NDArray[Any]]:
    """Return the bytes of the numbers as one array for each byte, the lowest one first."""
    width = numbers.itemsize
    if width == 1:
        return [numbers]
    return cv2.split(numbers.view(np.uint8).reshape(*numbers.shape, width))
