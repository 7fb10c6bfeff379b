"""Reading ahead: the next items are made in a thread while the consumer is busy."""

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

AHEAD = 2  # items beside the one in use: more would only take memory

T = TypeVar("T")
_END = object()


def read_ahead(items: Generator[T, None, None], count: int = AHEAD) -> Generator[T, None, None]:
    """Yield the items of a generator, made in a thread of their own.

    Parameters
    ----------
    items : generator
        It is closed at the end, also where the consumer stops before.
    count : int
        How many items are made before they are asked for.

    Yields
    ------
    object
        The items, in their order. An error of the generator is raised after what came before it.
    """
    # Its thread waits for work alone, so that nothing of it outlives the interpreter.
    executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="tisfm-frames")

    def start() -> Callable[[], Any]:
        try:
            return executor.submit(next, items, _END).result
        except RuntimeError:  # the main thread has ended, and lets nobody start work
            return partial(next, items, _END)

    try:
        waiting = deque(start() for _ in range(count))
        while (item := waiting.popleft()()) is not _END:
            waiting.append(start())
            yield item
            del item  # or it would be held until the next one is there
    finally:
        executor.shutdown(cancel_futures=True)
        items.close()
