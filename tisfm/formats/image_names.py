"""Times in the file names of images, and the order of images by their names."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Literal

import numpy as np

Notation = Literal["decimals", "nanoseconds", "integers"]

_EPOCH_NANOSECONDS = re.compile(r"\d{19}")  # since 1970
_FLOAT = r"(-?\d+(?:\.\d+)?(?:e[+-]\d{2,})?)"  # as Python prints a float
_NAME_PATTERNS = (
    re.compile("()" + _FLOAT, re.DOTALL),  # a number alone
    re.compile(r"(.*?[^0-9a-zA-Z.])" + _FLOAT, re.DOTALL),  # a prefix that ends in a separator
    re.compile(r"(.*?[a-zA-Z])" + _FLOAT, re.DOTALL),  # a prefix that ends in a letter
)
_SIGN_OR_EXPONENT = re.compile("[-e]")
# Set by hand:
_MAX_EVEN_DEVIATION = 0.1  # unevenness (see `_unevenness`) up to which steps count as even
_MAX_NANOSECOND_DIGITS = 9
_MIN_NANOSECOND_DIGITS = 7  # some name must have as many: 1 ms or more after a full second
_MAX_IMAGE_DIGITS = 4  # digits of the number of an image after the number of its take
_MIN_STEP = 1e-4  # s; a smaller median step means numbers of frames or versions, not times


@dataclass(frozen=True)
class ParsedTimes:
    """Times read from the file names of images."""

    seconds: tuple[float, ...]  # times in the order of the names
    # the notation: seconds with decimals; seconds, a point and nanoseconds without leading zeros;
    # or a whole number of nanoseconds
    notation: Notation
    # whether one name alone is ambiguous, and only all names together show the notation: the digits
    # after the point differ in number, or a name has a minus or an exponent
    is_inferred: bool

    def note(self, stems: Sequence[str]) -> str:
        """Return a note on how inferred times were read; "" if they were not inferred."""
        if not self.is_inferred:
            return ""
        if self.notation == "decimals":
            return (
                "the names of the pictures are read as seconds with decimals, and sorted by value: "
                f"{stems[0]} comes first, {stems[-1]} last"
            )
        longest = max(stems, key=lambda stem: (0 < len(_fraction(stem)) < 9, len(stem)))
        return (
            "the names of the pictures are read as seconds and nanoseconds, not as decimals: "
            f"{longest} is {int(_fraction(longest) or 0) / 1e9:g} s after the full second"
        )


def parse_times(
    # Names without their suffix. They may have a common prefix, such as ``frame_``, if their digits
    # after the point differ in number.
    stems: Sequence[str],
) -> ParsedTimes | None:
    """Return the times in file names; None if the names have no times.

    Names of 19 digits are nanoseconds, as in EuRoC. Names with the same number of digits after a
    point are seconds with decimals, as in TUM RGB-D. Where that number differs, a name such as
    ``12.5`` may be 12.5 s (a printed float), 12 s and 5 ns (ROS, printed without leading zeros), or
    the fifth image of the twelfth take. A leading zero after the point excludes nanoseconds and
    takes, and a trailing zero excludes a float. A median step below 0.1 ms excludes times. Of the
    remaining notations, the notation with the most even steps is used. Numbers behind a letter, as
    in ``t0.05``, are times only if their steps are even. Floats may have a minus or an exponent.
    """
    if len(stems) < 2:
        return None
    if all(map(_EPOCH_NANOSECONDS.fullmatch, stems)):
        return ParsedTimes(tuple(int(stem) / 1e9 for stem in stems), "integers", False)
    prefix_and_numbers = _prefix_and_numbers(stems)
    if prefix_and_numbers is None:
        return None
    prefix, numbers = prefix_and_numbers
    digit_counts = {len(_fraction(number)) for number in numbers}
    is_inferred = any(map(_SIGN_OR_EXPONENT.search, numbers))
    if digit_counts == {0} or (0 in digit_counts and len(stems) < 3):
        return None
    if len(digit_counts) == 1:
        if prefix:
            return None  # frame_1.05 may be a version and a number
        return _require_finite(ParsedTimes(tuple(map(float, numbers)), "decimals", is_inferred))
    decimals, nanoseconds = _read_decimals(numbers), _read_nanoseconds(numbers)
    if decimals is not None and nanoseconds is not None:
        if _unevenness(nanoseconds.seconds) < _unevenness(decimals.seconds):
            return nanoseconds
        return decimals
    times = decimals or nanoseconds
    if times and _take_unevenness(numbers) < _unevenness(times.seconds):
        return None
    follows_letter = prefix[-1:].isalpha()
    return (
        None
        if times and follows_letter and _unevenness(times.seconds) > _MAX_EVEN_DEVIATION
        else times
    )


def unread_times_note(stems: Sequence[str]) -> str:
    """Return a note that numbers with a point are not read as times; "" without such numbers."""
    prefix_and_numbers = _prefix_and_numbers(stems)
    if (
        prefix_and_numbers is None
        or len({len(_fraction(number)) for number in prefix_and_numbers[1]}) == 1
    ):
        return ""
    return (
        "the numbers in the names of the pictures are not read as times, as they may be versions: "
        f"{stems[0]} comes first, {stems[-1]} last; if they are times, write all with the same "
        "number of digits after the point"
    )


def _prefix_and_numbers(stems: Sequence[str]) -> tuple[str, list[str]] | None:
    """Return the prefix that all names share, and the numbers behind it; None if they differ."""
    for pattern in _NAME_PATTERNS:
        matches = [match for stem in stems if (match := pattern.fullmatch(stem))]
        if len(matches) == len(stems) and len({match[1] for match in matches}) == 1:
            return matches[0][1], [match[2] for match in matches]
    return None


def increasing_times(
    stems: Sequence[str],  # names without their suffix
) -> tuple[float, ...] | None:
    """Return the times in the names of images, s, if they increase in this order.

    Returns None if `parse_times` finds no times, or if they do not increase: then they may be
    numbers of frames.
    """
    times = parse_times(stems)
    if times is None or not all(later > earlier for earlier, later in pairwise(times.seconds)):
        return None
    return times.seconds


def sort_by_name(files: Iterable[Path]) -> list[Path]:
    """Return images in the order of the times in their names, or else in natural order.

    In natural order frame2 comes before frame10. Images of one folder stay together.
    """
    sorted_files = sorted(files, key=natural_sort_key)
    result: list[Path] = []
    for _, group in groupby(sorted_files, key=lambda file: file.parent):
        pictures = list(group)
        times = parse_times([file.stem for file in pictures])
        if times is not None and times.is_inferred:
            time_of_file = dict(zip(pictures, times.seconds, strict=True))
            pictures.sort(key=time_of_file.__getitem__)
        result += pictures
    return result


def natural_sort_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Return a sort key by which frame2 comes before frame10.

    Names that differ in leading zeros alone, frame2 and frame02, are sorted as text.
    """
    parts = re.split(r"(\d+)", str(path))
    # isdecimal matches as \d does; isdigit would also accept a superscript two.
    numbered = [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]
    return numbered, str(path)


