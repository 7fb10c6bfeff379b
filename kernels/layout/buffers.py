"""Memory kept for the next array of the same size.

Pairs of a sequence, and the levels of a pyramid, need the same arrays again and again. Fresh
memory comes in pages that the system hands over one by one, and empty, when they are first
touched: for longer than a sweep takes to go over them.
"""

import contextlib
import threading
import weakref
from collections import OrderedDict

import numpy as np

ALIGNMENT = 64  # bytes: a cache line, and the widest vector
SMALLEST_KEPT, LARGEST_KEPT = 1 << 16, 1 << 24  # bytes: blocks of other sizes are not kept
MOST_KEPT = 1 << 25  # bytes that are kept while no array uses them


class Buffers:
    """Gives memory to arrays, and takes it back when no array and no view of one uses it.

    Parameters
    ----------
    most : int
        Bytes to keep.
    """

    def __init__(self, most: int = MOST_KEPT) -> None:
        self.most = most
        self._free: OrderedDict[int, list[np.ndarray]] = OrderedDict()
        self._lock = threading.Lock()
        self._users: dict[int, weakref.ref] = {}
        self._kept = 0

    @property
    def kept(self) -> int:
        """Bytes that are kept, and not in use, now."""
        return self._kept

    def floats(self, count: int) -> np.ndarray:
        """Return an aligned float32 array of `count` elements, of any value."""
        size = count * np.dtype(np.float32).itemsize + ALIGNMENT
        block = self._block(size)
        start = -block.ctypes.data % ALIGNMENT
        # Of a memoryview: views of it have this array as their base, and none behind it.
        array = np.frombuffer(block.data, np.float32, count, start)
        if SMALLEST_KEPT <= size <= LARGEST_KEPT:
            key = id(array)

            def give_back(_: weakref.ref) -> None:
                del self._users[key]
                self._keep(block)

            self._users[key] = weakref.ref(array, give_back)
        return array

    def _block(self, size: int) -> np.ndarray:
        """Return a block of a size that is kept, or else a new one, of uint8."""
        if SMALLEST_KEPT <= size <= LARGEST_KEPT:
            with self._lock, contextlib.suppress(LookupError):
                block = self._free[size].pop()
                self._kept -= size
                return block
        if size > LARGEST_KEPT:
            self.release()
        return np.empty(size, np.uint8)

    def _keep(self, block: np.ndarray) -> None:
        """Keep a block, and let go of those of sizes that were not given back for longest."""
        # Python may call this at any time, from within this class as well: not to wait then.
        if not self._lock.acquire(blocking=False):
            return
        try:
            self._free.setdefault(block.nbytes, []).append(block)
            self._free.move_to_end(block.nbytes)
            self._kept += block.nbytes
            while self._kept > self.most:
                oldest = next(iter(self._free))
                if self._free[oldest]:
                    self._free[oldest].pop()
                    self._kept -= oldest
                else:
                    del self._free[oldest]
        finally:
            self._lock.release()

    def release(self) -> None:
        """Keep nothing."""
        with self._lock:
            self._free.clear()
            self._kept = 0


buffers = Buffers()
