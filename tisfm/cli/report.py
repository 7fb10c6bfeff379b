"""``tisfm report``, and `--report` of other commands."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from tisfm.cli.console import tell
from tisfm.folders.run_record import RECORD, read_record
from tisfm.reconstruction.result.folder import RECORD as RECONSTRUCTION
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.report import write_reconstruction_report, write_run_report
from tisfm.sources import Source


@dataclass(kw_only=True)
class Report:
    """Show a run or a reconstruction on one page.

    DIR is the folder that tisfm run or tisfm reconstruct wrote. It receives report.html: a summary,
    the path of the camera, statuses with advice, pictures of the frames with a slider, and the
    settings. The page needs no network and no other file.
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder of a run or a reconstruction."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        return report(self.folder)


def report(folder: Path) -> int:
    """Write the report of a folder that is there already; return the exit code."""
    if (folder / RECONSTRUCTION).is_file():
        report_reconstruction(Reconstruction.load(folder), folder)
    elif (folder / RECORD).is_file():
        report_run(folder)
    else:
        raise FileNotFoundError(
            f"{folder} has neither {RECORD} of tisfm run nor {RECONSTRUCTION} of tisfm "
            "reconstruct: give the folder that one of these commands wrote"
        )
    return 0


def report_run(folder: Path, source: Source | None = None) -> None:
    """Write the report of a run, and print its path."""
    record = read_record(folder)
    if record is None:
        raise FileNotFoundError(f"{folder} has no {RECORD}: the run finished no pair")
    path = write_run_report(folder, record, source=source_title(source))
    tell(f"Open {path} in a browser.")


def report_reconstruction(
    result: Reconstruction, folder: Path, *, source: Source | None = None
) -> None:
    """Write the report of a reconstruction, and print its path."""
    path = write_reconstruction_report(result, folder, source=source_title(source))
    tell(f"Open {path} in a browser.")


def source_title(source: Source | None) -> str | None:
    """Return the name of a source in a report: without the folders above it."""
    if source is None:
        return None
    if isinstance(source, (str, os.PathLike)):
        name = os.fspath(source)
        return Path(name).name or Path(name).resolve().name
    names = [
        Path(os.fspath(frame)).name for frame in source if isinstance(frame, (str, os.PathLike))
    ]
    return f"{names[0]} … {names[-1]}" if len(names) > 2 else ", ".join(names)
