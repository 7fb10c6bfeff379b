"""The record of a run: its request, its finished pairs, and their files."""

import json
import math
import os
import time
from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tisfm.errors import InputError
from tisfm.folders.files import TIMINGS, compare_records, file_checksum, summarise_differences
from tisfm.formats import atomic_write
from tisfm.formats.csv_table import csv_table
from tisfm.formats.reading import FormatError
from tisfm.grade import Grade, GradeSummary, summarise_grades
from tisfm.status import Status
from tisfm.trajectory.times import time_fault

RECORD = "run.json"
TABLE = "run.csv"
FORMAT = 4  # version of the format of `RECORD`
# A run can be resumed only if these entries are equal.
REQUEST_KEYS = (
    "version", "arch", "lanes", "camera", "source", "settings", "window", "fixed_pixels",
    "outputs", "figures", "start", "step", "disparity", "screen",
)  # fmt: skip
ENDINGS = {
    "depth": "_depth.png",
    "depth16": "_depth16.png",
    "flow": "_flow.flo",
    "anaglyph": "_anaglyph.png",
    "figure": "_figure.png",
    "ply": ".ply",
    "pose": "_pose.txt",
    "npz": ".npz",
}
"""Endings of the files of a pair, by output."""
RANGE_KEYS = ("depth16_values_per_unit", "depth_range", "flow_limit", "screen_at")
_MIN_WRITE_INTERVAL = 1.0  # s between two writings of the record; set by hand
_MIN_INTERVAL_RATIO = 20.0  # this interval divided by the time of a writing; set by hand
_COLUMNS = (
    "pair", "status", "message", "grade", "depth_error", "time0", "time1", "speed", "occluded",
    "confidence", "tx", "ty", "tz", "rx", "ry", "rz",
)  # fmt: skip


