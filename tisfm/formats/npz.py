"""NumPy's .npz files, written without compression, and checked before any part of them is read.

`numpy.load` unpacks and allocates as much as a damaged or hostile file states. Here no array is
longer than the file.
"""

import contextlib
import errno
import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.formats.atomic import atomic_write
from tisfm.formats.reading import FormatError, open_file

_PART_SUFFIX = ".npy"
_ENCRYPTED_FLAG = 1  # bit in the flags of a part of a ZIP file
ALLOWED_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compressions that NumPy writes. With others, one read may unpack to any size at once."""

DAMAGE_ERRORS = (
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    EOFError,
    LookupError,
    NotImplementedError,
    OSError,
    OverflowError,
    RecursionError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zlib.error,
)
"""Errors that zipfile and NumPy's reader of headers raise for damaged files."""


def write_npz(
    path: str | os.PathLike[str],  # file to write; no suffix is added
    # mapping of str to ndarray: arrays without Python objects, by their names
    arrays: Mapping[str, NDArray[Any]],
) -> None:
    """Write arrays to an .npz file without compression; after an error there is no incomplete file.

    Raises OSError if the file cannot be written.
    """
    with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}{_PART_SUFFIX}", "w", force_zip64=True) as part:
                _write_array(part, array)


def write_npy(path: str | os.PathLike[str], array: NDArray[Any]) -> None:
    """Write an .npy file; after an error there is no incomplete file.

    Errors name the file and the reason, such as a full disk; errors of `numpy.save` do not.

    Raises OSError if the file cannot be written.
    """
    with atomic_write(path) as file:
        _write_array(file, array)


def _write_array(file: Any, array: NDArray[Any]) -> None:
    """Write the header and the values of an array to a file that is open for bytes."""
    contiguous = np.ascontiguousarray(array).reshape(array.shape)  # NumPy changes () to (1,)
    header = np.lib.format.header_data_from_array_1_0(contiguous)
    np.lib.format.write_array_header_1_0(file, header)
    file.write(contiguous.reshape(-1).view(np.uint8).data)


class NpzFile:
    """An .npz file whose parts are checked before they are read.

    No array is longer than the file. Compressed parts are refused, unless `read` is given a
    maximum length.

    Raises FileNotFoundError, IsADirectoryError, OSError if there is no such file, or it cannot be
    read.

    Raises FormatError if the file is not an .npz file, or is cut off.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.name = os.fspath(path)  # path of the file
        self._exit_stack = contextlib.ExitStack()
        file = self._exit_stack.enter_context(open_file(path))
        try:
            self.length = os.fstat(file.fileno()).st_size  # length of the file, bytes
            self._archive = self._exit_stack.enter_context(
                self._call_decoder(zipfile.ZipFile, file)
            )
        except BaseException:
            self._exit_stack.close()
            raise

    def __enter__(self) -> "NpzFile":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._exit_stack.close()

    def __contains__(self, name: str) -> bool:
        return f"{name}{_PART_SUFFIX}" in self._archive.namelist()

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the parts."""
        return (name.removesuffix(_PART_SUFFIX) for name in self._archive.namelist())

    def require_only(self, allowed_names: Collection[str]) -> None:
        """Raise FormatError for a part that is unknown, repeated, compressed or too long."""
        names = set()
        for part in self._archive.infolist():
            name = part.filename.removesuffix(_PART_SUFFIX)
            if name == part.filename or name not in allowed_names:
                raise FormatError(f"{self.name} has the unknown part {part.filename!r}")
            if name in names:
                raise FormatError(f"{self.name} has the part {name} twice")
            self._refuse_compressed(part)
            names.add(name)
        # Parts that overlap in the file may add up to more bytes than the file has.
        if sum(part.file_size for part in self._archive.infolist()) > self.length:
            raise FormatError(f"{self.name} has parts longer than the whole file")

    def header(self, name: str) -> tuple[tuple[int, ...], np.dtype]:
        """Return shape and dtype of an array without reading the array."""
        with self._open_part(name) as part:
            shape, dtype, _ = self._call_decoder(_read_header, name, part)
            return shape, dtype

    def read(
        self,
        name: str,
        *,
        # Maximum length of the array. With this bound, the part may be compressed.
        max_bytes: int | None = None,
    ) -> NDArray[Any]:  # ndarray: writable
        """Read an array.

        Raises FormatError if the part is damaged, longer or shorter than its header states, or
        longer than `max_bytes`.
        """
        allowed_compressions = (
            ALLOWED_COMPRESSIONS if max_bytes is not None else (zipfile.ZIP_STORED,)
        )
        with self._open_part(name, allowed_compressions) as part:
            shape, dtype, start = self._call_decoder(_read_header, name, part)
            expected_length = math.prod(shape) * dtype.itemsize
            stored_length = self._archive.getinfo(f"{name}{_PART_SUFFIX}").file_size - start
            is_too_long = max_bytes is not None and expected_length > max_bytes
            if stored_length != expected_length or dtype.hasobject or is_too_long:
                raise FormatError(
                    f"{self.name} has {stored_length} bytes of {name}, but its header says {shape} "
                    f"{dtype}"
                )
            data = self._call_decoder(part.read, expected_length)
            self._call_decoder(part.read, 1)  # zipfile compares the check sum at the end
        if len(data) != expected_length:
            raise FormatError(f"{self.name} is damaged: {name} is cut off")
        return np.frombuffer(data, dtype).reshape(shape).copy()

    def _open_part(
        self, name: str, allowed_compressions: Collection[int] = (zipfile.ZIP_STORED,)
    ) -> Any:
        part = self._call_decoder(self._archive.getinfo, f"{name}{_PART_SUFFIX}")
        self._refuse_compressed(part, allowed_compressions)
        return self._call_decoder(self._archive.open, part)

    def _refuse_compressed(
        self, part: zipfile.ZipInfo, allowed_compressions: Collection[int] = (zipfile.ZIP_STORED,)
    ) -> None:
        """Raise FormatError for a part of another compression, or longer than the file."""
        name = part.filename.removesuffix(_PART_SUFFIX)
        if part.compress_type not in allowed_compressions or part.flag_bits & _ENCRYPTED_FLAG:
            raise FormatError(
                f"{self.name} has its array {name} compressed or encrypted, which is not read: "
                "save the arrays again with numpy.savez"
            )
        if part.compress_type == zipfile.ZIP_STORED and part.file_size > self.length:
            raise FormatError(f"{self.name} has parts longer than the whole file")

    def _call_decoder(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a decoder; turn the errors that it raises for a damaged file into a FormatError."""
        try:
            return function(*arguments)
        except DAMAGE_ERRORS as error:
            if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
                raise  # an error of the disk (EINVAL: a seek to before the start of the file)
            reason = " ".join(str(error).split())
            raise FormatError(f"{self.name} is not a complete .npz file: {reason}") from error


def _read_header(name: str, part: Any) -> tuple[tuple[int, ...], np.dtype, int]:
    """Return shape and dtype, and the position where the values begin."""
    version = np.lib.format.read_magic(part)
    if version != (1, 0):
        raise InputError(f"the header of {name} is of version {version}, expected (1, 0)")
    shape, is_by_columns, dtype = np.lib.format.read_array_header_1_0(part)
    if is_by_columns and len(shape) > 1:
        raise InputError(f"{name} is stored by columns, expected by rows")
    if any(side < 0 for side in shape):
        raise InputError(f"{name} is of the shape {shape}")
    return shape, dtype, part.tell()
