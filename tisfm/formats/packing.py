"""Arrays in few bytes: rounded, as steps from row to row, their low bytes apart, compressed.

The low bytes of a measured number are noise, which nothing compresses; its high bytes change little
from one row to the next. ``docs/formats.md`` describes what is written.
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

STEP = 2.0**-10  # of image motion, px/frame, and of what is 0 to 1
LEADING = 12  # bits of a number that are kept where it has no step
_DROPPED = 24 - LEADING  # of those that float32 has
_LEVEL = 1  # of ISA-L's four
_MOST_STEPS = 2.0**30
_LARGEST = 3e38  # what is beyond may become infinite by rounding
_FIXED = ("int16", "int32")
_BLOCK = 2**17  # bytes that are worked on at a time


@dataclass(frozen=True, kw_only=True)
class Packing:
    """How an array was packed.

    Attributes
    ----------
    shape : tuple of int
    of : str
        Type of the whole numbers in the stream: uint8, uint16, int16, int32 or uint32.
    step : float or None
        What they are multiplied by. None if they are the array itself, or, of uint32 for float32,
        its sign, exponent and leading bits.
    """

    shape: tuple[int, ...]
    of: str
    step: float | None

    @property
    def kind(self) -> np.dtype:
        """The type of the whole numbers."""
        return np.dtype(self.of).newbyteorder("<")

    def as_json(self) -> dict[str, Any]:
        """Return what `of_json` takes."""
        return {"shape": list(self.shape), "of": self.of, "step": self.step}

    @classmethod
    def of_json(cls, about: Any, kinds: Collection[str]) -> "Packing":
        """Return what was written as JSON; of whole numbers of one of these types.

        Raises
        ------
        ValueError
            If it is anything else.
        """
        if not isinstance(about, dict) or set(about) != {"shape", "of", "step"}:
            raise InputError(f"is packed as {about!r}, expected shape, of and step")
        shape, of, step = about["shape"], about["of"], about["step"]
        if not isinstance(shape, list) or any(type(side) is not int or side < 1 for side in shape):
            raise InputError(f"is packed in the shape {shape!r}, expected lengths of axes")
        if of not in kinds:
            raise InputError(f"is packed as {of!r}, expected {' or '.join(kinds)}")
        if of in _FIXED and kinds == _FIXED:
            if not (isinstance(step, float) and 0 < step <= 1):
                raise InputError(f"is packed in steps of {step!r}, expected 0 to 1")
        elif step is not None:
            raise InputError(f"is packed in steps of {step!r}, expected none")
        return cls(shape=tuple(shape), of=of, step=step)


def pack(
    array: NDArray[Any], *, down: int, step: float | None = None
) -> tuple[NDArray[np.uint8], Packing] | None:
    """Return an array as a zlib stream, and how it was packed; None if it cannot be.

    Parameters
    ----------
    array : ndarray of float32, or of whole numbers of at most 4 bytes
    down : int
        The axis of rows.
    step : float, optional
        Numbers of float32 are rounded to multiples of this power of two, or of a smaller one where
        all of them are small: at most 2⁻¹² of the largest. By default to 12 significant bits.
    """
    if array.dtype != np.float32:
        whole = array.view(np.uint8) if array.dtype == np.bool_ else array
    elif step is None:
        if not np.max(np.abs(array), where=np.isfinite(array), initial=0) <= _LARGEST:
            return None
        whole = _leading_bits(array)
    else:
        largest = _largest(array)
        if not largest <= step * _MOST_STEPS:  # nor is it so of NaN
            return None
        step = _step(largest, step)
        whole = _fixed_point(array, step, largest)
    return _stream(whole, down), Packing(shape=array.shape, of=whole.dtype.name, step=step)


def unpack(
    stream: NDArray[np.uint8], packing: Packing, kind: np.dtype, *, down: int
) -> NDArray[Any]:
    """Return the array that was packed.

    Parameters
    ----------
    stream : (N,) uint8
    packing : Packing
    kind : dtype
        Of the array.
    down : int
        The axis of rows.

    Raises
    ------
    ValueError
        If the stream is damaged, or not of so many numbers. No more than those are unpacked.
    """
    whole = _numbers(stream, packing.shape, packing.kind, down)
    if packing.step is not None:
        return np.multiply(whole, np.float32(packing.step), dtype=np.float32)
    if kind == np.float32:
        return (whole << np.uint32(_DROPPED)).view(np.float32)
    return whole.view(kind) if whole.itemsize == kind.itemsize else whole.astype(kind)


def rounded(values: NDArray[np.float32], step: float) -> NDArray[np.float32]:
    """Return numbers of float32 as they are when they were packed with a step."""
    largest = _largest(values)
    if not largest <= step * _MOST_STEPS:
        return values
    step = _step(largest, step)
    return np.multiply(_fixed_point(values, step, largest), np.float32(step), dtype=np.float32)


def _largest(values: NDArray[np.float32]) -> float:
    """Return the largest absolute value; NaN if there is one."""
    return float(max(values.max(initial=0.0), -values.min(initial=0.0)))


def _step(largest: float, step: float) -> float:
    """Return a step for numbers up to the largest one.

    What was rounded with it stays as it is when it is rounded again.
    """
    if largest == 0:
        return step
    power = 2.0 ** math.frexp(largest)[1]
    fine = 2.0 ** -(LEADING + 1) * power
    if round(largest / fine) * fine >= power:  # then it counts as the next power
        fine *= 2
    return min(step, max(fine, 2.0**-126))


def _fixed_point(
    values: NDArray[np.float32], step: float, largest: float
) -> NDArray[np.signedinteger]:
    """Return the nearest multiples of a step, as int16 if they are small enough, else as int32."""
    is_small = largest / step < np.iinfo(np.int16).max
    depth, kind = (cv2.CV_16S, np.int16) if is_small else (cv2.CV_32S, np.int32)
    flat = np.ascontiguousarray(values).reshape(-1, values.shape[-1])
    # Rounds half to even, several times as fast as NumPy.
    counted = cv2.addWeighted(flat, 1 / step, flat, 0, 0, dtype=depth)
    return counted.reshape(values.shape).astype(kind, copy=False)


def _leading_bits(values: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return sign, exponent and leading bits of numbers, rounded; infinity stays so."""
    bits = np.ascontiguousarray(values).view(np.uint32)
    odd = bits >> _DROPPED & 1
    return bits + (odd + np.uint32(2 ** (_DROPPED - 1) - 1)) >> _DROPPED


