"""Reading ahead: a thread makes the next items of a generator while the consumer is busy."""

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

READ_AHEAD_COUNT = 2  # items beside the one in use; more items would only take memory
T = TypeVar("T")
_END = object()


def read_ahead(
    items: Generator[T, None, None],  # it is closed at the end, also if the consumer stops early
    count: int = READ_AHEAD_COUNT,  # number of items that are made before the consumer needs them
) -> Generator[T, None, None]:
    """Yield the items of a generator, which runs in a thread.

    Items come in order. An error of the generator is raised after the items before it.
    """
    # The thread ends with the interpreter: while idle it only waits for work.
    executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="tisfm-frames")

    def start() -> Callable[[], Any]:
        try:
            return executor.submit(next, items, _END).result
        except RuntimeError:  # the main thread has ended: an executor accepts no more work
            return partial(next, items, _END)

    try:
        waiting = deque(start() for _ in range(count))
        while (item := waiting.popleft()()) is not _END:
            waiting.append(start())
            yield item
            del item  # free its memory before the next item is made
    finally:
        executor.shutdown(cancel_futures=True)
        items.close()
