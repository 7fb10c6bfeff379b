"""Progress of commands: bars, rates, the time that is left, and the times of stages."""

import math
import shutil
import time
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from tisfm.cli.console import tell
from tisfm.folders.files import TIMINGS
from tisfm.formats import atomic_write
from tisfm.formats.csv_table import csv_table
from tisfm.grade import percent, upper_median
from tisfm.machine.text import as_duration, as_size, printable
from tisfm.reconstruction.stages.progress import Stage
from tisfm.running.pair_writer import PairWriter

STAGES: dict[Stage, str] = {"reading": "reading, tracking", "path": "path", "depth": "depth"}
"""The stages of a reconstruction, as a progress bar names them."""
LARGE_OUTPUT = 2e8  # bytes: a command that will write more prints this beforehand; set by hand
_MIN_PRINTED_TIME = 60.0  # s: a shorter remaining time is not printed; set by hand
_MIN_MEASURED_TIME = 5.0  # s over which the speed is measured; set by hand
_FIRST_MEASURED_ITEM = 2  # the first item takes longer, because kernels are compiled
_RECENT_PAIRS = 20  # the last pairs, which give the speed and the slowest stage; set by hand
_STAGE_NAMES: dict[Stage, str] = {  # in timings.csv
    "reading": "Reading and tracking",
    "path": "Path",
    "depth": "Depth of every frame",
}

T = TypeVar("T")


class TimeEstimate:
    """Prints the remaining time of a long command once, as soon as its speed is known.

    If the count falls, the work begins again, and the time is estimated anew.

    Parameters
    ----------
    items : str
        The items that are counted, such as "pairs".
    """

    def __init__(self, items: str) -> None:
        self._items = items
        self._since: float | None = None
        self._first_count = 0
        self._is_printed = False

    def update(self, count: int, total: int | None) -> None:
        """Receive the numbers of finished items and of all items; None if unknown."""
        if self._since is not None and count < self._first_count:
            self._since, self._is_printed = None, False
        if self._is_printed or total is None or count < _FIRST_MEASURED_ITEM:
            return
        now = time.monotonic()
        if self._since is None:
            self._since, self._first_count = now, count
            return
        elapsed, new_items = now - self._since, count - self._first_count
        if elapsed < _MIN_MEASURED_TIME or new_items < 1:
            return
        self._is_printed = True
        remaining = elapsed / new_items * (total - count)
        if remaining > _MIN_PRINTED_TIME:
            speed = f"{new_items / elapsed:.2g} a second"
            tell(f"{total} {self._items}: about {as_duration(remaining)} to go, {speed}")


class RunningErrors:
    """The expected errors of the depth of frames so far, and their median."""

    def __init__(self) -> None:
        self._errors: list[float] = []  # sorted
        self._by_frame: dict[int, float] = {}

    def add(self, frame: int, error: float) -> None:
        """Set the expected relative error of a frame, by its number; NaN is left out."""
        if (earlier := self._by_frame.pop(frame, None)) is not None:
            del self._errors[bisect_left(self._errors, earlier)]
        if not math.isnan(error):
            insort(self._errors, error)
            self._by_frame[frame] = error

    @property
    def text(self) -> str:
        """The median in words; "" without errors."""
        if not self._errors:
            return ""
        return f"off by {percent(upper_median(self._errors))}"


def progress_bar() -> Progress:
    """Return a progress bar on standard error; it prints nothing if this is no terminal."""
    console = Console(stderr=True)
    return Progress(
        _Description(),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,  # a log would get blank lines
    )


class _Description(ProgressColumn):
    """The description of a task, without control characters of terminals."""

    def render(self, task: Task) -> Text:
        return Text(printable(task.description))


