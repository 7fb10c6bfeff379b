"""What the C library does with memory that is freed.

Dask starts its workers with a small ``MALLOC_TRIM_THRESHOLD_``, and then every array of a frame is
given back to the system when it is freed, and asked for again, page by page, by the next one: that
took 0.4 of a worker's time. A worker is to keep as much as any other process would.
"""

import ctypes
import os

_TRIM, _MMAP = -1, -3  # parameters of mallopt (malloc.h)
_ARRAY = 32 << 20  # the largest that is not mapped on its own, bytes: the most that glibc takes


def keep_freed_memory() -> None:
    """Have memory that is freed stay with the process, as it does where nothing is set.

    It does so where a threshold was set for small objects alone, and the C library has it (glibc).
    """
    try:
        asked = int(os.environ["MALLOC_TRIM_THRESHOLD_"])
        mallopt = ctypes.CDLL(None).mallopt
    except (KeyError, ValueError, AttributeError, OSError, TypeError):
        return
    if 0 <= asked < 2 * _ARRAY:
        mallopt(_MMAP, _ARRAY)  # what glibc comes to by itself, with arrays of this size
        mallopt(_TRIM, 2 * _ARRAY)
