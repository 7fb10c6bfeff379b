"""Texts and JSON, from files that anyone may have written."""

import json
import os
from typing import Any

from tisfm.formats.errors import FormatError
from tisfm.formats.reading import read_bytes


def read_text(path: str | os.PathLike[str]) -> str:
    """Read a text in UTF-8, with or without a byte-order mark.

    Bytes that are no UTF-8 become U+FFFD: in a comment they do no harm, and they are no number.

    Raises
    ------
    OSError, FormatError
        As `tisfm.formats.reading.read_bytes`.
    """
    return read_bytes(path).decode("utf-8-sig", "replace")


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read JSON.

    Raises
    ------
    FormatError
        If it is none, nested too deeply, or has a number of thousands of digits.
    OSError
        As `tisfm.formats.reading.read_bytes`.
    """
    data = read_bytes(path)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise FormatError(f"{os.fspath(path)} is damaged, or no JSON: {reason}") from error
