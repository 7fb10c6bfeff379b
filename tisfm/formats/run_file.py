"""The record that `tisfm run` writes, and the format that this version reads."""

from pathlib import Path
from typing import Any

from tisfm.formats.errors import FormatError

NAME, FORMAT = "run.json", 2


def refuse_other_format(path: Path, record: Any) -> None:
    """Raise FormatError if a record is of a format that this version does not read.

    Parameters
    ----------
    path : Path
        Of the file, for the message.
    record : object
        Its JSON. JSON that is not a record of any version raises nothing here.
    """
    if not isinstance(record, dict) or not {"format", "version"} & record.keys():
        return
    found = record.get("format", 1)  # files of format 1 do not state it
    if found != FORMAT:
        raise FormatError(
            f"{path} is of format {found}, written by tisfm {record.get('version')}; this version "
            f"reads format {FORMAT}: run anew, without --resume"
        )
