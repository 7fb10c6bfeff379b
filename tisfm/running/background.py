"""A second thread that does jobs, one after the other."""

import contextlib
import queue
import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

Job = Callable[[], Any]
# s: interval at which a waiting thread requests Python's lock, which kernels hold.
_SWITCH_INTERVAL = 5e-4


class BackgroundThread:
    """A thread that does jobs in order while the block runs.

    One job runs, and one job may wait; `submit` blocks on a third job, so that memory has the data
    of few jobs. The end of the block waits for both jobs, also after an error and after Ctrl-C:
    every submitted job is completed. A second Ctrl-C drops the waiting job. After a job has failed,
    no other job begins. The next `submit`, or the end of the block, raises the error of this job.

    Within the block, Python switches threads ten times as often as usual (`sys.setswitchinterval`).
    """

    def __init__(self) -> None:
        self._jobs: queue.Queue[Job | None] = queue.Queue(maxsize=1)
        self._error: BaseException | None = None
        self._is_abandoned = False
        self._thread = threading.Thread(target=self._work, name="tisfm-writer")

    def submit(
        self,
        function: Callable[..., Any],
        # arguments, options: arguments of the function
        *arguments: Any,
        **options: Any,
    ) -> None:
        """Add a job: a function to call.

        Raises BaseException: the error of an earlier job.
        """
        self._raise_job_error()
        self._jobs.put(lambda: function(*arguments, **options))

    def wait(self) -> None:
        """Wait until all jobs are done; raise the error of a failed job."""
        self._jobs.join()
        self._raise_job_error()

    def __enter__(self) -> "BackgroundThread":
        self._thread.start()
        self._previous_interval = sys.getswitchinterval()
        sys.setswitchinterval(min(self._previous_interval, _SWITCH_INTERVAL))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._jobs.put(None)
            self._thread.join()
        except KeyboardInterrupt:
            self._is_abandoned = True
            with contextlib.suppress(queue.Empty):  # drop the waiting job
                self._jobs.get_nowait()
            with contextlib.suppress(queue.Full):  # the end mark is in the queue already
                self._jobs.put_nowait(None)
            self._thread.join()  # so that no file is written while outer contexts close
            raise
        finally:
            sys.setswitchinterval(self._previous_interval)
        if error is None:
            self._raise_job_error()

    def _raise_job_error(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._error is None and not self._is_abandoned:
                try:
                    job()
                except BaseException as error:
                    self._error = error
            del job  # free its memory before the wait for the next job
            self._jobs.task_done()
