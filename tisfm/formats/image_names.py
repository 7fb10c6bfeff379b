"""Times that the names of pictures state, and the order of pictures by their names."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from tisfm.formats.images import natural_order

Reading = Literal["decimals", "nanoseconds", "integers"]

_NANOSECONDS = re.compile(r"\d{19}")
_FLOAT = r"(-?\d+(?:\.\d+)?(?:e[+-]\d{2,})?)"  # as Python prints it
# The number alone, or with a beginning that ends in a separator, or in a letter.
_NUMBER, _PREFIXED, _LETTERED = (
    re.compile(before + _FLOAT, re.DOTALL)
    for before in ("()", r"(.*?[^0-9a-zA-Z.])", r"(.*?[a-zA-Z])")
)
_SIGN_OR_EXPONENT = re.compile("[-e]")
_EVEN = 0.1  # mean deviation of steps from their median, as a share of it
_MOST_NANOSECONDS = 9  # digits
_MOST_COUNTER_DIGITS = 4  # of the number of a picture behind the number of its take
_FEWEST_NANOSECONDS = 7  # digits of some name: 1 ms or more after a full second
_SHORTEST = 1e-4  # s: frames closer than that in the median are numbers, not times


@dataclass(frozen=True)
class NamedTimes:
    """Times that the names of pictures state.

    Attributes
    ----------
    seconds : tuple of float
        In the order of the names.
    reading : {"decimals", "nanoseconds", "integers"}
        Seconds with decimals; seconds, a point and nanoseconds without leading zeros; or a whole
        number of nanoseconds.
    is_inferred : bool
        Whether the digits after the point differ in number, or a name has a minus or an exponent,
        so that only all names together tell what they mean.
    """

    seconds: tuple[float, ...]
    reading: Reading
    is_inferred: bool

    def note(self, stems: Sequence[str]) -> str:
        """Return a note on how inferred times were read, "" if they were not inferred."""
        if not self.is_inferred:
            return ""
        if self.reading == "decimals":
            return (
                "the names of the pictures are read as seconds with decimals, and sorted by value: "
                f"{stems[0]} comes first, {stems[-1]} last"
            )
        longest = max(stems, key=lambda stem: (0 < len(_fraction(stem)) < 9, len(stem)))
        return (
            "the names of the pictures are read as seconds and nanoseconds, not as decimals: "
            f"{longest} is {int(_fraction(longest) or 0) / 1e9:g} s after the full second"
        )


def named_times(stems: Sequence[str]) -> NamedTimes | None:
    """Return the times that names state, None if they state none.

    Names that are 19 digits are nanoseconds, as in EuRoC's. Names with the same number of digits
    after a point are seconds with decimals, as in TUM's. Where that number differs, a name such as
    ``12.5`` may be 12.5 s (a float that was printed), 12 s and 5 ns (ROS, printed without leading
    zeros), or the fifth picture of the twelfth take. A zero at the beginning of the digits excludes
    nanoseconds and takes, one at the end excludes a float, and frames less than 0.1 ms apart are no
    times. Of the readings that are left, the one with the most even steps is taken. Numbers right
    behind a letter, as in ``t0.05``, are times only if their steps are even. Floats may have a
    minus or an exponent.

    Parameters
    ----------
    stems : sequence of str
        Names without their suffix. Those with digits of different lengths may have a common
        beginning, such as ``frame_``.

    Returns
    -------
    NamedTimes or None
    """
    if len(stems) < 2:
        return None
    if all(map(_NANOSECONDS.fullmatch, stems)):
        return NamedTimes(tuple(int(stem) / 1e9 for stem in stems), "integers", False)
    found = _numbers(stems)
    if found is None:
        return None
    beginning, numbers = found
    lengths = {len(_fraction(number)) for number in numbers}
    is_sorted_anew = any(map(_SIGN_OR_EXPONENT.search, numbers))
    if lengths == {0} or (0 in lengths and len(stems) < 3):
        return None
    if len(lengths) == 1:
        if beginning:
            return None  # frame_1.05 may be a version and a number
        return _finite(NamedTimes(tuple(map(float, numbers)), "decimals", is_sorted_anew))
    decimals, nanoseconds = _as_decimals(numbers), _as_nanoseconds(numbers)
    if decimals is not None and nanoseconds is not None:
        if _unevenness(nanoseconds.seconds) < _unevenness(decimals.seconds):
            return nanoseconds
        return decimals
    times = decimals or nanoseconds
    if times and _unevenness_of_counters(numbers) < _unevenness(times.seconds):
        return None
    follows_letter = beginning[-1:].isalpha()
    return None if times and follows_letter and _unevenness(times.seconds) > _EVEN else times


def unread_note(stems: Sequence[str]) -> str:
    """Return a note that numbers with a point are not times, "" without such numbers."""
    found = _numbers(stems)
    if found is None or len({len(_fraction(number)) for number in found[1]}) == 1:
        return ""
    return (
        "the numbers in the names of the pictures are not read as times, as they may be versions: "
        f"{stems[0]} comes first, {stems[-1]} last; if they are times, write all with the same "
        "number of digits after the point"
    )


def _numbers(stems: Sequence[str]) -> tuple[str, list[str]] | None:
    """Return the beginning that all names share, and the numbers that follow it; or None."""
    for pattern in (_NUMBER, _PREFIXED, _LETTERED):
        matches = [match for stem in stems if (match := pattern.fullmatch(stem))]
        if len(matches) == len(stems) and len({match[1] for match in matches}) == 1:
            return matches[0][1], [match[2] for match in matches]
    return None


def times_of_names(stems: Sequence[str]) -> tuple[float, ...] | None:
    """Return the times of pictures in this order, s, if their names state times that rise.

    Parameters
    ----------
    stems : sequence of str
        Names without their suffix.

    Returns
    -------
    tuple of float or None
        None if `named_times` finds none, or they do not rise: they may be numbers of frames.
    """
    found = named_times(stems)
    if found is None or not all(later > sooner for sooner, later in pairwise(found.seconds)):
        return None
    return found.seconds


def in_order(files: Iterable[Path]) -> list[Path]:
    """Return pictures in the order of their names.

    That is the order of the times that they state, or else the natural one, where frame2 comes
    before frame10. Pictures of a folder stay together.
    """
    listed = sorted(files, key=natural_order)
    ordered: list[Path] = []
    for _, group in groupby(listed, key=lambda file: file.parent):
        pictures = list(group)
        found = named_times([file.stem for file in pictures])
        if found is not None and found.is_inferred:
            time = dict(zip(pictures, found.seconds, strict=True))
            pictures.sort(key=time.__getitem__)
        ordered += pictures
    return ordered


def _fraction(number: str) -> str:
    """Return the digits after the point, without an exponent."""
    return number.rpartition(".")[2].partition("e")[0] if "." in number else ""


def _as_decimals(numbers: Sequence[str]) -> NamedTimes | None:
    """Return numbers as floats, None if one ends in a zero: printed floats do not."""
    fractions = map(_fraction, numbers)
    if any(len(digits) > 1 and digits.endswith("0") for digits in fractions):
        return None
    return _plausible(NamedTimes(tuple(map(float, numbers)), "decimals", True))


def _as_nanoseconds(numbers: Sequence[str]) -> NamedTimes | None:
    """Return numbers as seconds and nanoseconds, None if one cannot be read so.

    Too many digits, a zero first, a minus and an exponent exclude it.
    """
    seconds = []
    for number in numbers:
        if _SIGN_OR_EXPONENT.search(number):
            return None
        whole, point, digits = number.partition(".")
        padded = len(digits) > 1 and digits.startswith("0")
        if not point or padded or len(digits) > _MOST_NANOSECONDS:
            return None
        seconds.append(float(whole) + int(digits) / 1e9)
    if not any(len(_fraction(number)) >= _FEWEST_NANOSECONDS for number in numbers):
        return None
    return _plausible(NamedTimes(tuple(seconds), "nanoseconds", True))


def _plausible(found: NamedTimes) -> NamedTimes | None:
    """Return times if frames can be taken at them, else None."""
    known = _finite(found)
    if known is None:
        return None
    steps = np.diff(np.sort(known.seconds))
    return known if (steps > 0).all() and np.median(steps) >= _SHORTEST else None


def _finite(found: NamedTimes) -> NamedTimes | None:
    return found if all(map(math.isfinite, found.seconds)) else None


def _unevenness_of_counters(numbers: Sequence[str]) -> float:
    """Return the unevenness of the steps between the pictures of a take, if names are take.picture.

    Infinite if they cannot be, or if a take has one picture.
    """
    takes: dict[str, list[int]] = {}
    for number in numbers:
        digits = _fraction(number)
        if not 0 < len(digits) <= _MOST_COUNTER_DIGITS or _SIGN_OR_EXPONENT.search(number):
            return math.inf
        if digits.startswith("0") and digits != "0":
            return math.inf
        takes.setdefault(number.partition(".")[0], []).append(int(digits))
    steps = np.concatenate([np.diff(sorted(take)) for take in takes.values()])
    return _unevenness_of(steps) if len(steps) > 1 and (steps > 0).all() else math.inf


def _unevenness(seconds: Sequence[float]) -> float:
    """Return the mean distance of steps from their median, as a share of it."""
    return _unevenness_of(np.diff(np.sort(seconds)))


def _unevenness_of(steps: np.ndarray) -> float:
    usual = float(np.median(steps))
    return float(np.mean(np.abs(steps - usual))) / usual
