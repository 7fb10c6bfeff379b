"""Checks of arguments."""

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from tisfm.errors import InputError, InputTypeError

_MIN_SIMILARITY = 0.6  # of a suggested word: ratio of `difflib`, 0 to 1; the default there

Floats = NDArray[np.float64]
# Type of a dataclass field. The constructor takes any array_like; the field is a read-only float64
# array.
Vector = Any


def check_finite(value: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """Return a read-only float64 copy; raise ValueError if not finite or of another shape."""
    refuse_masked(value, name, "expected numbers without a mask")
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}: expected {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} is {array.tolist()}: expected finite numbers")
    array.flags.writeable = False
    return array


def check_whole_numbers(minimum: int, **values: object) -> None:
    """Raise ValueError unless all values are whole numbers of at least `minimum`, 0 or 1."""
    for name, value in values.items():
        if not isinstance(value, int | np.integer) or value < minimum:
            kind = "positive" if minimum else "non-negative"
            raise InputError(f"{name} is {value!r}: expected a {kind} whole number")


def check_pose_count(poses: int, frames: int) -> None:
    """Raise ValueError unless there are as many poses as frames."""
    if poses != frames:
        raise InputError(f"poses are {poses}, but there are {frames} frames: expected one for each")


def refuse_masked(
    values: object,  # array_like: an array, or nested sequences whose rows may be masked arrays
    name: str,  # name of the argument in the error
    # advice in the error; by default to fill the masked values with NaN, which means unknown
    advice: str | None = None,
) -> None:
    """Raise ValueError if an array has masked values: NumPy's functions would drop the mask."""
    masked_count, total = _count_masked(values)
    if masked_count:
        advice = advice or f"fill them first, for instance by {name}.filled(np.nan)"
        raise InputError(f"{name} has {masked_count} of {total} values masked: {advice}")


def check_unmasked(
    values: ArrayLike, name: str, dtype: DTypeLike | None = None, *, advice: str | None = None
) -> NDArray[Any]:
    """Return values as a plain array; raise ValueError if some values are masked."""
    refuse_masked(values, name, advice)
    return np.asarray(values, dtype)


def check_mask(values: ArrayLike, name: str) -> NDArray[np.bool_]:
    """Return where a mask is nonzero; raise if it is not a mask, or if some values are masked."""
    advice = f"fill them first, for instance by {name}.filled(0)"
    mask = check_unmasked(values, name, advice=advice)
    if mask.dtype.kind not in "biuf":
        raise InputTypeError(f"{name} is of type {mask.dtype}: expected True and False, or numbers")
    if mask.dtype.kind == "f" and np.isnan(mask).any():
        raise InputError(f"{name} is NaN at {np.isnan(mask).sum()} of {mask.size} values")
    return mask.astype(bool)


def _count_masked(values: object) -> tuple[int, int]:
    """Return the number of masked values, and the number of all values."""
    if isinstance(values, np.ma.MaskedArray):
        return int(np.ma.count_masked(values)), values.size
    if not isinstance(values, Sequence) or isinstance(values, str | bytes):
        return 0, getattr(values, "size", 1)
    counts = [_count_masked(item) for item in values]
    return sum(masked for masked, _ in counts), sum(total for _, total in counts)


def find_similar_word(word: str, candidates: Iterable[str]) -> str | None:
    """Return the known word most similar to `word`; None if no word is similar.

    If exactly one known word begins with `word`, that word is returned.
    """
    words = [name for name in candidates if name]
    completions = [name for name in words if name.startswith(word)] if word.strip("-") else []
    if len(completions) == 1:
        return completions[0]
    lowercase_words = {name.lower(): name for name in reversed(words)}
    matches = difflib.get_close_matches(word.lower(), lowercase_words, n=1, cutoff=_MIN_SIMILARITY)
    return lowercase_words[matches[0]] if matches else None


def spelling_hint(word: str, candidates: Iterable[str]) -> str:
    """Return ", did you mean …?" with the most similar known word; "" if no word is similar."""
    suggestion = find_similar_word(word, candidates)
    return f", did you mean {suggestion!r}?" if suggestion else ""
