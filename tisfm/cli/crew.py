"""Processes that work on items one after the other."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

TRIES = 3  # of an item whose process died


class Crew:
    """Spawned processes."""

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def finished(
        self, function: Callable[[Any], Any], items: Sequence[Any]
    ) -> Iterator[tuple[int, Any]]:
        """Call a function with each item; give the item's number and what was returned."""
        left = dict(enumerate(items))
        for last in range(TRIES - 1, -1, -1):
            context = multiprocessing.get_context("spawn")
            pool = ProcessPoolExecutor(self._workers, mp_context=context)
            try:
                tasks = {pool.submit(function, item): number for number, item in left.items()}
                for task in as_completed(tasks):
                    result = task.result()
                    del left[tasks[task]]
                    yield tasks[task], result
                return
            except BrokenProcessPool:
                if not last:
                    raise
            finally:
                pool.shutdown(cancel_futures=True)


@contextmanager
def crew(*, workers: int = 1, cluster: str | None = None) -> Iterator[Crew]:
    """Give processes that work on items: spawned here, or those of a Dask cluster."""
    if cluster is not None:
        raise ValueError(f"cluster is {cluster!r}: this version starts processes here alone")
    yield Crew(workers)
