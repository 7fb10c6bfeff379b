"""Files that appear complete or not at all."""

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from typing import BinaryIO

from tisfm.formats.reading import open_file

TEMPORARY_PREFIX = ".tisfm-"
TEMPORARY_SUFFIX = ".tmp"
# Error numbers of a full or failing disk.
_DISK_ERROR_NUMBERS = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EIO, errno.EFBIG)
# Bytes. Each write to the disk releases and takes Python's lock, for which other threads compete:
# a large buffer needs few writes.
_BUFFER_SIZE = 2**20


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str], *, durable: bool = False) -> Iterator[BinaryIO]:
    """Write a file that replaces `path` only when the block ends without an exception.

    The block writes to a temporary file in the same folder, so that replacing is one rename
    within one file system. After any exception, ``KeyboardInterrupt`` included, the temporary
    file is removed and the file that was at `path` before is untouched. A symbolic link at `path`
    is replaced as well: its target stays as it is. The folder may be a link.

    Parameters
    ----------
    path : str or os.PathLike
        File to write. Its folder must exist.
    durable : bool, default False
        Whether to wait until the file is on the disk, so that it is complete even after a power
        failure. This is slow. Of the hundreds of files of a sequence, only the record, which lists
        the others, is written in this way.

    Yields
    ------
    BinaryIO
        The temporary file, open for writing bytes.

    Raises
    ------
    FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError, OSError
        If the file cannot be written; the text says what to do.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tisfm.formats import atomic_write
    >>> with atomic_write("note.txt") as file:
    ...     _ = file.write(b"complete")
    >>> Path("note.txt").read_bytes()
    b'complete'
    """
    name = os.fspath(path)
    target = os.path.join(os.path.realpath(os.path.dirname(name)), os.path.basename(name))
    if os.path.isdir(target):
        raise IsADirectoryError(f"cannot write {name}: it is a folder; give the path of a file")
    if os.path.exists(target) and not os.path.isfile(target):
        # Renaming over a device or a pipe, or a link to one, would delete it: root could lose
        # /dev/null.
        raise OSError(f"cannot write {name}: it is a device or a pipe, not a file; give a file")
    folder = os.path.dirname(target)
    # The name of the target is not part of this name: it may be as long as the system allows.
    temporary = os.path.join(folder, f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}{TEMPORARY_SUFFIX}")
    try:
        # Plain open, not tempfile.mkstemp: the file gets the permissions the user's umask asks for.
        file = open(temporary, "xb", _BUFFER_SIZE)  # noqa: SIM115 (closed below, before the rename)
    except OSError as error:
        raise _explain_error(error, name, folder) from error
    try:
        with file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        try:
            os.replace(temporary, target)
        except OSError as error:
            raise _explain_error(error, name, folder) from error
    except BaseException as error:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        if isinstance(error, OSError) and error.strerror and error.errno in _DISK_ERROR_NUMBERS:
            raise _explain_error(error, name, folder) from error
        raise


def copy_file(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    """Copy a file; after an error there is no incomplete copy.

    Raises OSError if the source cannot be read, or the target cannot be written.
    """
    with open_file(source) as original, atomic_write(target) as file:
        shutil.copyfileobj(original, file, _BUFFER_SIZE)


def link_or_copy(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    """Give a file a second name by a hard link; copy it where the file system has no hard links.

    The file behind a symbolic link is copied: the target is never a symbolic link.

    Raises OSError if the source cannot be read, or the target cannot be written.
    """
    if not os.path.islink(source):
        with contextlib.suppress(OSError):
            os.link(source, target)
            return
    copy_file(source, target)


def is_temporary(name: str) -> bool:
    """Return whether a file has the name of a file that `atomic_write` did not finish."""
    return name.startswith(TEMPORARY_PREFIX) and name.endswith(TEMPORARY_SUFFIX)


def _explain_error(error: OSError, name: str, folder: str) -> OSError:
    """Return an error of the same kind whose text names the file and says what to do."""
    if isinstance(error, FileNotFoundError):
        advice = f"the folder {folder} does not exist; create it first or give another path"
    elif isinstance(error, NotADirectoryError):
        advice = f"{folder} is not a folder; give a path in a folder"
    elif isinstance(error, PermissionError):
        advice = f"no permission to write in {folder}; give a path in a folder of your own"
    else:
        advice = f"{error.strerror}; give a path in another folder"
    # A class of a library may take other arguments: raise the built-in class that it derives from.
    error_class = next(base for base in type(error).__mro__ if base.__module__ == "builtins")
    new_error: OSError = error_class(f"cannot write {name}: {advice}")
    new_error.errno = error.errno
    return new_error
