"""Cores, threads bound to one core each, and a second Python thread.

Without a binding, Linux may wake two threads on one core and leave them there, beside an idle core,
for as long as a kernel on a small image takes.
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
    """Return the kernel's ids of the threads of this process, oldest first; empty if unknown."""
    try:
        return sorted(int(name) for name in os.listdir("/proc/self/task"))
    except OSError:
        return []


def bind_newest(count: int, before: list[int]) -> bool:
    """Bind each of the newest threads to a core of its own, if there is one for each and no more.

    Parameters
    ----------
    count : int
        Threads to bind: the newest of those started since.
    before : list of int
        `thread_ids` from before they were started.

    Returns
    -------
    bool
        Whether they are bound now. They are not where threads are fewer than the cores of this
        process, which leaves room for other processes that would choose the same cores, nor on
        systems that have no such call.
    """
    if not hasattr(os, "sched_setaffinity"):
        return False
    known = set(before)
    threads = [thread for thread in thread_ids() if thread not in known][-count:]
    cores = sorted(os.sched_getaffinity(0))
    if not len(threads) == count == len(cores) > 1:
        return False
    try:
        for thread, core in zip(threads, cores, strict=True):
            os.sched_setaffinity(thread, {core})
    except OSError:  # not allowed here
        for thread in threads:
            with contextlib.suppress(OSError):
                os.sched_setaffinity(thread, cores)
        return False
    return True


@cache
def _second_thread() -> Executor:
    from concurrent.futures import ThreadPoolExecutor  # impossible after the main thread has ended

    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="tisfm-second")


def start_beside(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Start a call in the second thread; return what waits for its result."""
    try:
        return _second_thread().submit(function, *arguments).result
    except RuntimeError:  # the main thread has ended, and with it the second
        return cache(partial(function, *arguments))
