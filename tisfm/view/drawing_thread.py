"""The thread that draws a page: coarsely right after a change, in full when changes stop."""

import contextlib
import threading
import time
import traceback
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Protocol


class Playback:
    """Steps through frames at a rate, and skips frames if drawing is slower."""

    def __init__(self) -> None:
        self._start: tuple[float, int] | None = None  # time, s, and number of the first frame

    @property
    def is_on(self) -> bool:
        """Whether frames advance."""
        return self._start is not None

    def toggle(self, number: int) -> None:
        """Begin at a frame, or stop."""
        self._start = None if self.is_on else (time.monotonic(), number)

    def restart(self, number: int) -> None:
        """Go on from another frame, if playing."""
        if self.is_on:
            self._start = time.monotonic(), number

    def due_frame(self, frames_per_second: float, count: int) -> int | None:
        """Return the number of the frame that is due, of `count` in a loop; None if stopped."""
        if self._start is None:
            return None
        begin, number = self._start
        return (number + int((time.monotonic() - begin) * frames_per_second)) % count


_FULL_DRAWING_DELAY = 0.25  # s without a change before everything is drawn; set by hand
_BROWSER_CHECK_INTERVAL = 0.05  # s between checks for the first browser
_FIRST_PICTURE_TIME = 1.0  # s, in which a new browser draws its first picture
_FOLDER_CHECK_INTERVAL = 1.0  # s between checks of the folder of the result
_THUMBNAIL_PAUSE = 0.02  # s between thumbnails, so that changes are noticed in time


class DrawnPage(Protocol):
    """A page, as the thread needs it."""

    def draw(self, *, coarse: bool) -> None:
        """Draw the frame that the slider is at."""

    def advance(self) -> bool:
        """Move the slider to the frame that is due; return whether it has moved."""

    def seconds_per_frame(self) -> float | None:
        """Return the time of a frame while playing, else None."""

    def add_thumbnail(self) -> None:
        """Put the next missing picture into its frustum."""

    def has_missing_thumbnails(self) -> bool:
        """Return whether a frustum has no picture yet."""

    def watch_folder(self) -> None:
        """Take over new frames of the result."""

    def has_browser(self) -> bool:
        """Return whether a browser shows the page."""


class DrawingThread:
    """Does all the drawing of a page; every other thread only requests it.

    So a browser that is slower than the changes skips some of them.
    """

    def __init__(
        self,
        page: DrawnPage,
        *,
        # s: for this time after the start, only a coarse first picture is drawn, unless a browser
        # connects
        browser_wait: float,
    ) -> None:
        self._page, self._browser_wait = page, browser_wait
        self._jobs: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._is_stale, self._is_coarse, self._change_time = False, True, 0.0
        self._folder_check_time = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="tisfm-view", daemon=True)

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(timeout=10)

    def put(self, job: Callable[[], None], *, redraw: bool = False) -> None:
        """Let the thread call a function; with `redraw`, it draws the frame again afterwards."""
        self._jobs.put(job)
        if redraw:
            self._is_stale = True
        self._wake.set()

    def redraw(self) -> None:
        """Let the thread draw the frame again."""
        self._is_stale = True
        self._wake.set()

    def wake(self) -> None:
        """Let the thread check at once for work."""
        self._wake.set()

    def is_idle(self) -> bool:
        """Return whether everything is drawn; to be called by a job of the thread."""
        is_unfinished = self._is_stale or self._is_coarse or self._page.has_missing_thumbnails()
        return self._jobs.empty() and not is_unfinished

    def _run(self) -> None:
        self._await_browser()
        while not self._stopping.is_set():
            self._wake.wait(self._pause())
            self._wake.clear()
            if self._stopping.is_set():
                return
            try:
                self._step()
            except Exception:  # a bug: its traceback is printed, and the page goes on
                traceback.print_exc()

    def _await_browser(self) -> None:
        """Wait, so that a browser has the processor until its first picture, or a request comes."""
        end = time.monotonic() + self._browser_wait
        while time.monotonic() < end and not self._page.has_browser():
            if self._wake.wait(_BROWSER_CHECK_INTERVAL):
                return
        if self._browser_wait > 0:
            self._wake.wait(_FIRST_PICTURE_TIME)

    def _step(self) -> None:
        """Do the most urgent drawing, after all jobs."""
        with contextlib.suppress(Empty):
            while True:
                self._jobs.get_nowait()()
        if self._page.advance():  # other threads set the flag as well: only set it to True
            self._is_stale = True
        now = time.monotonic()
        if self._is_stale:
            self._is_stale, self._is_coarse, self._change_time = False, True, now
            self._page.draw(coarse=True)
        elif self._is_coarse and now - self._change_time > _FULL_DRAWING_DELAY:
            self._is_coarse = False
            self._page.draw(coarse=False)
        elif self._page.seconds_per_frame() is None and self._page.has_missing_thumbnails():
            self._page.add_thumbnail()
        if now - self._folder_check_time > _FOLDER_CHECK_INTERVAL:
            self._folder_check_time = now
            self._page.watch_folder()

    def _pause(self) -> float:
        """Return how long to wait for a change, s."""
        if self._is_stale:
            return 0.0
        period = self._page.seconds_per_frame()
        if period is not None:
            return 0.5 * period
        if self._is_coarse:
            return _FULL_DRAWING_DELAY
        return _THUMBNAIL_PAUSE if self._page.has_missing_thumbnails() else _FOLDER_CHECK_INTERVAL
