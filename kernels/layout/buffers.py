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
MIN_REUSED_BYTES, MAX_REUSED_BYTES = 1 << 16, 1 << 24  # bytes: sizes of the blocks that are reused
MAX_UNUSED_BYTES = 1 << 25  # bytes of all unused blocks that are kept for reuse


class Buffers:
    """Allocates arrays, and reuses their memory once no array and no view uses it any more."""

    def __init__(
        self,
        max_unused_bytes: int = MAX_UNUSED_BYTES,  # limit of the unused memory that is kept
    ) -> None:
        self.max_unused_bytes = max_unused_bytes
        self._unused_blocks: OrderedDict[int, list[np.ndarray]] = OrderedDict()
        self._lock = threading.Lock()
        self._references: dict[int, weakref.ref] = {}
        self._unused_bytes = 0

    @property
    def unused_bytes(self) -> int:
        """Bytes of unused memory that are kept for reuse."""
        return self._unused_bytes

    def allocate_floats(self, count: int) -> np.ndarray:
        """Return an aligned float32 array of `count` elements with arbitrary values."""
        size = count * np.dtype(np.float32).itemsize + ALIGNMENT
        block = self._take_block(size)
        start = -block.ctypes.data % ALIGNMENT
        # From a memoryview: this array is then the base of all its views, so they keep it alive.
        array = np.frombuffer(block.data, np.float32, count, start)
        if MIN_REUSED_BYTES <= size <= MAX_REUSED_BYTES:
            key = id(array)

            def give_back(_: weakref.ref) -> None:
                del self._references[key]
                self._return_block(block)

            self._references[key] = weakref.ref(array, give_back)
        return array

    def _take_block(self, size: int) -> np.ndarray:
        """Return an unused block of this size, or else a new block, as uint8."""
        if MIN_REUSED_BYTES <= size <= MAX_REUSED_BYTES:
            with self._lock, contextlib.suppress(LookupError):
                block = self._unused_blocks[size].pop()
                self._unused_bytes -= size
                return block
        if size > MAX_REUSED_BYTES:
            self.release()
        return np.empty(size, np.uint8)

    def _return_block(self, block: np.ndarray) -> None:
        """Keep a block for reuse; beyond the limit, drop blocks of the least recent sizes."""
        # Python may call this at any time, even inside this class: never wait for the lock.
        if not self._lock.acquire(blocking=False):
            return
        try:
            self._unused_blocks.setdefault(block.nbytes, []).append(block)
            self._unused_blocks.move_to_end(block.nbytes)
            self._unused_bytes += block.nbytes
            while self._unused_bytes > self.max_unused_bytes:
                oldest = next(iter(self._unused_blocks))
                if self._unused_blocks[oldest]:
                    self._unused_blocks[oldest].pop()
                    self._unused_bytes -= oldest
                else:
                    del self._unused_blocks[oldest]
        finally:
            self._lock.release()

    def release(self) -> None:
        """Free all unused memory."""
        with self._lock:
            self._unused_blocks.clear()
            self._unused_bytes = 0


buffers = Buffers()
