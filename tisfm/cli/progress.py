"""Progress of commands: bars, rates, the time that is left, and how long stages took."""

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
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
from tisfm.machine.text import as_duration, printable
from tisfm.reconstruction.progress import Stage

STAGES: dict[Stage, str] = {"reading": "reading, tracking", "path": "path", "depth": "depth"}
"""The stages of a reconstruction in words."""
MUCH = 2e8  # bytes: work that writes more says so beforehand
_LONG = 60.0  # s: work that takes less is not worth a line
_WATCHED = 5.0  # s, after which its speed is known
_FIRST = 2  # what is done first takes longer: kernels are compiled


class Foretelling:
    """Says how long a number of things will take, by how fast the first ones were done.

    Parameters
    ----------
    what : str
        The things, such as "pairs".
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._since: float | None = None
        self._before = 0
        self._is_told = False

    def done(self, count: int, total: int | None) -> None:
        """Take down that so many of them are done by this command, of as many as there are to do.

        How long it takes is said when that is known.
        """
        if self._is_told or total is None or count < _FIRST:
            return
        now = time.monotonic()
        if self._since is None:
            self._since, self._before = now, count
            return
        spent, made = now - self._since, count - self._before
        if spent < _WATCHED or made < 1:
            return
        self._is_told = True
        left = spent / made * (total - count)
        if left > _LONG:
            speed = f"{made / spent:.2g} a second"
            tell(f"{total} {self._what}: about {as_duration(left)} to go, {speed}")


def progress_bar() -> Progress:
    """Return a progress bar on standard error, which a log gets nothing of."""
    console = Console(stderr=True)
    return Progress(
        _Description(),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,  # it would leave blank lines in a log
    )


class _Description(ProgressColumn):
    """The task of a progress bar, or its last finished item, made printable."""

    def render(self, task: Task) -> Text:
        return Text(printable(task.description))


RECENT = 20  # pairs: what the speed and the stage that limits are of

T = TypeVar("T")


class RunProgress:
    """Shows on a terminal how far a run is.

    The stage that limits is the one that the main thread spends most of its time in, or waits most
    for: frames are decoded and results are written beside it.

    Parameters
    ----------
    total : int or None
        Pairs, as far as that is known.

    Attributes
    ----------
    last : float
        Seconds that the last stage took.
    """

    def __init__(self, total: int | None) -> None:
        self.last = 0.0
        self._bar = progress_bar()
        self._task = self._bar.add_task("", total=total)
        self._spent: dict[str, float] = {}
        self._steps: deque[tuple[float, int, dict[str, float]]] = deque(maxlen=RECENT)

    def __enter__(self) -> "RunProgress":
        self._bar.start()
        self._steps.append((time.perf_counter(), 0, {}))
        return self

    def __exit__(self, *about: object) -> None:
        self._bar.stop()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time that the block takes for a stage."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.last = time.perf_counter() - begin
            self._spent[name] = self._spent.get(name, 0.0) + self.last

    def timed(self, name: str, items: Iterable[T]) -> Iterator[T]:
        """Yield items; what it takes to get each counts for a stage."""
        waiting = iter(items)
        while True:
            with self.stage(name):
                try:
                    item = next(waiting)
                except StopIteration:
                    return
            yield item
            del item  # or it would be held until the next one is there

    def finish(self, name: str, statuses: Mapping[str, int], *, count: int = 1) -> None:
        """Show that a pair of this name is done, and how many there are of each status so far.

        Other processes do several at a time, `count`; which stage limits there is not known.
        """
        self._steps.append((time.perf_counter(), count, dict(self._spent)))
        (begin, _, before), (end, _, after) = self._steps[0], self._steps[-1]
        speed = sum(step[1] for step in list(self._steps)[1:]) / max(end - begin, 1e-9)
        spent = {stage: after[stage] - before.get(stage, 0.0) for stage in after}
        limit = max(spent, key=lambda stage: spent[stage], default="")
        limits = f", {limit}" if limit and spent[limit] > 0 else ""
        counts = ", ".join(f"{count} {code}" for code, count in statuses.items())
        said = f"{name}: {speed:.3g} pairs/s{limits}" + (f"; {counts}" if counts else "")
        self._bar.update(self._task, advance=count, description=said)


NAMES: dict[Stage, str] = {
    "reading": "Reading and tracking",
    "path": "Path",
    "depth": "Depth of every frame",
}


class StageTimes:
    """Counts the time from what tells of one stage to what tells of the next.

    Attributes
    ----------
    seconds : dict of str to float
        Of the stages that have ended, by their names, in the order in which they began.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._stage: Stage | None = None
        self._since = self._begin = time.perf_counter()

    def enter(self, stage: Stage) -> None:
        """Say that a stage goes on, or begins."""
        if stage != self._stage:
            self._count()
            self._stage = stage

    def end(self) -> None:
        """Say that the last stage has ended."""
        self._count()
        self._stage = None
        self.seconds["In all"] = self._since - self._begin

    def _count(self) -> None:
        now = time.perf_counter()
        name = "Start" if self._stage is None else NAMES[self._stage]
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._since
        self._since = now