class RunRecord:
    """The contents of ``run.json``; an interrupted run can be resumed from this file.

    The file is written repeatedly during the run, in at most a twentieth of the time, and at the
    end. A pair is finished if it has an entry, and all its files have the check sums in the entry.

    Parameters
    ----------
    folder : Path
    request : mapping
        The request: values of the keys in `REQUEST_KEYS`.
    notes : sequence of str
        Notes on how the source is read.

    Attributes
    ----------
    statuses : Counter
        Number of finished pairs by status code.
    errors : list of float
        Expected relative errors of the depth of finished pairs that nothing contradicts, in rising
        order.
    seconds : dict of str to float
        Times of the pairs that this command interpreted, s, by their names.
    """

    def __init__(self, folder: Path, request: Mapping[str, Any], notes: Sequence[str] = ()) -> None:
        self._folder, self._notes = folder, tuple(notes)
        self._record: dict[str, Any] = {
            "format": FORMAT, **request, **dict.fromkeys(RANGE_KEYS), "notes": [], "pairs": {}
        }  # fmt: skip
        self.statuses: Counter[str] = Counter()
        self.errors: list[float] = []
        self.seconds: dict[str, float] = {}
        self._next_write, self._is_written = -math.inf, True
        self._earlier: dict[str, Any] | ValueError | None = None

    def read_earlier(self) -> list[Path]:
        """Read the record of an earlier run; return the files that it lists."""
        earlier = None
        try:
            earlier = self._earlier = _read_any_format(self._folder)
            refuse_other_format(self._folder / RECORD, earlier)
        except ValueError as error:
            self._earlier = error
        if earlier is None:
            return []
        return [
            self._folder / f"{name}{ending}"
            for name, pair in earlier["pairs"].items()
            for ending in pair["files"]
        ]

    def __getitem__(self, key: str) -> Any:
        return self._record[key]

    def __setitem__(self, key: str, value: Any) -> None:
        self._record[key] = value

    @property
    def pairs(self) -> Mapping[str, Mapping[str, Any]]:
        """The entry of every finished pair, by its name."""
        pairs: Mapping[str, Mapping[str, Any]] = self._record["pairs"]
        return pairs

    def resume(self) -> None:
        """Continue from the record in the folder, if any.

        Raises ValueError if the record is damaged, or of another request; the message names the
        differences.
        """
        earlier = self._earlier
        if isinstance(earlier, ValueError):
            raise earlier
        if earlier is None:
            return
        request = json.loads(json.dumps({key: self._record[key] for key in REQUEST_KEYS}))
        differences = summarise_differences(
            compare_records({key: earlier.get(key) for key in REQUEST_KEYS}, request)
        )
        if differences:
            raise InputError(
                f"{self._folder} holds a run with other options, of another version, or on another "
                f"kind of processor ({differences}): give the same options, or run without "
                "--resume to start again"
            )
        self._record = _check_values(earlier, self._folder / RECORD)
        self.statuses.update(pair["status"] for pair in self.pairs.values())
        for pair in self.pairs.values():
            _insert_error(self.errors, pair)

    @property
    def grade_summary(self) -> GradeSummary | None:
        """The grades of finished pairs, the median and the worst; None without pairs."""
        return summarise_pairs(list(self.pairs.values()))

    def is_complete(self, name: str, digest: str, endings: Collection[str]) -> bool:
        """Return whether a pair has an entry and its files are unchanged (`is_unchanged`)."""
        pair = self.pairs.get(name)
        return pair is not None and is_unchanged(self._folder, name, pair, digest, endings)

    def finish(
        self, name: str, entry: Mapping[str, Any], files: Mapping[str, tuple[int, int]]
    ) -> None:
        """Record a pair as finished, with the check sums of its files by their endings."""
        earlier = self.pairs.get(name)
        self._record["pairs"][name] = {**entry, "files": dict(files)}
        self.statuses[entry["status"]] += 1
        _insert_error(self.errors, entry)
        if earlier is not None:  # a pair whose files were damaged is finished again
            self.statuses[earlier["status"]] -= 1
            _remove_error(self.errors, earlier)
        self._is_written = False
        if time.monotonic() > self._next_write:
            self.write()

    def record_time(self, name: str, seconds: float) -> None:
        """Record the time of the interpretation of a pair, s."""
        self.seconds[name] = seconds

    def times_note(self) -> str:
        """Return a note if a path cannot use the times of frames, else ""."""
        pairs = sorted(self.pairs.items(), key=lambda item: item[1]["number"])
        for name, pair in pairs:
            time0, time1 = pair.get("times") or (None, None)
            if fault := time_fault(time0, time1, f"frame {name}", "the next"):
                return f"{fault}: paths use the numbers of frames instead of times"
        return ""

    def write(self) -> None:
        """Write ``run.json``, the table of all pairs and their times, if any entry has changed."""
        pairs = dict(sorted(self.pairs.items(), key=lambda item: item[1]["number"]))
        self._record["pairs"] = pairs  # other processes finish pairs in any order
        self._record["notes"] = [*self._notes, *filter(None, [self.times_note()])]
        rows = ((name, *_table_row(pair)) for name, pair in pairs.items())
        if self._is_written:
            table = csv_table(_COLUMNS, rows)
            if self.pairs and _read(self._folder / TABLE) != _encode(table):
                _write(self._folder / TABLE, table)
            return
        begin = time.monotonic()
        text = json.dumps(self._record, indent=2, ensure_ascii=False) + "\n"
        _write(self._folder / TIMINGS, csv_table(("pair", "seconds"), self.seconds.items()))
        _write(self._folder / TABLE, csv_table(_COLUMNS, rows))
        _write(self._folder / RECORD, text, durable=True)
        self._is_written = True
        end = time.monotonic()
        self._next_write = end + max(_MIN_WRITE_INTERVAL, _MIN_INTERVAL_RATIO * (end - begin))


def _known_error(pair: Mapping[str, Any]) -> float | None:
    """Return the expected error of a pair; None without depth, or if the depth is contradicted."""
    return None if pair["grade"] == Grade.CONTRADICTED else pair["depth_error"]


def _insert_error(errors: list[float], pair: Mapping[str, Any]) -> None:
    """Insert the expected error of a pair into sorted errors, if it is known."""
    if (error := _known_error(pair)) is not None:
        insort(errors, error)


def _remove_error(errors: list[float], pair: Mapping[str, Any]) -> None:
    """Remove the expected error of a pair from sorted errors, if it is known."""
    if (error := _known_error(pair)) is not None:
        del errors[bisect_left(errors, error)]


def summarise_pairs(pairs: Collection[Mapping[str, Any]]) -> GradeSummary | None:
    """Return the summary of the grades of pairs, from their entries; None without pairs."""
    if not pairs:
        return None
    return summarise_grades(
        [Grade(pair["grade"]) for pair in pairs],
        [pair["status"] for pair in pairs],
        [math.nan if (error := pair["depth_error"]) is None else error for pair in pairs],
    )


