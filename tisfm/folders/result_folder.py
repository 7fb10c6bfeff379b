"""Folders of results: one run at a time writes to a folder, and no result replaces an input.

These functions do not follow links inside a folder of results, since such a link may lead out of
the folder. The folder itself may be a link.
"""

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
from tisfm.formats.atomic import TEMPORARY_PREFIX, TEMPORARY_SUFFIX, is_temporary

LOCK = ".tisfm.lock"
"""Name of the lock file of a folder; a run that writes to the folder has its lock."""

# s: longest wait for the lock. `is_locked` in another process takes it for an instant. A guess.
_LOCK_TIMEOUT = 0.2
_LOCK_POLL_INTERVAL = 0.02  # s between two attempts; a guess
_thread_state = threading.local()  # .reentrant: folders that the thread locked as reentrant

Paths = Iterable[str | os.PathLike[str]]


class FolderInUseError(OSError):
    """Another run writes to the folder."""


class InputFiles:
    """The files that a command reads. No result may replace them.

    Files are compared by their identity in the file system, not by their names: symbolic and hard
    links, "..", and names that differ only in case may all lead to one file.
    """

    def __init__(
        self,
        files: Paths = (),  # files that do not exist are ignored
    ) -> None:
        self._file_names: dict[Hashable, str] = {
            identity: os.fspath(file) for file in files for identity in _identities(file)
        }

    def refuse(
        self,
        # files that a command will write; they may exist or not
        *outputs: str | os.PathLike[str],
    ) -> None:
        """Raise an error if a result would replace one of the files.

        Raises ValueError if an output is one of the input files.
        """
        for output in outputs:
            for identity in _identities(output):
                if identity in self._file_names:
                    raise InputError(
                        f"the result {os.fspath(output)} would replace the input "
                        f"{self._file_names[identity]}: give another folder with -o"
                    )


@contextlib.contextmanager
def locked_folder(
    folder: str | os.PathLike[str],  # an existing folder
    *,
    # whether the same thread may lock the folder again within the block; these inner blocks do
    # nothing
    reentrant: bool = False,
) -> Iterator[None]:
    """Lock a folder within the block, and remove the temporary files of killed runs.

    The operating system releases the lock when the process ends, even if it is killed.

    Raises FolderInUseError, an OSError, if another run has the lock.
    """
    path = Path(folder)
    reentrant_folders: set[Path] = _thread_state.__dict__.setdefault("reentrant", set())
    real_path = path.resolve()
    if real_path in reentrant_folders:
        yield
        return
    remove_link(path / LOCK)
    lock = FileLock(path / LOCK)
    try:
        lock.acquire(timeout=_LOCK_TIMEOUT, poll_interval=_LOCK_POLL_INTERVAL)
    except Timeout:
        raise FolderInUseError(
            f"another run writes to {path}: wait until it ends, or give another folder with -o"
        ) from None
    except NotImplementedError:  # the file system has no locks
        yield
        return
    if reentrant:
        reentrant_folders.add(real_path)
    try:
        remove_temporaries(path)
        yield
        remove_temporaries(path)  # files of killed worker processes of this run
    finally:
        reentrant_folders.discard(real_path)
        with contextlib.suppress(OSError):  # Windows does not remove an open file
            os.unlink(path / LOCK)
        lock.release()


def is_locked(folder: str | os.PathLike[str]) -> bool:
    """Return whether another run has the lock of a folder.

    The existence of the lock file is not enough, since a killed run leaves this file. The answer is
    also True if it is unknown: the file system has no locks, or another user owns the file.
    """
    path = Path(folder) / LOCK
    if not path.is_file():
        return False
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except (Timeout, NotImplementedError, PermissionError):
        return True
    except OSError:  # the folder was removed meanwhile
        return False
    lock.release()
    return False


@contextlib.contextmanager
def presence_file(folder: Path) -> Iterator[Path]:
    """Make a file that exists within the block; it shows other processes that this process runs.

    If this process is killed, the next run removes the file, as all temporary files.
    """
    path = folder / f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}{TEMPORARY_SUFFIX}"
    path.touch()
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def make_result_folder(folder: str | os.PathLike[str]) -> Path:
    """Make a folder for results, unless it exists, and check that files can be written to it.

    Raises OSError if the folder cannot be made or written to.
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


def make_subfolder(path: Path) -> Path:
    """Make a folder inside a folder for results, unless it exists; return its path.

    A link of this name is removed first.

    Raises OSError if the folder cannot be made.
    """
    remove_link(path)
    try:
        path.mkdir(exist_ok=True)
    except FileExistsError as error:
        raise FileExistsError(
            f"{path} is a file, but a folder with this name is needed: move or delete the file"
        ) from error
    return path


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with its contents, if it exists.

    The target of a link stays.

    Raises OSError if the path cannot be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def try_to_remove(path: Path) -> None:
    """Remove as `remove` does, but leave files that cannot be removed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def remove_link(path: Path) -> None:
    """Remove a path if it is a link."""
    if path.is_symlink():
        path.unlink()


def remove_temporaries(folder: Path) -> None:
    """Remove the temporary files of killed processes in a folder."""
    for item in folder.iterdir():
        if is_temporary(item.name):
            remove(item)


def _identities(path: str | os.PathLike[str]) -> Iterator[Hashable]:
    """Yield the identities of a file: its inode, if the file exists, and its real path."""
    with contextlib.suppress(OSError, ValueError):  # there is no such file, or no such name
        status = os.stat(path)
        if status.st_ino:  # 0 where the file system has no inode numbers
            yield status.st_dev, status.st_ino
        yield os.path.normcase(os.path.realpath(path))
