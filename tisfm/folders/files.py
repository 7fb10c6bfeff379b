"""Check sums of files, and the report and the timings beside a result."""

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from isal import isal_zlib

_READ_SIZE = 2**20  # bytes of one read operation
_MAX_DIFFERENCES = 4  # differences in a message


def file_checksum(path: Path) -> tuple[int, int] | None:
    """Return the length of a file, bytes, and its CRC-32; None if there is no such file."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):  # reading a pipe would wait for a writer
            return None
        with open(path, "rb", 0) as file:
            length, checksum = 0, 0
            while data := file.read(_READ_SIZE):
                length, checksum = length + len(data), isal_zlib.crc32(data, checksum)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        return None
    return length, checksum


def files_digest(files: Iterable[Path]) -> str:
    """Return a digest of the contents and names of files, without their folders."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name} {file_checksum(file)}\n".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()[:32]


def compare_records(earlier: Any, current: Any, name: str = "") -> Iterator[str]:
    """Yield a description of each difference between two records (nested dicts of JSON values)."""
    if isinstance(earlier, dict) and isinstance(current, dict):
        for key in sorted(earlier.keys() | current.keys()):
            inner_name = f"{name}.{key}" if name else key
            yield from compare_records(earlier.get(key), current.get(key), inner_name)
    elif earlier != current:
        yield f"{name} was {json.dumps(earlier)}, now {json.dumps(current)}"


def summarise_differences(differences: Iterable[str]) -> str:
    """Return the first differences as one text; an empty text without differences."""
    texts = list(differences)
    further_count = len(texts) - _MAX_DIFFERENCES
    return "; ".join(texts[:_MAX_DIFFERENCES] + [f"and {further_count} more"] * (further_count > 0))


REPORT, TIMINGS = "report.html", "timings.csv"
MARK = '<meta name="generator" content="tisfm">'
_HEAD_SIZE = 400  # first bytes of a report, which contain the mark


def is_report(path: Path) -> bool:
    """Return whether a file is a report that tisfm wrote."""
    try:
        with open(path, "rb") as file:
            return path.is_file() and MARK.encode() in file.read(_HEAD_SIZE)
    except OSError:
        return False
