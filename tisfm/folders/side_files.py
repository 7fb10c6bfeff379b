"""Files beside a result: its report, ``report.html``, and its timings, ``timings.csv``."""

from pathlib import Path

REPORT, TIMINGS = "report.html", "timings.csv"
MARK = '<meta name="generator" content="tisfm">'
_HEAD = 400  # bytes of the file in which the mark is searched


def is_report(path: Path) -> bool:
    """Return whether a file is a report that tisfm wrote."""
    try:
        with open(path, "rb") as file:
            return path.is_file() and MARK.encode() in file.read(_HEAD)
    except OSError:
        return False
