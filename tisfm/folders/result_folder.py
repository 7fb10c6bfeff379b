"""Folders for results: one run at a time writes to each, and no result replaces an input file."""

import contextlib
import os
import secrets
import shutil
import tempfile
import threading
from collections.abc import Hashable, Iterable, Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from tisfm.errors import InputError
from tisfm.formats.atomic import BEGINNING, ENDING, is_temporary


def is_there(path: Path) -> bool:
    """Return whether a path exists; a link to nothing counts."""
    return os.path.lexists(path)


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with its contents, if it exists.

    The target of a link stays.

    Raises
    ------
    OSError
        If it cannot be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def try_to_remove(path: Path) -> None:
    """Remove as `remove` does, but leave what cannot be removed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def remove_link(path: Path) -> None:
    """Remove a path if it is a link."""
    if path.is_symlink():
        path.unlink()


def make_inner_folder(path: Path) -> Path:
    """Make a folder within a folder for results, unless it exists; return its path.

    A link in its place is removed: it may lead out of the folder for results. The folder for
    results itself may be a link.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    remove_link(path)
    try:
        path.mkdir(exist_ok=True)
    except FileExistsError as error:
        raise FileExistsError(
            f"{path} is a file, but a folder with this name is needed: move or delete the file"
        ) from error
    return path


Paths = Iterable[str | os.PathLike[str]]


class InputFiles:
    """The files that a command reads, none of which a result may replace.

    Files are compared by what they are, not by how they are called: through symbolic and hard
    links, "..", and names that a file system takes for the same.

    Parameters
    ----------
    files : iterable of paths
        Those that do not exist do not count.
    """

    def __init__(self, files: Paths = ()) -> None:
        self._known: dict[Hashable, str] = {
            identity: os.fspath(file) for file in files for identity in _identities(file)
        }

    def refuse(self, *outputs: str | os.PathLike[str]) -> None:
        """Raise an error if a result would replace one of the files.

        Parameters
        ----------
        *outputs : path
            Files about to be written, whether they exist or not.

        Raises
        ------
        ValueError
            If one of them is one of the files.
        """
        for output in outputs:
            for identity in _identities(output):
                if identity in self._known:
                    raise InputError(
                        f"the result {os.fspath(output)} would replace "
                        f"{self._known[identity]}, which is read: give another folder with -o"
                    )


def make_folder(folder: str | os.PathLike[str]) -> Path:
    """Make a folder for results, unless there is one, and check that it can be written to.

    Raises
    ------
    OSError
        If it cannot be made or written to.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise type(error)(
            f"cannot write results to the folder {folder} ({error.strerror}): give another with -o"
        ) from error
    return folder


def _identities(path: str | os.PathLike[str]) -> Iterator[Hashable]:
    """Yield by what a file that exists is known: its number, if it has one, and its real path."""
    with contextlib.suppress(OSError, ValueError):  # there is no such file, and can be none
        about = os.stat(path)
        if about.st_ino:  # 0 where the file system numbers nothing
            yield about.st_dev, about.st_ino
        yield os.path.normcase(os.path.realpath(path))


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
