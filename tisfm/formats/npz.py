"""Arrays in one file: NumPy's .npz, stored as they are, and read with no trust in what it says."""

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

_SUFFIX = ".npy"
PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may unpack to any size at once
_ENCRYPTED = 1  # bit of a part's flags
# What zipfile and NumPy's reader of headers raise for damaged files.
DAMAGE = (
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


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to an .npz file without compression, whole or not at all.

    Parameters
    ----------
    path : path
        File to write; no suffix is added.
    arrays : mapping of str to ndarray
        Arrays without Python objects, by their name.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with (
        atomic_write(path) as file,
        zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive,
    ):
        for name, array in arrays.items():
            with archive.open(f"{name}{_SUFFIX}", "w", force_zip64=True) as part:
                _write_array(part, array)


def write_npy(path: str | os.PathLike[str], array: NDArray[Any]) -> None:
    """Write an array for `numpy.load`, completely or not at all.

    Unlike `numpy.save`, an error names the file and the reason, such as a full disk.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with atomic_write(path) as file:
        _write_array(file, array)


def _write_array(file: Any, array: NDArray[Any]) -> None:
    """Write the header and the numbers of an array to a file that is open for bytes."""
    whole = np.ascontiguousarray(array).reshape(array.shape)  # it changes () to (1,)
    header = np.lib.format.header_data_from_array_1_0(whole)
    np.lib.format.write_array_header_1_0(file, header)
    file.write(whole.reshape(-1).view(np.uint8).data)


class NpzFile:
    """An .npz file whose parts are looked at before they are read.

    No array that comes out is longer than the file. Nothing is unpacked, but for parts that are
    read up to a given length.

    Parameters
    ----------
    path : path

    Attributes
    ----------
    name : str
    length : int
        Of the file, bytes.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        If there is no such file, or it cannot be read.
    FormatError
        If it is not an .npz file, or cut off.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.name = os.fspath(path)
        self._opened = contextlib.ExitStack()
        file = self._opened.enter_context(open_file(path))
        try:
            self.length = os.fstat(file.fileno()).st_size
            self._archive = self._opened.enter_context(self._checked(zipfile.ZipFile, file))
        except BaseException:
            self._opened.close()
            raise

    def __enter__(self) -> "NpzFile":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._opened.close()

    def __contains__(self, name: str) -> bool:
        return f"{name}{_SUFFIX}" in self._archive.namelist()

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the parts."""
        return (name.removesuffix(_SUFFIX) for name in self._archive.namelist())

    def require_only(self, known: Collection[str]) -> None:
        """Raise FormatError for a part that is not known, twice there, packed or too long."""
        seen = set()
        for part in self._archive.infolist():
            name = part.filename.removesuffix(_SUFFIX)
            if name == part.filename or name not in known:
                raise FormatError(f"{self.name} has the unknown part {part.filename!r}")
            if name in seen:
                raise FormatError(f"{self.name} has the part {name} twice")
            self._refuse_packed(part)
            seen.add(name)
        # Parts that overlap in the file may add up to more than it holds.
        if sum(part.file_size for part in self._archive.infolist()) > self.length:
            raise FormatError(f"{self.name} has parts longer than the whole file")

    def header(self, name: str) -> tuple[tuple[int, ...], np.dtype]:
        """Return shape and type of an array without reading it."""
        with self._part(name) as part:
            shape, dtype, _ = self._checked(_read_header, name, part)
            return shape, dtype

    def read(self, name: str, *, most: int | None = None) -> NDArray[Any]:
        """Read an array.

        Parameters
        ----------
        name : str
        most : int, optional
            Bytes beyond which it is refused. It may be packed then.

        Returns
        -------
        ndarray
            Writable.

        Raises
        ------
        FormatError
            If it is damaged, longer or shorter than its header says, or longer than `most`.
        """
        with self._part(name, PACKINGS if most is not None else (zipfile.ZIP_STORED,)) as part:
            shape, dtype, start = self._checked(_read_header, name, part)
            expected = math.prod(shape) * dtype.itemsize
            declared = self._archive.getinfo(f"{name}{_SUFFIX}").file_size - start
            if declared != expected or dtype.hasobject or (most is not None and expected > most):
                raise FormatError(
                    f"{self.name} has {declared} bytes of {name}, but its header says {shape} "
                    f"{dtype}"
                )
            data = self._checked(part.read, expected)
            self._checked(part.read, 1)  # the end, where the check sum is compared
        if len(data) != expected:
            raise FormatError(f"{self.name} is damaged: {name} is cut off")
        return np.frombuffer(data, dtype).reshape(shape).copy()

    def _part(self, name: str, packings: Collection[int] = (zipfile.ZIP_STORED,)) -> Any:
        part = self._checked(self._archive.getinfo, f"{name}{_SUFFIX}")
        self._refuse_packed(part, packings)
        return self._checked(self._archive.open, part)

    def _refuse_packed(
        self, part: zipfile.ZipInfo, packings: Collection[int] = (zipfile.ZIP_STORED,)
    ) -> None:
        """Raise FormatError for a part that is packed in another way, or longer than the file."""
        name = part.filename.removesuffix(_SUFFIX)
        if part.compress_type not in packings or part.flag_bits & _ENCRYPTED:
            raise FormatError(f"{self.name} has {name} compressed or encrypted: unpack it")
        if part.compress_type == zipfile.ZIP_STORED and part.file_size > self.length:
            raise FormatError(f"{self.name} has parts longer than the whole file")

    def _checked(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a decoder; what a damaged file leads it to raise becomes a FormatError."""
        try:
            return function(*arguments)
        except DAMAGE as error:
            if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
                raise  # of the disk; EINVAL is a seek to before the file's beginning
            reason = " ".join(str(error).split())
            raise FormatError(f"{self.name} is not a whole .npz file: {reason}") from error


def _read_header(name: str, part: Any) -> tuple[tuple[int, ...], np.dtype, int]:
    """Return shape and type, and where the numbers begin."""
    version = np.lib.format.read_magic(part)
    if version != (1, 0):
        raise InputError(f"the header of {name} is of version {version}, expected (1, 0)")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(part)
    if by_columns and len(shape) > 1:
        raise InputError(f"{name} is stored by columns, expected by rows")
    if any(side < 0 for side in shape):
        raise InputError(f"{name} is of the shape {shape}")
    return shape, dtype, part.tell()
