"""Records of runs: check sums of files, and differences between two records."""

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from isal import isal_zlib

_PIECE = 2**20  # bytes of a file that are read at a time
_MOST_SAID = 4  # differences


def check_sum(path: Path) -> tuple[int, int] | None:
    """Return the length of a file, bytes, and its CRC-32; None if there is none."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe would be waited for
            return None
        with open(path, "rb", 0) as file:
            length, total = 0, 0
            while piece := file.read(_PIECE):
                length, total = length + len(piece), isal_zlib.crc32(piece, total)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        return None
    return length, total


def content(files: Iterable[Path]) -> str:
    """Return a digest of what files hold, and of their names, but not of their folders."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name} {check_sum(file)}\n".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()[:32]


def differing(before: Any, now: Any, name: str = "") -> Iterator[str]:
    """Yield what differs between two accounts."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in sorted(before.keys() | now.keys()):
            yield from differing(before.get(key), now.get(key), f"{name}.{key}" if name else key)
    elif before != now:
        yield f"{name} was {json.dumps(before)}, now {json.dumps(now)}"


def said(differences: Iterable[str]) -> str:
    """Return the first differences in words; nothing if there are none."""
    found = list(differences)
    more = len(found) - _MOST_SAID
    return "; ".join(found[:_MOST_SAID] + [f"and {more} more"] * (more > 0))
