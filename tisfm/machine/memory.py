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

_OUT_OF_MEMORY_TEXTS = (
    "cannot allocate memory",
    "failed to map segment",
    "can't start new thread",
    "bad_alloc",
)
_OPENCV_BYTES = 0.28e9  # bytes that NumPy and OpenCV reserve with one thread each; measured
_OPENCV_THREAD_BYTES = 0.19e9  # further bytes that they reserve with several threads; measured
_SCIPY_BYTES = 0.28e9  # bytes that SciPy and the other libraries reserve; measured
_STACK_BYTES = 8 << 20  # bytes of a thread's stack, on most systems
_ARENA_BYTES = 64 << 20  # bytes that the C library reserves for a thread's allocations


def address_space_limit() -> int | None:
    """Return the limit of this process, bytes; None where there is none."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


def require_address_space(
    amount: float,  # address space that is reserved, bytes
    purpose: str,  # the purpose, for the message
) -> None:
    """Check that the limit leaves enough address space.

    Raises OutOfMemoryError if less is left.
    """
    bound = address_space_limit()
    if bound is None:
        return
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:  # not Linux: other systems hardly enforce the limit
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
    bytes_of_threads = _OPENCV_THREAD_BYTES if threads != "1" else 0.0
    require_address_space(_OPENCV_BYTES + bytes_of_threads, "loading the libraries")
    import cv2  # noqa: F401

    require_address_space(_SCIPY_BYTES, "loading the libraries")


def require_for_taichi(threads: int) -> None:
    """Check that the limit leaves the address space that Taichi reserves when it starts.

    Taichi 1.7.4 reserves 1 GiB, the libraries, and a stack and an arena for each thread, with four
    more threads that compile; measured.

    Raises OutOfMemoryError if less is left.
    """
    bytes_per_thread = _STACK_BYTES + _ARENA_BYTES
    plural = "s" * (threads > 1)
    require_address_space(
        1.2 * (1 << 30) + (threads + 4) * bytes_per_thread, f"Taichi with {threads} thread{plural}"
    )


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return whether an error of a library means that the address space did not suffice."""
    while error is not None and address_space_limit() is not None:
        if any(text in str(error).lower() for text in _OUT_OF_MEMORY_TEXTS):
            return True
        error = error.__cause__ or error.__context__
    return False


def out_of_memory_message() -> str:
    """Return the message for memory that does not suffice, if there is no better one."""
    bound = address_space_limit()
    limit_advice = "" if bound is None else f", or raise the limit of {_gb(bound)} (ulimit -v)"
    return f"not enough memory: give smaller frames{limit_advice}"


def _gb(count: float) -> str:
    return f"{count / 1e9:.3g} GB"


_TRIM_PARAMETER, _MMAP_PARAMETER = -1, -3  # parameters of mallopt (malloc.h)
# bytes: arrays up to this size are not mapped on their own; the limit of glibc
_MAX_HEAP_BYTES = 32 << 20


def keep_freed_memory() -> None:
    """Keep freed memory in the process, as glibc does by default.

    This changes thresholds of glibc only if the environment sets a small one.
    """
    try:
        trim_threshold = int(os.environ["MALLOC_TRIM_THRESHOLD_"])
        mallopt = ctypes.CDLL(None).mallopt
    except (KeyError, ValueError, AttributeError, OSError, TypeError):
        return
    if 0 <= trim_threshold < 2 * _MAX_HEAP_BYTES:
        # as glibc sets both thresholds by itself after arrays of this size
        mallopt(_MMAP_PARAMETER, _MAX_HEAP_BYTES)
        mallopt(_TRIM_PARAMETER, 2 * _MAX_HEAP_BYTES)
