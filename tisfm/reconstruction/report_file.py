"""The page of a result, ``report.html``: whether a file of this name is one."""

from pathlib import Path

REPORT = "report.html"
MARK = '<meta name="generator" content="tisfm">'
_HEAD = 400  # bytes, in which the mark is found


def is_report(path: Path) -> bool:
    """Return whether a file is a report that tisfm wrote."""
    try:
        with open(path, "rb") as file:
            return path.is_file() and MARK.encode() in file.read(_HEAD)
    except OSError:
        return False
