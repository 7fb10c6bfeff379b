"""Reading ahead: a thread runs a generator to its next items while the consumer is busy."""

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

READ_AHEAD_COUNT = 2  # items besides the current item; more items need memory without a gain
T = TypeVar("T")
_END = object()  # marks the end of the generator


def read_ahead(
    items: Generator[T, None, None],  # is closed at the end, also if the consumer stops early
    count: int = READ_AHEAD_COUNT,  # number of items that the thread prepares in advance
) -> Generator[T, None, None]:
    """Yield the items of a generator, which runs in a thread.

    Items come in order. An error of the generator is raised after the items before the error.
    """
    # The idle thread does not keep the interpreter from ending.
    executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="tisfm-frames")

    def start_next() -> Callable[[], Any]:
        try:
            return executor.submit(next, items, _END).result
        except RuntimeError:  # the main thread has ended: an executor accepts no more work
            return partial(next, items, _END)

    try:
        pending = deque(start_next() for _ in range(count))
        while (item := pending.popleft()()) is not _END:
            pending.append(start_next())
            yield item
            del item  # free its memory before the next item is made
    finally:
        executor.shutdown(cancel_futures=True)
        items.close()
