"""Pools of worker processes: on this machine, or on the machines of a Dask cluster.

The parent process keeps a file as long as it waits for results. A worker checks this file
(`check_worker`), and stops when the file is gone.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
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
from pathlib import Path
from typing import Any, TypeVar

from tisfm.errors import InputError, MissingPackageError, OutOfMemoryError, RunError, TisfmError
from tisfm.machine.memory import out_of_memory_message
from tisfm.version import __version__

T = TypeVar("T")
R = TypeVar("R")
MAX_ATTEMPTS = 3  # attempts at an item whose process was killed; set by hand
_QUEUED_PER_WORKER = 2  # items of a worker: one that it computes, and the next item
_CLUSTER_TIMEOUT = 10  # s: limit of the answer time of a cluster's scheduler; set by hand


class WorkerPool:
    """Processes that compute items of work. An item whose process was killed is computed again."""

    def __init__(
        self,
        workers: int,  # number of processes
        open_executor: Callable[[], Executor],
    ) -> None:
        self.workers = workers
        self._running_items: dict[Future[Any], int] = {}
        self._open, self._executor = open_executor, open_executor()

    def map_unordered(
        self,
        function: Callable[[T], R],  # a function of a module, since processes get its name
        items: Sequence[T],
    ) -> Generator[tuple[int, R], None, None]:
        """Call a function with every item, and yield each result as soon as it is ready.

        Items are submitted in order; few items wait, just enough to keep all processes busy.

        Yields the number of each item, from 0, and its result.

        Raises RunError if processes were killed repeatedly and no item finished in between.

        Raises Exception: the exception of the function.
        """
        waiting_items, kill_count = list(reversed(range(len(items)))), 0
        running_items = self._running_items = {}
        while waiting_items or running_items:
            try:
                while waiting_items and len(running_items) < _QUEUED_PER_WORKER * self.workers:
                    future = self._executor.submit(function, items[waiting_items[-1]])
                    running_items[future] = waiting_items.pop()
                finished_futures, _ = wait(running_items, return_when=FIRST_COMPLETED)
                for future in sorted(finished_futures, key=running_items.__getitem__):
                    result = future.result()
                    kill_count = 0
                    yield running_items.pop(future), result
            except BrokenProcessPool:
                kill_count += 1
                if kill_count >= MAX_ATTEMPTS:
                    raise RunError(
                        f"workers were killed {MAX_ATTEMPTS} times, and finished nothing in "
                        "between: there may be too little memory; give fewer workers"
                    ) from None
                for future in list(running_items):
                    if future.done() and future.exception() is None:
                        yield running_items.pop(future), future.result()
                waiting_items += sorted(running_items.values(), reverse=True)
                running_items.clear()
                self._executor.shutdown(wait=False)
                self._executor = self._open()

    def results_of_running(self) -> Iterator[Any]:
        """Wait for the items that workers are computing, and yield their results.

        This is for the time after an early exit from `map_unordered`. Failed items are left out.
        """
        running_items, self._running_items = self._running_items, {}
        for future in sorted(running_items, key=running_items.__getitem__):
            with suppress(Exception, CancelledError):
                yield future.result()

    def close(self) -> None:
        """End the processes when they have computed their current items."""
        self._executor.shutdown()


def check_workers(workers: int, cluster: str | None = None) -> None:
    """Raise InputError if `workers` is not positive, or if a cluster is given with `workers`."""
    if workers < 1:
        raise InputError(f"workers is {workers}: expected a positive number of processes")
    if workers > 1 and cluster is not None:
        raise InputError(
            f"workers is {workers}, and cluster is {cluster}, which has workers of its own: give "
            "one of them"
        )


def open_pool(
    workers: int,  # number of processes of this machine
    cluster: str | None = None,  # the address of a Dask scheduler, such as "tcp://10.0.0.1:8786"
) -> AbstractContextManager[WorkerPool]:
    """Return a pool of processes of this machine, or of a Dask cluster.

    The end of the block waits for items that workers are computing. Processes of this machine end
    with this process, even if this process is killed.

    Raises MissingPackageError if a cluster is given and Dask is not installed.

    Raises OSError if the cluster does not answer, or has no worker.
    """
    return _local_pool(workers) if cluster is None else _cluster_pool(cluster)


@contextmanager
def _local_pool(workers: int) -> Iterator[WorkerPool]:
    pool = WorkerPool(workers, lambda: _local_executor(workers))
    try:
        yield pool
    finally:
        pool.close()


def _local_executor(workers: int) -> Executor:
    return ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_initialise_process
    )


@contextmanager
def _cluster_pool(address: str) -> Iterator[WorkerPool]:
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise MissingPackageError(
            "a cluster needs Dask, which is not installed: pip install 'tisfm[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=_CLUSTER_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise OSError(f"the cluster {address} does not answer: {error}") from error
    with client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise OSError(f"the cluster {address} has no worker: start some")
        pool = WorkerPool(threads, lambda: client.get_executor(pure=False))
        try:
            yield pool
        except (KilledWorker, CancelledError) as error:
            raise RunError(f"the cluster {address} lost its work: {error}") from error
        finally:
            pool.close()


def _initialise_process() -> None:
    """Leave Ctrl-C to the parent process, and end when the parent ends."""
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_exit_with_parent, args=(parent.sentinel,), daemon=True).start()


def _exit_with_parent(sentinel: Any) -> None:
    wait_for([sentinel])
    sys.stdout.flush()
    os._exit(1)


def check_worker(
    version: str,  # version of tisfm in the parent process
    presence: Path,  # a file that exists as long as the parent process waits for results
    *,
    lanes: int,  # float32 values in a vector register of the parent's CPU
    worker_lanes: int,  # float32 values in a vector register of the worker's CPU
) -> None:
    """Check, in a worker, that the worker gives the same results as the parent process.

    Raises RunError if the version or the number of lanes differs, or the file does not exist here.
    """
    if version != __version__:
        raise RunError(
            f"a worker has tisfm {__version__}, but the command has {version}: install the same "
            "version everywhere"
        )
    if not presence.exists():
        raise RunError(
            f"a worker does not see the folder {presence.parent} of the command: give a folder "
            "that all machines share, by the same path"
        )
    if lanes != worker_lanes:
        raise RunError(
            f"the processor of a worker has vectors of {worker_lanes} lanes, and the processor of "
            f"the command {lanes}: their results differ in the last digits; leave out such machines"
        )


def sendable_error(error: Exception) -> Exception:
    """Return the error of a worker in a form that processes can send to the parent."""
    if isinstance(error, MemoryError) and not isinstance(error, TisfmError):
        return OutOfMemoryError(out_of_memory_message())
    return error.with_traceback(None)
