"""Which kind of result lies in a folder."""

from pathlib import Path

from tisfm.formats.folder_lock import LOCK
from tisfm.reconstruction.folder import BEGUN
from tisfm.reconstruction.folder import RECORD as RECONSTRUCTION
from tisfm.view.reconstruction_result import ReconstructionResult
from tisfm.view.result import Result
from tisfm.view.run_result import RECORD as RUN
from tisfm.view.run_result import RunResult


class NothingYetError(ValueError):
    """A result is being made, and has no frame yet that can be looked at."""


def open_result(folder: Path) -> Result:
    """Open what `tisfm run` or `tisfm reconstruct` wrote, or is writing.

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        If there is no such folder, or it has no result.
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
        if not result.names:
            raise NothingYetError(f"{folder} has no finished pair yet")
        return result
    if (folder / BEGUN).is_file():
        raise NothingYetError(f"{folder} has no complete reconstruction yet")
    if (folder / LOCK).is_file():
        raise NothingYetError(f"{folder} has no finished pair yet")
    raise FileNotFoundError(
        f"{folder} is no result of tisfm: it has neither {RUN} nor {RECONSTRUCTION}"
    )
