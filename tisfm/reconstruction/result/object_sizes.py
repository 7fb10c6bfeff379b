"""Known lengths of moving objects."""

from collections.abc import Collection, Mapping
from numbers import Real

import numpy as np

from tisfm.errors import InputError, InputTypeError
from tisfm.sources.frame_reader import is_integer


def checked_object_sizes(sizes: Mapping[int, float] | None) -> dict[int, float]:
    """Return the lengths by object ids, checked.

    Raises TypeError, ValueError if an id is not a whole number, or a length is not positive.
    """
    if sizes is not None and not isinstance(sizes, Mapping):
        raise InputTypeError(
            f"object_sizes is {sizes!r}: expected lengths by ids, such as {{1: 4.5}}"
        )
    checked: dict[int, float] = {}
    for number, size in (sizes or {}).items():
        if not is_integer(number):
            raise InputTypeError(f"object_sizes has the id {number!r}: expected a whole number")
        if isinstance(size, bool) or not isinstance(size, Real):
            raise InputTypeError(f"object_sizes[{number}] is {size!r}: expected a length")
        if not (np.isfinite(size) and size > 0):
            raise InputError(f"object_sizes[{number}] is {size}: expected a positive length")
        checked[int(number)] = float(size)
    return checked


def refuse_unknown_ids(sizes: Collection[int], object_ids: Collection[int]) -> None:
    """Raise InputError if the size of an unknown object is given."""
    unknown = sorted(set(sizes) - set(object_ids))
    if unknown:
        ids = ", ".join(map(str, sorted(object_ids))) or "none"
        raise InputError(
            f"object_sizes has one of {', '.join(map(str, unknown))}, but the ids of what moves "
            f"are: {ids}"
        )