def _fraction(number: str) -> str:
    """Return the digits after the point, without an exponent."""
    return number.rpartition(".")[2].partition("e")[0] if "." in number else ""


def _read_decimals(numbers: Sequence[str]) -> ParsedTimes | None:
    """Return numbers read as floats; None if one ends in a zero, as no printed float does."""
    fractions = map(_fraction, numbers)
    if any(len(digits) > 1 and digits.endswith("0") for digits in fractions):
        return None
    return _require_plausible(ParsedTimes(tuple(map(float, numbers)), "decimals", True))


def _read_nanoseconds(numbers: Sequence[str]) -> ParsedTimes | None:
    """Return numbers read as seconds and nanoseconds; None if one cannot be read so.

    Too many digits, a leading zero after the point, a minus and an exponent exclude this notation.
    """
    seconds = []
    for number in numbers:
        if _SIGN_OR_EXPONENT.search(number):
            return None
        whole_seconds, point, digits = number.partition(".")
        has_leading_zero = len(digits) > 1 and digits.startswith("0")
        if not point or has_leading_zero or len(digits) > _MAX_NANOSECOND_DIGITS:
            return None
        seconds.append(float(whole_seconds) + int(digits) / 1e9)
    if not any(len(_fraction(number)) >= _MIN_NANOSECOND_DIGITS for number in numbers):
        return None
    return _require_plausible(ParsedTimes(tuple(seconds), "nanoseconds", True))


def _require_plausible(times: ParsedTimes) -> ParsedTimes | None:
    """Return times that are finite and all differ, with a median step of 0.1 ms or more."""
    if _require_finite(times) is None:
        return None
    steps = np.diff(np.sort(times.seconds))
    return times if (steps > 0).all() and np.median(steps) >= _MIN_STEP else None


def _require_finite(times: ParsedTimes) -> ParsedTimes | None:
    return times if all(map(math.isfinite, times.seconds)) else None


def _take_unevenness(numbers: Sequence[str]) -> float:
    """Return the unevenness of the steps within the takes, for names that are take.image.

    Infinite if the names do not have this form, or if there are fewer than two steps.
    """
    takes: dict[str, list[int]] = {}
    for number in numbers:
        digits = _fraction(number)
        if not 0 < len(digits) <= _MAX_IMAGE_DIGITS or _SIGN_OR_EXPONENT.search(number):
            return math.inf
        if digits.startswith("0") and digits != "0":
            return math.inf
        takes.setdefault(number.partition(".")[0], []).append(int(digits))
    steps = np.concatenate([np.diff(sorted(take)) for take in takes.values()])
    return _mean_deviation(steps) if len(steps) > 1 and (steps > 0).all() else math.inf


def _unevenness(seconds: Sequence[float]) -> float:
    """Return the mean deviation of the steps from their median, as a share of the median."""
    return _mean_deviation(np.diff(np.sort(seconds)))


def _mean_deviation(steps: np.ndarray) -> float:
    median = float(np.median(steps))
    return float(np.mean(np.abs(steps - median))) / median
