"""Removing and making entries of a folder for results, without following links."""

import contextlib
import os
import shutil
from pathlib import Path


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
