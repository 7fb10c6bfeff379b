"""One run at a time in a folder, and nothing left of those that were killed."""

import contextlib
import os
import secrets
import threading
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from tisfm.formats.atomic import BEGINNING, ENDING, is_temporary
from tisfm.formats.removal import remove, remove_link

LOCK = ".tisfm.lock"
_PATIENCE, _POLL = 0.2, 0.02  # s: who only looks whether a lock is held has it for a moment
_of_thread = threading.local()  # the folders that it has locked


class FolderInUseError(OSError):
    """Another run writes to the folder."""


@contextlib.contextmanager
def locked_folder(folder: str | os.PathLike[str], *, with_inner: bool = False) -> Iterator[None]:
    """Let nobody else write to a folder within the block, and remove what killed runs left half.

    The lock belongs to the process: it ends with it, however that ends.

    Parameters
    ----------
    folder : path
        There is one.
    with_inner : bool
        Whether blocks of the same thread within this one are part of it, rather than another run.

    Raises
    ------
    FolderInUseError
        An OSError: if another run is in such a block with it.
    """
    path = Path(folder)
    held: set[Path] = _of_thread.__dict__.setdefault("held", set())
    name = path.resolve()
    if name in held:
        yield
        return
    remove_link(path / LOCK)
    lock = FileLock(path / LOCK)
    try:
        lock.acquire(timeout=_PATIENCE, poll_interval=_POLL)
    except Timeout:
        raise FolderInUseError(
            f"another run writes to {path}: wait until it ends, or give another folder with -o"
        ) from None
    except NotImplementedError:  # a file system without locks
        yield
        return
    if with_inner:
        held.add(name)
    try:
        remove_temporaries(path)
        yield
        remove_temporaries(path)  # of processes of this run that were killed
    finally:
        held.discard(name)
        with contextlib.suppress(OSError):  # Windows removes no open file
            os.unlink(path / LOCK)
        lock.release()


def is_written_to(folder: str | os.PathLike[str]) -> bool:
    """Return whether another run holds the lock of a folder; the file alone says nothing.

    True also where that cannot be known: the file system has no locks, or the file is of somebody
    else.
    """
    path = Path(folder) / LOCK
    if not path.is_file():
        return False
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except (Timeout, NotImplementedError, PermissionError):
        return True
    except OSError:  # the folder has just gone
        return False
    lock.release()
    return False


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
            remove(item)