class RunProgress:
    """The progress of a run on a terminal: speed, slowest stage, number of pairs by status.

    Frames are decoded and results are written in other threads. The slowest stage is the one that
    the main thread spends most time in, or waits most for.

    Attributes
    ----------
    last_seconds : float
        Time of the last stage, s.
    """

    def __init__(self) -> None:
        self.last_seconds = 0.0
        self.writer: PairWriter | None = None
        self._total: int | None = None
        self._bar = progress_bar()
        self._task = self._bar.add_task("", total=None)
        self._stage_seconds: dict[str, float] = {}
        self._steps: deque[tuple[float, int, dict[str, float]]] = deque(maxlen=_RECENT_PAIRS)
        self._estimate = TimeEstimate("pairs")
        self._is_announced = False

    def __enter__(self) -> "RunProgress":
        return self

    def __exit__(self, *details: object) -> None:
        self._bar.stop()

    def begin(self, writer: PairWriter, total: int | None) -> None:
        """Receive the writer of the run and the number of its pairs; None if unknown."""
        self.writer, self._total = writer, total
        self._bar.update(self._task, total=total)
        self._bar.start()
        self._steps.append((time.perf_counter(), 0, {}))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of a block for a stage."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.last_seconds = time.perf_counter() - begin
            self._stage_seconds[name] = self._stage_seconds.get(name, 0.0) + self.last_seconds

    def measure_items(self, name: str, items: Iterable[T]) -> Iterator[T]:
        """Yield items, and measure the time of fetching each of them for a stage."""
        iterator = iter(items)
        while True:
            with self.stage(name):
                try:
                    item = next(iterator)
                except StopIteration:
                    return
            yield item
            del item  # otherwise it would stay in memory until the next item is read

    def finish(self, name: str, statuses: Mapping[str, int], *, count: int = 1) -> None:
        """Show the last finished pair and the number of finished pairs by status.

        Other processes finish `count` pairs at a time; their stages are not known here.
        """
        self._steps.append((time.perf_counter(), count, dict(self._stage_seconds)))
        (begin, _, before), (end, _, after) = self._steps[0], self._steps[-1]
        speed = sum(step[1] for step in list(self._steps)[1:]) / max(end - begin, 1e-9)
        recent_seconds = {stage: after[stage] - before.get(stage, 0.0) for stage in after}
        slowest = max(recent_seconds, key=lambda stage: recent_seconds[stage], default="")
        stage = f", {slowest}" if slowest and recent_seconds[slowest] > 0 else ""
        counts = ", ".join(f"{count} {code}" for code, count in statuses.items())
        text = f"{name}: {speed:.3g} pairs/s{stage}" + (f"; {counts}" if counts else "")
        if self.writer is not None and not math.isnan(error := self.writer.median_error):
            text += f", off by {percent(error)}"
        self._bar.update(self._task, advance=count, description=text)

    def estimate(self, interpreted: int) -> None:
        """Print the remaining time of the run, from the pairs that this command interpreted."""
        if self._total is None or self.writer is None:
            return
        remaining = self._total - sum(self.writer.statuses.values())
        if not self._is_announced and self.writer.statuses:
            self._is_announced = True
            _announce(self.writer, remaining + 1)
        self._estimate.update(interpreted, interpreted + remaining)


def _announce(writer: PairWriter, count: int) -> None:
    """Print the expected size of a large run, and whether the disk has space for it."""
    expected, free = writer.expected_bytes(count), shutil.disk_usage(writer.folder).free
    if expected > free:
        tell(
            f"about {as_size(expected)} for {count} pairs, but {as_size(free)} are free: see "
            "--outputs"
        )
    elif expected > LARGE_OUTPUT:
        tell(f"about {as_size(expected)} for {count} pairs in {writer.folder}; --outputs chooses")


class StageTimes:
    """Measures the time of each stage of a reconstruction.

    Attributes
    ----------
    seconds : dict of str to float
        Times of the stages that have ended, s, in the order in which they began.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._stage: Stage | None = None
        self._since = self._begin = time.perf_counter()

    def enter(self, stage: Stage) -> None:
        """Begin a stage, or continue it."""
        if stage != self._stage:
            self._add()
            self._stage = stage

    def end(self) -> None:
        """End the last stage."""
        self._add()
        self._stage = None
        self.seconds["In all"] = self._since - self._begin

    def write(self, folder: Path) -> None:
        """Write the times, as ``timings.csv``.

        Only this file has timings, so that all other files are equal each time.
        """
        with atomic_write(folder / TIMINGS) as file:
            file.write(csv_table(("stage", "seconds"), self.seconds.items()).encode())

    def _add(self) -> None:
        now = time.perf_counter()
        name = "Start" if self._stage is None else _STAGE_NAMES[self._stage]
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._since
        self._since = now
