"""Memory kept for the next array of about the same size.

Pairs of a sequence, and the levels of a pyramid, need the same arrays again and again. Fresh
memory comes in pages that the system hands over one by one, and empty, when they are first
touched: for longer than a sweep takes to go over them.
"""

import weakref

import numpy as np

ALIGNMENT = 64  # bytes: a cache line, and the widest vector
LEAST = 1 << 16  # bytes: less is not worth keeping
GREATEST = 1 << 22  # bytes: NumPy asks the system for pages of 2 MiB for more, which cost little
SPARE = 1.25  # times what is asked for: at most so much is given
MOST = 1 << 26  # bytes that are kept while no array uses them


class Buffers:
    """Gives memory to arrays, and takes it back when no array and no view of one uses it.

    Parameters
    ----------
    most : int
        Bytes to keep.
    """

    def __init__(self, most: int = MOST) -> None:
        self.most = most
        self._free: dict[int, np.ndarray] = {}
        self._users: dict[int, weakref.ref] = {}

    @property
    def kept(self) -> int:
        """Bytes that are kept, and not in use, now."""
        return sum(block.nbytes for block in list(self._free.values()))

    def floats(self, count: int) -> np.ndarray:
        """Return an aligned float32 array of `count` elements, of any value."""
        size = count * np.dtype(np.float32).itemsize
        block = self._block(size + ALIGNMENT)
        start = -block.ctypes.data % ALIGNMENT
        # Of a memoryview: views of it have this array as their base, and none behind it.
        array = np.frombuffer(memoryview(block), np.float32, count, start)
        if LEAST <= block.nbytes <= GREATEST:
            key = id(array)

            def give_back(_: weakref.ref) -> None:
                del self._users[key]
                if self.kept + block.nbytes <= self.most:
                    self._free[id(block)] = block

            self._users[key] = weakref.ref(array, give_back)
        return array

    def _block(self, size: int) -> np.ndarray:
        """Return the smallest block that is large enough, and not far too large, or a new one."""
        if not LEAST <= size <= GREATEST:
            return np.empty(size, np.uint8)
        for key, block in sorted(self._free.items(), key=lambda item: item[1].nbytes):
            if size <= block.nbytes <= SPARE * size and self._free.pop(key, None) is not None:
                return block
            if block.nbytes < size:  # of a coarser level, or of smaller frames
                self._free.pop(key, None)
        return np.empty(size, np.uint8)

    def release(self) -> None:
        """Keep nothing."""
        self._free.clear()


buffers = Buffers()
