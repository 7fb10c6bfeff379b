"""Reuse of memory for arrays of the same size.

Pairs of a sequence and levels of a pyramid need arrays of the same sizes again and again. The
system zeroes and maps each page of new memory at the first access, which takes longer than a sweep
over the array.
"""

import contextlib
import threading
import weakref
from collections import OrderedDict

import numpy as np

ALIGNMENT = 64  # bytes: a cache line, and the widest vector
MIN_REUSED_BYTES, MAX_REUSED_BYTES = 1 << 16, 1 << 24  # bytes: sizes of blocks that are reused
MAX_UNUSED_BYTES = 1 << 25  # bytes of unused blocks that are kept for reuse


class Buffers:
    """Allocates arrays, and reuses their memory once no array and no view uses it any more."""

    def __init__(
        self,
        max_unused: int = MAX_UNUSED_BYTES,  # most bytes of unused memory to keep
    ) -> None:
        self.max_unused = max_unused
        self._free: OrderedDict[int, list[np.ndarray]] = OrderedDict()
        self._lock = threading.Lock()
        self._users: dict[int, weakref.ref] = {}
        self._unused = 0

    @property
    def unused(self) -> int:
        """Bytes of unused memory kept at present."""
        return self._unused

    def floats(self, count: int) -> np.ndarray:
        """Return an aligned float32 array of `count` elements with arbitrary values."""
        size = count * np.dtype(np.float32).itemsize + ALIGNMENT
        block = self._block(size)
        start = -block.ctypes.data % ALIGNMENT
        # From a memoryview: this array is then the base of all its views, so they keep it alive.
        array = np.frombuffer(block.data, np.float32, count, start)
        if MIN_REUSED_BYTES <= size <= MAX_REUSED_BYTES:
            key = id(array)

            def give_back(_: weakref.ref) -> None:
                del self._users[key]
                self._return_block(block)

            self._users[key] = weakref.ref(array, give_back)
        return array

    def _block(self, size: int) -> np.ndarray:
        """Return an unused block of this size, or else a new block, as uint8."""
        if MIN_REUSED_BYTES <= size <= MAX_REUSED_BYTES:
            with self._lock, contextlib.suppress(LookupError):
                block = self._free[size].pop()
                self._unused -= size
                return block
        if size > MAX_REUSED_BYTES:
            self.release()
        return np.empty(size, np.uint8)

    def _return_block(self, block: np.ndarray) -> None:
        """Keep a block for reuse; if too much is kept, drop the sizes returned least recently."""
        # Python may call this at any time, even inside this class: never wait for the lock.
        if not self._lock.acquire(blocking=False):
            return
        try:
            self._free.setdefault(block.nbytes, []).append(block)
            self._free.move_to_end(block.nbytes)
            self._unused += block.nbytes
            while self._unused > self.max_unused:
                oldest = next(iter(self._free))
                if self._free[oldest]:
                    self._free[oldest].pop()
                    self._unused -= oldest
                else:
                    del self._free[oldest]
        finally:
            self._lock.release()

    def release(self) -> None:
        """Free all unused memory."""
        with self._lock:
            self._free.clear()
            self._unused = 0


buffers = Buffers()
