"""What every piece of work checks in the process that it has come to, and how it tells errors."""

from pathlib import Path

from tisfm.errors import OutOfMemoryError, RunError, TisfmError
from tisfm.machine.memory import advice
from tisfm.version import __version__


def check_worker(version: str, alive: Path, *, lanes: int, here: int) -> None:
    """Refuse work of another version, in a folder that is not seen here, or of other vectors.

    Parameters
    ----------
    version : str
        Of tisfm, in the process that gives the work.
    alive : Path
        A file that is there as long as that process waits for the work.
    lanes, here : int
        Of the vectors of that process' CPU, and of this one's.

    Raises
    ------
    RuntimeError
    """
    if version != __version__:
        raise RunError(
            f"a worker has tisfm {__version__}, but the command was started by {version}: install "
            "the same everywhere"
        )
    if not alive.exists():
        raise RunError(
            f"a worker does not see the folder {alive.parent} of the command: give a folder that "
            "all machines share, by the same path"
        )
    if lanes != here:
        raise RunError(
            f"a worker's processor has vectors of {here} lanes, and that of the command {lanes}: "
            "their results differ in the last digits; leave such machines out"
        )


def stated(error: Exception) -> Exception:
    """Return an error that is to be told, as it goes to the process that gave the work."""
    if isinstance(error, MemoryError) and not isinstance(error, TisfmError):
        return OutOfMemoryError(advice())
    return error.with_traceback(None)