def _stream(whole: NDArray[np.integer], down: int) -> NDArray[np.uint8]:
    """Return whole numbers as steps from row to row, byte by byte, in a zlib stream."""
    width = whole.itemsize
    numbers = np.ascontiguousarray(whole).view(f"<u{width}")
    images = numbers.reshape(math.prod(whole.shape[:down]), whole.shape[down], -1)
    planes = np.empty((width, *images.shape), np.uint8)
    rows = max(1, _BLOCK // (images.shape[2] * width))
    scratch = np.empty((rows, images.shape[2]), numbers.dtype)
    largest = 0
    for number, image in enumerate(images):
        for first in range(0, len(image), rows):  # of a size that stays in the cache
            codes = scratch[: len(image) - first]
            _codes(image, first, codes)
            largest |= int(np.bitwise_or.reduce(codes, axis=None))
            for plane, part in zip(planes, _bytes_of(codes), strict=True):
                plane[number, first : first + len(codes)] = part
    used = max(1, -(-largest.bit_length() // 8))
    return np.frombuffer(isal_zlib.compress(planes[:used].reshape(-1), _LEVEL), np.uint8)


def _codes(image: NDArray[Any], first: int, codes: NDArray[Any]) -> None:
    """Write the steps to some rows of an image, from the first of them on, each as its code."""
    if first == 0:
        codes[0] = image[0]
    begin, end = max(first, 1), first + len(codes)
    np.subtract(image[begin:end], image[begin - 1 : end - 1], out=codes[begin - first :])
    # Small steps either way become small numbers: 0, -1, 1, -2, 2 are 0, 1, 2, 3, 4.
    signs = codes.view(f"<i{codes.itemsize}") >> 8 * codes.itemsize - 1
    codes <<= 1
    codes ^= signs.view(codes.dtype)


def _numbers(
    stream: NDArray[np.uint8], shape: tuple[int, ...], kind: np.dtype, down: int
) -> NDArray[Any]:
    """Return the whole numbers of a stream."""
    count, width = math.prod(shape), kind.itemsize
    inflate = zlib.decompressobj()
    try:
        text = inflate.decompress(stream.tobytes(), width * count + 1)
    except zlib.error as error:
        raise InputError(f"is no zlib stream: {error}") from error
    planes = len(text) // count
    whole = inflate.eof and not inflate.unused_data and len(text) == planes * count
    if not (whole and 1 <= planes <= width):
        raise InputError(f"is no zlib stream of {count} numbers of at most {width} bytes")
    steps = np.zeros(count, f"<u{width}")
    columns = steps.view(np.uint8).reshape(count, width)
    for plane, values in enumerate(np.frombuffer(text, np.uint8).reshape(planes, count)):
        columns[:, plane] = values
    signs = np.negative(steps & steps.dtype.type(1))
    steps >>= 1
    steps ^= signs
    numbers: NDArray[Any] = steps.reshape(shape)
    np.cumsum(numbers, axis=down, dtype=numbers.dtype, out=numbers)
    return numbers.view(kind)


def _bytes_of(numbers: NDArray[Any]) -> Sequence[NDArray[Any]]:
    """Return the bytes of each number, the lowest ones first, as an array each."""
    width = numbers.itemsize
    if width == 1:
        return [numbers]
    return cv2.split(numbers.view(np.uint8).reshape(*numbers.shape, width))
