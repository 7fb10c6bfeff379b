"""Files read whole into memory, as bytes, text or JSON; errors name the file and say what to do."""

import contextlib
import json
import os
import stat
from collections.abc import Iterator
from typing import Any, BinaryIO

import cv2

from tisfm.errors import InputError, OutOfMemoryError


class FormatError(InputError):
    """A file is damaged, incomplete or not of the format it was read as.

    The message is one line that names the file and its fault.
    """


def read_bytes(
    path: str | os.PathLike[str],  # file to read
) -> bytes:  # its contents, at least one byte
    """Read a whole file.

    Raises FileNotFoundError if there is no such file.

    Raises IsADirectoryError if `path` is a folder.

    Raises OSError if `path` is a device or a pipe, or the file cannot be read for another reason.

    Raises FormatError if the file is empty.
    """
    with open_file(path) as file:
        try:
            data = file.read()
        except OSError as error:
            raise _explain_error(error, os.fspath(path)) from error
    if not data:
        raise FormatError(f"{os.fspath(path)} is empty (0 bytes): write or download it again")
    return data


def open_file(
    path: str | os.PathLike[str],  # file to read
) -> BinaryIO:  # the caller closes it
    """Open a file for reading bytes.

    Raises FileNotFoundError, IsADirectoryError, OSError: as `read_bytes`.
    """
    name = os.fspath(path)
    try:
        # Checked before opening: opening a pipe waits for a writer, reading a device may never
        # end, and Windows reports opening a folder as a lack of permission.
        mode = os.stat(name).st_mode
        if stat.S_ISREG(mode):
            return open(name, "rb")
    except OSError as error:
        raise _explain_error(error, name) from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(f"{name} is a folder, not a file: give the path of one file in it")
    raise OSError(f"{name} is a device or a pipe, not a file: save its data to a file first")


@contextlib.contextmanager
def opencv_memory_errors(
    name: str,  # file that is read or written, for the message
) -> Iterator[None]:
    """Turn OpenCV's error for too little memory into a MemoryError."""
    try:
        yield
    except cv2.error as error:
        if getattr(error, "code", None) != cv2.Error.StsNoMem:
            raise
        raise OutOfMemoryError(f"there is not enough memory for {name}") from error


def _explain_error(error: OSError, name: str) -> OSError:
    """Return an error of the same class whose text names the file and says what to do."""
    if isinstance(error, FileNotFoundError):
        return FileNotFoundError(
            f"{name} does not exist: check the path (relative paths start at {os.getcwd()})"
        )
    return type(error)(
        f"{name} cannot be read ({error.strerror}): check the path and its permissions"
    )


def read_text(path: str | os.PathLike[str]) -> str:
    """Read a text in UTF-8, with or without a byte-order mark.

    Bytes that are not UTF-8 become U+FFFD: that is harmless in a comment, and fails as a number.

    Raises OSError, FormatError: as `tisfm.formats.reading.read_bytes`.
    """
    return read_bytes(path).decode("utf-8-sig", "replace")


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read JSON.

    Raises FormatError if the file is not JSON, is nested too deeply, or has a number of thousands
    of digits.

    Raises OSError: as `tisfm.formats.reading.read_bytes`.
    """
    data = read_bytes(path)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise FormatError(f"{os.fspath(path)} is damaged, or not JSON: {reason}") from error
