"""Which kind of result lies in a folder."""

from pathlib import Path

from tisfm.errors import InputError
from tisfm.folders.result_folder import is_locked
from tisfm.reconstruction.result.folder import BEGUN, DEPTH, PICTURES
from tisfm.reconstruction.result.folder import RECORD as RECONSTRUCTION
from tisfm.results.reconstruction_result import ReconstructionResult
from tisfm.results.result import Result
from tisfm.results.run_result import RECORD as RUN
from tisfm.results.run_result import RunResult


class NothingYetError(InputError):
    """A result is being made, and has no frame yet that can be looked at."""


def open_result(folder: Path) -> Result:
    """Open what `tisfm run` or `tisfm reconstruct` wrote, or is writing.

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        If there is no such folder, or it has no result, and none is being made.
    NothingYetError
        A ValueError: if a result is being made, and nothing of it is complete.
    tisfm.formats.FormatError
        A ValueError: if a file is damaged.
    """
    if not folder.exists():
        raise FileNotFoundError(f"there is no folder {folder}")
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder} is no folder: give the one that a command wrote")
    if (folder / RECONSTRUCTION).is_file():
        return ReconstructionResult(folder)
    if (folder / RUN).is_file():
        result = RunResult(folder)
        if result.names:
            return result
    _require_being_made(folder)
    if (folder / BEGUN).is_file():
        raise NothingYetError(f"{folder} has no complete reconstruction yet")
    raise NothingYetError(f"{folder} has no finished pair yet")


def how_far(folder: Path) -> str:
    """Return what there is of a reconstruction that is being made, in words; nothing of a run."""
    if not (folder / BEGUN).is_file():
        return ""
    pictures, depths = (len(list((folder / part).glob("*.*"))) for part in (PICTURES, DEPTH))
    if not pictures:
        return "frames are read, and its path is found"
    return f"{pictures} frames are read, {depths} of them have depth"


def _require_being_made(folder: Path) -> None:
    """Raise FileNotFoundError if nobody writes to a folder without a result."""
    if is_locked(folder):
        return
    if (folder / BEGUN).is_file():
        raise FileNotFoundError(
            f"the reconstruction in {folder} is not complete, and nobody goes on with it: run the "
            "command again that made it"
        )
    if (folder / RUN).is_file():
        raise FileNotFoundError(f"{folder} has no finished pair, and no run writes to it")
    raise FileNotFoundError(
        f"{folder} is no result of tisfm: it has neither {RUN} nor {RECONSTRUCTION}"
    )
