"""Cores, threads bound to one core each, and a second Python thread.

Unbound threads can share a core: Linux may wake two threads on one core and leave them there, with
another core idle, for the whole time of a kernel on a small image.
"""

import contextlib
import os
from collections.abc import Callable
from concurrent.futures import Executor
from functools import cache, partial
from typing import Any


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def thread_ids() -> list[int]:
    """Return the operating system's ids of this process's threads, oldest first; [] if unknown."""
    try:
        return sorted(int(name) for name in os.listdir("/proc/self/task"))
    except OSError:
        return []


def bind_newest_threads(
    count: int,  # number of newest threads to bind
    earlier_threads: list[int],  # `thread_ids` from before these threads were started
) -> bool:
    """Bind each of the newest threads to its own core, if there are as many threads as cores.

    Returns whether the threads are bound now. They are not if this process has more cores than
    threads, because other processes would bind to the same cores; nor on systems that cannot bind.
    """
    if not hasattr(os, "sched_setaffinity"):
        return False
    earlier_ids = set(earlier_threads)
    threads = [thread for thread in thread_ids() if thread not in earlier_ids][-count:]
    cores = sorted(os.sched_getaffinity(0))
    if not len(threads) == count == len(cores) > 1:
        return False
    try:
        for thread, core in zip(threads, cores, strict=True):
            os.sched_setaffinity(thread, {core})
    except OSError:  # the system does not allow it: undo the binding
        for thread in threads:
            with contextlib.suppress(OSError):
                os.sched_setaffinity(thread, cores)
        return False
    return True


@cache
def _second_thread() -> Executor:
    from concurrent.futures import ThreadPoolExecutor  # impossible after the main thread has ended

    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="tisfm-second")


def start_in_second_thread(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Start a call in the second thread; return a function that waits for its result."""
    try:
        return _second_thread().submit(function, *arguments).result
    except RuntimeError:  # the main and the second thread have ended: call it later, in this thread
        return cache(partial(function, *arguments))
