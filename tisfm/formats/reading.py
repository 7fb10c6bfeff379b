"""Whole files into memory, with errors that say what to do."""

import os

from tisfm.formats.errors import FormatError


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a whole file.

    Parameters
    ----------
    path : str or os.PathLike
        File to read.

    Returns
    -------
    bytes
        Its contents, at least one byte.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    IsADirectoryError
        If `path` is a folder.
    OSError
        If the file cannot be read for another reason.
    FormatError
        If the file is empty.
    """
    name = os.fspath(path)
    # Asked first because Windows reports an opened folder as a lack of permission.
    if os.path.isdir(name):
        raise IsADirectoryError(f"{name} is a folder, not a file: give the path of one file in it")
    try:
        with open(name, "rb") as file:
            data = file.read()
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{name} does not exist: check the path (relative paths start at {os.getcwd()})"
        ) from error
    except OSError as error:
        raise type(error)(
            f"{name} cannot be read ({error.strerror}): check the path and its permissions"
        ) from error
    if not data:
        raise FormatError(f"{name} is empty (0 bytes): write or download it again")
    return data
