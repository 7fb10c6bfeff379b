"""The file of a report: whose it is, and how it is written."""

from pathlib import Path

from tisfm.errors import InputError
from tisfm.folders.side_files import REPORT, is_report
from tisfm.formats import atomic_write


def refuse_foreign(folder: Path) -> Path:
    """Return where the report of a folder lies; refuse to replace what tisfm did not write.

    Raises
    ------
    ValueError
        If something else is there.
    """
    path = folder / REPORT
    if path.exists() and not is_report(path):
        raise InputError(
            f"{path} is no report of tisfm, and would be replaced: give another folder with -o"
        )
    return path


def write_page(path: Path, page: str) -> None:
    """Write a page, complete or not at all; characters that are none become question marks."""
    with atomic_write(path) as file:
        file.write(page.encode("utf-8", "replace"))