def refuse_other_format(
    path: Path,  # path of the file, for the message
    record: Any,  # JSON of the file; JSON that is not a record of any version raises no error here
) -> None:
    """Raise FormatError if this version does not read the format of a record."""
    if not isinstance(record, dict) or not {"format", "version"} & record.keys():
        return
    format_number = record.get("format", 1)  # files of format 1 do not state it
    if format_number != FORMAT:
        raise FormatError(
            f"{path} is of format {format_number}, written by tisfm {record.get('version')}; this "
            f"version reads format {FORMAT}: run anew, without --resume"
        )


def is_unchanged(
    folder: Path,
    name: str,
    pair: Mapping[str, Any],  # the entry of the pair in the record
    digest: str,  # hash of the pair's frames, and of its pose and masks, if any
    endings: Collection[str],  # endings of the pair's files
) -> bool:
    """Return whether the files of a pair are unchanged since it was finished.

    Raises ValueError if the finished pair had other frames, or another pose or mask.
    """
    if pair["frames"] != digest:
        raise InputError(
            f"{folder} holds a run in which {name} had other frames, or another pose or mask: give "
            "the same frames, step, poses and masks, or run without --resume to start again"
        )
    return set(pair["files"]) == set(endings) and all(
        file_checksum(folder / f"{name}{ending}") == tuple(checksum)
        for ending, checksum in pair["files"].items()
    )


def read_record(folder: Path) -> dict[str, Any] | None:
    """Return the record of the run in a folder; None without a record.

    Raises ValueError if the record is damaged, or of another format.
    """
    record = _read_any_format(folder)
    refuse_other_format(folder / RECORD, record)
    return record


def _read_any_format(folder: Path) -> dict[str, Any] | None:
    """Return the record of a run, of any format; None without a record; ValueError if damaged."""
    path = folder / RECORD
    if not path.is_file():
        return None
    record = None
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(record, dict) or "version" not in record:
            raise InputError("it is not the record of a run")
        for name, pair in record["pairs"].items():
            if os.path.basename(name) != name:
                raise InputError(f"{name!r} is not the name of a pair")
            Status(pair["status"], pair["message"])  # raises an error for an invalid status
            if not set(pair["files"]) <= set(ENDINGS.values()):
                raise InputError(f"it lists unknown kinds of files of {name}")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        refuse_other_format(path, record)
        raise _damage_error(path, error) from error
    return record


def _check_values(record: dict[str, Any], path: Path) -> dict[str, Any]:
    """Check the types of the values in a record of this version; return the record."""
    try:
        if missing := set(REQUEST_KEYS) - record.keys():
            raise InputError(f"it has no {sorted(missing)[0]}")
        for key in RANGE_KEYS:
            if record[key] is not None and not _is_number(record[key]):
                raise InputError(f"{key} is {record[key]!r}")
        for name, pair in record["pairs"].items():
            Grade(pair["grade"])
            texts = (pair["status"], pair["message"], pair["frames"])
            numbers = [*(pair.get("times") or ()), *(pair.get("twists") or [()])[0]]
            for length, checksum in pair["files"].values():
                numbers += [length, checksum]
            numbers.append(pair["number"])
            numbers += [] if pair["depth_error"] is None else [pair["depth_error"]]
            if not all(isinstance(text, str) for text in texts):
                raise InputError(f"the entry of {name} has a value that is not a text")
            if not all(map(_is_number, numbers)):
                raise InputError(f"the entry of {name} has a value that is not a number")
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise _damage_error(path, error) from error
    return record


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _damage_error(path: Path, error: Exception) -> ValueError:
    reason = " ".join(str(error).split())
    return InputError(f"{path} is damaged ({reason}): run without --resume")


def _table_row(pair: Mapping[str, Any]) -> Iterator[Any]:
    """Yield the columns of a pair, without its name."""
    yield pair["status"]
    yield pair["message"]
    yield pair["grade"]
    yield pair["depth_error"]
    yield from pair.get("times") or (None, None)
    for key in ("speed", "occluded", "confidence"):
        yield pair.get(key)
    motions = pair.get("twists")
    yield from motions[0] if motions else (None,) * 6


def _write(path: Path, text: str, *, durable: bool = False) -> None:
    """Write text; escape characters that UTF-8 cannot encode, as in file names."""
    with atomic_write(path, durable=durable) as file:
        file.write(_encode(text))


def _encode(text: str) -> bytes:
    return text.encode("utf-8", "backslashreplace")


def _read(path: Path) -> bytes:
    """Return the contents of a file; no bytes if it cannot be read."""
    try:
        return path.read_bytes() if path.is_file() else b""
    except OSError:
        return b""
