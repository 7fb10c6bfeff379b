"""Limits of the address space (``ulimit -v``), and memory that is freed.

Libraries that find too little address space crash, hang, or fail with messages of their own, and
they reserve far more than they use. A limit that is certainly too small is refused beforehand.

Dask starts its workers with a small ``MALLOC_TRIM_THRESHOLD_``. The C library then gives every
array of a frame back to the system when it is freed, and the next array asks for the same pages
again: that took 0.4 of a worker's time. `keep_freed_memory` undoes that.
"""

import ctypes
import os
from pathlib import Path

from tisfm.errors import OutOfMemoryError

_SIGNS = ("cannot allocate memory", "failed to map segment", "can't start new thread", "bad_alloc")
_OPENCV = 0.28e9  # that NumPy and OpenCV reserve with one thread each, bytes; measured
_OPENCV_THREADS = 0.19e9  # more that they reserve with several threads, bytes; measured
_SCIPY = 0.28e9  # that SciPy and the other libraries reserve, bytes; measured
_STACK = 8 << 20  # of a thread, bytes, as most systems have it
_ARENA = 64 << 20  # that the C library reserves for a thread's allocations, bytes


def limit() -> int | None:
    """Return the limit of this process, bytes; None where there is none."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


def require(
    amount: float,  # address space that is reserved, bytes
    purpose: str,  # the purpose, for the message
) -> None:
    """Check that the limit leaves enough address space.

    Raises OutOfMemoryError if less is left.
    """
    bound = limit()
    if bound is None:
        return
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:  # not Linux: other systems hardly enforce that limit
        return
    available = bound - pages * os.sysconf("SC_PAGE_SIZE")
    if available < amount:
        raise OutOfMemoryError(
            f"the limit of the address space (ulimit -v) is {_gb(bound)} and leaves "
            f"{_gb(available)}, but {purpose} reserves {_gb(amount)}, of which little is used: "
            "raise the limit, or limit resident memory instead"
        )


def import_libraries() -> None:
    """Import OpenCV, unless the limit leaves too little for OpenCV or for SciPy after it.

    Raises OutOfMemoryError if too little is left: OpenCV would crash while it is imported, and
    SciPy would hang.
    """
    threads = os.environ.get("OPENBLAS_NUM_THREADS") or str(os.cpu_count())
    several = _OPENCV_THREADS if threads != "1" else 0.0
    require(_OPENCV + several, "loading the libraries")
    import cv2  # noqa: F401

    require(_SCIPY, "loading the libraries")


def require_for_taichi(threads: int) -> None:
    """Check that the limit leaves the address space that Taichi reserves when it starts.

    Measured with version 1.7.4: 1 GiB at once, the libraries, and of each thread, four that
    compile included, its stack and its arena.

    Raises OutOfMemoryError if less is left.
    """
    each = _STACK + _ARENA
    plural = "s" * (threads > 1)
    require(1.2 * (1 << 30) + (threads + 4) * each, f"Taichi with {threads} thread{plural}")


def ran_out(error: BaseException | None) -> bool:
    """Return whether an error of a library means that the address space did not suffice."""
    while error is not None and limit() is not None:
        if any(sign in str(error).lower() for sign in _SIGNS):
            return True
        error = error.__cause__ or error.__context__
    return False


def advice() -> str:
    """Return the message for memory that does not suffice, if there is no better one."""
    bound = limit()
    raised = "" if bound is None else f", or raise the limit of {_gb(bound)} (ulimit -v)"
    return f"not enough memory: give smaller frames{raised}"


def _gb(count: float) -> str:
    return f"{count / 1e9:.3g} GB"


_TRIM, _MMAP = -1, -3  # parameters of mallopt (malloc.h)


_ARRAY = 32 << 20  # the largest that is not mapped on its own, bytes: the most that glibc takes


def keep_freed_memory() -> None:
    """Keep freed memory in the process, as glibc does by default.

    This changes thresholds of glibc only if the environment sets a small one.
    """
    try:
        asked = int(os.environ["MALLOC_TRIM_THRESHOLD_"])
        mallopt = ctypes.CDLL(None).mallopt
    except (KeyError, ValueError, AttributeError, OSError, TypeError):
        return
    if 0 <= asked < 2 * _ARRAY:
        mallopt(_MMAP, _ARRAY)  # what glibc comes to by itself, with arrays of this size
        mallopt(_TRIM, 2 * _ARRAY)
