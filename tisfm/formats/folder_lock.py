"""One run at a time in a folder, and nothing left of those that were killed."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from tisfm.formats.atomic import BEGINNING, ENDING, is_temporary

LOCK = ".tisfm.lock"


class FolderInUseError(OSError):
    """Another run writes to the folder."""


@contextlib.contextmanager
def locked_folder(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Let nobody else write to a folder within the block, and remove what killed runs left half.

    The lock belongs to the process: it ends with it, however that ends.

    Parameters
    ----------
    folder : path
        There is one.

    Raises
    ------
    FolderInUseError
        An OSError: if another run is in such a block with it.
    """
    path = Path(folder)
    lock = FileLock(path / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise FolderInUseError(
            f"another run writes to {path}: wait until it ends, or give another folder with -o"
        ) from None
    except NotImplementedError:  # a file system without locks
        yield
        return
    try:
        remove_temporaries(path)
        yield
        remove_temporaries(path)  # of processes of this run that were killed
    finally:
        with contextlib.suppress(OSError):  # Windows removes no open file
            os.unlink(path / LOCK)
        lock.release()


@contextlib.contextmanager
def alive_in(folder: Path) -> Iterator[Path]:
    """Make a file that is there within the block, by which other processes know that it goes on.

    That of a process that was killed counts as temporary, and goes with the next one.
    """
    path = folder / f"{BEGINNING}{secrets.token_hex(8)}{ENDING}"
    path.touch()
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def remove_temporaries(folder: Path) -> None:
    """Remove what killed processes left half in a folder."""
    for item in folder.iterdir():
        if is_temporary(item.name):
            item.unlink(missing_ok=True)
