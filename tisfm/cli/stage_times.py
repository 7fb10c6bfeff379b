"""How long the stages of a reconstruction took."""

import time

from tisfm.reconstruction.progress import Stage

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
