"""A cache on disk for arrays of every frame, so that memory does not grow with a sequence."""

import contextlib
import errno
import math
import tempfile
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import IO, Generic, TypeVar

import numpy as np

T = TypeVar("T")
_FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))


class DiskCache(Sequence[T], Generic[T]):
    """A sequence of items in a temporary file; each access reads its item from the file.

    The file lies in the folder of `tempfile.gettempdir`, and is deleted with this object.
    """

    def __init__(
        self,
        arrays_of: Callable[[T], tuple[np.ndarray, ...]],  # returns the arrays of an item
        made_of: Callable[..., T],  # returns the item for such arrays
    ) -> None:
        self._arrays_of, self._made_of = arrays_of, made_of
        self._file = tempfile.TemporaryFile(prefix="tisfm-")  # noqa: SIM115
        weakref.finalize(self, _close, self._file)
        self._end = 0
        # For each item: its offset in the file, bytes, and the dtype and shape of each array.
        self._items: list[tuple[int, tuple[tuple[str, tuple[int, ...]], ...]]] = []

    def append(self, item: T) -> None:
        """Add an item to the end.

        Raises OSError if the temporary file cannot be written.
        """
        arrays = [np.ascontiguousarray(array) for array in self._arrays_of(item)]
        try:
            self._file.seek(self._end)
            for array in arrays:
                self._file.write(array.tobytes())
            self._file.flush()
        except OSError as error:  # for example, the disk is full
            # Another folder does not help against a limit on the size of files (ulimit -f).
            advice = "; set TMPDIR to another folder" if error.errno in _FULL else ""
            raise OSError(
                f"cannot write a temporary file in {tempfile.gettempdir()}: "
                f"{error.strerror}{advice}"
            ) from error
        what = tuple((array.dtype.str, array.shape) for array in arrays)
        self._items.append((self._end, what))
        self._end += sum(array.nbytes for array in arrays)

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, number: int) -> T:  # type: ignore[override]
        begin, what = self._items[number]
        self._file.seek(begin)
        arrays = []
        for kind, shape in what:
            size = np.dtype(kind).itemsize * math.prod(shape)
            content = bytearray(self._file.read(size))  # a bytearray makes the arrays writable
            arrays.append(np.frombuffer(content, kind).reshape(shape))
        return self._made_of(*arrays)

    def __iter__(self) -> Iterator[T]:
        return (self[number] for number in range(len(self)))


def _close(file: IO[bytes]) -> None:
    """Close a temporary file; the last write may fail on a full disk."""
    with contextlib.suppress(OSError):
        file.close()
