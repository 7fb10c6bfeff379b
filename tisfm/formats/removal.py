"""What lies in a folder for results is removed as it lies there: links are not followed."""

import contextlib
import os
import shutil
from pathlib import Path


def is_there(path: Path) -> bool:
    """Return whether there is anything of this name, a link to nothing included."""
    return os.path.lexists(path)


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with all that is in it; nothing if there is none.

    What a link leads to stays.

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
    """Do what `remove` does, as far as it can be done."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def remove_link(path: Path) -> None:
    """Remove a link; what is no link stays."""
    if path.is_symlink():
        path.unlink()


def make_inner_folder(path: Path) -> Path:
    """Make a folder within one for results, unless there is one; return its path.

    A link in its place is removed: it may lead out of the folder for results. The folder for
    results itself may be a link.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    remove_link(path)
    path.mkdir(exist_ok=True)
    return path
