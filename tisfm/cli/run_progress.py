"""How far a run is: pairs per second, time left, what limits it, and a count of statuses."""

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

from tisfm.cli.console import progress_bar

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
