"""Work that is done by other processes, here or on the machines of a cluster."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait as wait_for
from typing import Any, TypeVar

from tisfm.errors import InputError, MissingPackageError, RunError

T = TypeVar("T")
R = TypeVar("R")

TRIES = 3  # of what was under way when a process was killed
_AHEAD = 2  # pieces for each process: one that it does, one that waits


class WorkerPool:
    """Does pieces of work in other processes, and again those that died with one.

    Attributes
    ----------
    workers : int
        How many there are.
    """

    def __init__(self, workers: int, opened: Callable[[], Executor]) -> None:
        self.workers = workers
        self._running: dict[Future[Any], int] = {}
        self._open, self._executor = opened, opened()

    def finished(self, function: Callable[[T], R], items: Sequence[T]) -> Iterator[tuple[int, R]]:
        """Call a function with every item, and yield results as they come.

        Items are begun in their order, and no more of them than there is work for.

        Parameters
        ----------
        function : callable
            Of a module, as it is sent by its name.
        items : sequence

        Yields
        ------
        number : int
            Of the item.
        result

        Raises
        ------
        RuntimeError
            If processes were killed again and again.
        Exception
            What the function raised.
        """
        waiting, killed = list(reversed(range(len(items)))), 0
        running = self._running = {}
        while waiting or running:
            try:
                while waiting and len(running) < _AHEAD * self.workers:
                    future = self._executor.submit(function, items[waiting[-1]])
                    running[future] = waiting.pop()
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in sorted(done, key=running.__getitem__):
                    result = future.result()
                    killed = 0
                    yield running.pop(future), result
            except BrokenProcessPool:
                killed += 1
                if killed >= TRIES:
                    raise RunError(
                        f"a worker was killed, and {TRIES} times nothing was finished in "
                        "between: it may lack memory; give fewer workers"
                    ) from None
                for future in list(running):
                    if future.done() and future.exception() is None:
                        yield running.pop(future), future.result()
                waiting += sorted(running.values(), reverse=True)
                running.clear()
                self._executor.shutdown(wait=False)
                self._executor = self._open()

    def under_way(self) -> Iterator[Any]:
        """Wait for what is under way, and yield its results; what fails now is left out.

        What `finished` is used for has ended early then, and pieces are such that they notice.
        """
        running, self._running = self._running, {}
        for future in sorted(running, key=running.__getitem__):
            with suppress(Exception, CancelledError):
                yield future.result()

    def close(self) -> None:
        """End the processes, once what they are doing is done."""
        self._executor.shutdown()


def check_workers(workers: int, cluster: str | None) -> None:
    """Refuse numbers of workers that there cannot be, with ValueError."""
    if workers < 1:
        raise InputError(f"workers is {workers}: expected a positive number of processes")
    if workers > 1 and cluster is not None:
        raise InputError(
            f"workers is {workers}, and cluster is {cluster}, which has workers of its own: give "
            "one of them"
        )


def open_pool(workers: int, cluster: str | None = None) -> AbstractContextManager[WorkerPool]:
    """Return so many processes of this machine, or those of a Dask cluster.

    Leaving the block waits for what is under way. Processes of this machine end with this one,
    however it ends.

    Parameters
    ----------
    workers : int
    cluster : str, optional
        The address of a scheduler of Dask, such as "tcp://10.0.0.1:8786".

    Raises
    ------
    ImportError
        If there is a cluster and Dask is not installed.
    OSError
        If the cluster does not answer, or has no worker.
    """
    return _here(workers) if cluster is None else _cluster(cluster)


@contextmanager
def _here(workers: int) -> Iterator[WorkerPool]:
    made = WorkerPool(workers, lambda: _processes(workers))
    try:
        yield made
    finally:
        made.close()


def _processes(workers: int) -> Executor:
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin)


@contextmanager
def _cluster(address: str) -> Iterator[WorkerPool]:
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise MissingPackageError(
            "a cluster needs Dask, which is not installed: pip install 'tisfm[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise OSError(f"the cluster {address} does not answer: {error}") from error
    with client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise OSError(f"the cluster {address} has no worker: start some")
        made = WorkerPool(threads, lambda: client.get_executor(pure=False))
        try:
            yield made
        except (KilledWorker, CancelledError) as error:
            raise RunError(f"the cluster {address} lost what it had to do: {error}") from error
        finally:
            made.close()


def _begin() -> None:
    """Leave Ctrl-C to the process that gives the work, and end when that ends."""
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: Any) -> None:
    wait_for([sentinel])
    sys.stdout.flush()
    os._exit(1)
