"""A cache on disk for arrays of every frame: memory does not grow with the length of a sequence."""

import contextlib
import errno
import math
import tempfile
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import IO, Generic, TypeVar

import numpy as np

T = TypeVar("T")
# Error numbers of a full disk, or of a full quota where the system has quotas
DISK_FULL_ERRORS = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))


class DiskCache(Sequence[T], Generic[T]):
    """A sequence of items in a temporary file; each access reads its item from the file.

    The file lies in the folder of `tempfile.gettempdir`, and is deleted with this object.
    """

    def __init__(
        self,
        to_arrays: Callable[[T], tuple[np.ndarray, ...]],  # returns the arrays of an item
        from_arrays: Callable[..., T],  # returns the item with these arrays
    ) -> None:
        self._to_arrays, self._from_arrays = to_arrays, from_arrays
        self._file = tempfile.TemporaryFile(prefix="tisfm-")  # noqa: SIM115
        weakref.finalize(self, _close, self._file)
        self._file_size = 0
        # For each item: its offset in the file in bytes, and the dtype and shape of each array
        self._items: list[tuple[int, tuple[tuple[str, tuple[int, ...]], ...]]] = []

    def append(self, item: T) -> None:
        """Add an item to the end.

        Raises OSError if the temporary file cannot be written.
        """
        arrays = [np.ascontiguousarray(array) for array in self._to_arrays(item)]
        try:
            self._file.seek(self._file_size)
            for array in arrays:
                self._file.write(array.tobytes())
            self._file.flush()
        except OSError as error:  # for example, the disk is full
            # Another folder does not help against a limit on the size of files (ulimit -f).
            advice = "; set TMPDIR to another folder" if error.errno in DISK_FULL_ERRORS else ""
            raise OSError(
                f"cannot write a temporary file in {tempfile.gettempdir()}: "
                f"{error.strerror}{advice}"
            ) from error
        layouts = tuple((array.dtype.str, array.shape) for array in arrays)
        self._items.append((self._file_size, layouts))
        self._file_size += sum(array.nbytes for array in arrays)

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, number: int) -> T:  # type: ignore[override]
        offset, layouts = self._items[number]
        self._file.seek(offset)
        arrays = []
        for dtype, shape in layouts:
            size = np.dtype(dtype).itemsize * math.prod(shape)
            buffer = bytearray(self._file.read(size))  # a bytearray makes the arrays writable
            arrays.append(np.frombuffer(buffer, dtype).reshape(shape))
        return self._from_arrays(*arrays)

    def __iter__(self) -> Iterator[T]:
        return (self[number] for number in range(len(self)))


def _close(file: IO[bytes]) -> None:
    """Close a temporary file; the last write may fail on a full disk."""
    with contextlib.suppress(OSError):
        file.close()
