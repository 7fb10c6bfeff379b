"""A second thread, for what can be done at the same time and lets go of the interpreter."""

from collections.abc import Callable
from concurrent.futures import Executor
from functools import cache, partial
from typing import Any


@cache
def _second_thread() -> Executor:
    from concurrent.futures import ThreadPoolExecutor  # impossible after the main thread has ended

    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="tisfm-second")


def beside(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Start a call in the second thread; return what waits for its result."""
    try:
        return _second_thread().submit(function, *arguments).result
    except RuntimeError:  # the main thread has ended, and with it the second
        return cache(partial(function, *arguments))
