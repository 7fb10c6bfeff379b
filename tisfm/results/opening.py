"""Opening the folder of a result, whichever command wrote it."""

from pathlib import Path

from tisfm.errors import InputError
from tisfm.folders.result_folder import is_locked
from tisfm.folders.run_record import RECORD as RUN
from tisfm.reconstruction.result.folder import DEPTH, MARKER, PICTURES
from tisfm.reconstruction.result.folder import RECORD as RECONSTRUCTION
from tisfm.results.pair_frames import PairFrames
from tisfm.results.result_frames import ResultFrames
from tisfm.results.sequence_frames import SequenceFrames


class NotReadyError(InputError):
    """A command still writes the result, and no frame is complete."""


def open_result(folder: Path) -> ResultFrames:
    """Open the folder of `tisfm run` or `tisfm reconstruct`, also while a run goes on.

    Raises FileNotFoundError, NotADirectoryError if there is no such folder, or it has no result and
    no command writes to it.

    Raises NotReadyError, a ValueError, if a command writes to the folder, and no frame is complete.

    Raises tisfm.formats.FormatError, a ValueError, if a file is damaged.
    """
    if not folder.exists():
        raise FileNotFoundError(f"there is no folder {folder}")
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder} is not a folder: give the folder that a command wrote")
    if (folder / RECONSTRUCTION).is_file():
        return SequenceFrames.open(folder)
    if (folder / RUN).is_file():
        pairs = PairFrames(folder, complete=False)
        if pairs.names:
            return pairs
    _require_writer(folder)
    if (folder / MARKER).is_file():
        raise NotReadyError(f"{folder} has no complete reconstruction yet")
    raise NotReadyError(f"{folder} has no finished pair yet")


def describe_progress(folder: Path) -> str:
    """Return how far a reconstruction is, in words; empty for a run."""
    if not (folder / MARKER).is_file():
        return ""
    pictures, depths = (len(list((folder / part).glob("*.*"))) for part in (PICTURES, DEPTH))
    if not pictures:
        return "tisfm reads the frames and computes the path of the camera"
    return f"{pictures} frames are read, {depths} of them have depth"


def _require_writer(folder: Path) -> None:
    """Raise FileNotFoundError if no command writes to a folder without a result."""
    if is_locked(folder):
        return
    if (folder / MARKER).is_file():
        raise FileNotFoundError(
            f"the reconstruction in {folder} is not complete, and no command writes to it: run "
            "tisfm reconstruct again"
        )
    if (folder / RUN).is_file():
        raise FileNotFoundError(
            f"{folder} has no finished pair, and no command writes to it: run tisfm run again"
        )
    raise FileNotFoundError(
        f"{folder} is not a result of tisfm: it has neither {RUN} nor {RECONSTRUCTION}"
    )
