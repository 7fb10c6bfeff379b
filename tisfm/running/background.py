"""Work done beside the main thread, one piece after the other."""

import contextlib
import queue
import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

Work = Callable[[], Any]
_SWITCH = 5e-4  # s: kernels hold Python's lock, and what waits for it asks only so often


class Background:
    """A thread that does what it is given, in order, while the block goes on.

    One piece is done, and one may wait; who brings a third waits, so that no more than these are
    held in memory. Leaving the block waits for both, after an error and after Ctrl-C as well: what
    was given is done whole. A second Ctrl-C leaves out the piece that waits. After an error of a
    piece none is begun, and it is raised where the next is given, or at the end of the block.

    Within the block threads take turns ten times as often as usual (`sys.setswitchinterval`).
    """

    def __init__(self) -> None:
        self._waiting: queue.Queue[Work | None] = queue.Queue(maxsize=1)
        self._error: BaseException | None = None
        self._abandoned = False
        self._thread = threading.Thread(target=self._work, name="tisfm-writer")

    def submit(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> None:
        """Give a piece of work.

        Parameters
        ----------
        function : callable
        *arguments, **options
            What it is called with.

        Raises
        ------
        BaseException
            What an earlier piece raised.
        """
        self._raise()
        self._waiting.put(lambda: function(*arguments, **options))

    def wait(self) -> None:
        """Wait until all that was given is done, and raise what it raised."""
        self._waiting.join()
        self._raise()

    def __enter__(self) -> "Background":
        self._thread.start()
        self._usual = sys.getswitchinterval()
        sys.setswitchinterval(min(self._usual, _SWITCH))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._waiting.put(None)
            self._thread.join()
        except KeyboardInterrupt:
            self._abandoned = True
            with contextlib.suppress(queue.Empty):  # what waits makes room for the end
                self._waiting.get_nowait()
            with contextlib.suppress(queue.Full):  # the end is there already
                self._waiting.put_nowait(None)
            self._thread.join()  # so that nothing is written while the block's others are left
            raise
        finally:
            sys.setswitchinterval(self._usual)
        if error is None:
            self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (piece := self._waiting.get()) is not None:
            if self._error is None and not self._abandoned:
                try:
                    piece()
                except BaseException as error:
                    self._error = error
            del piece  # or it would be held while the next is waited for
            self._waiting.task_done()
