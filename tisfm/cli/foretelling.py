"""What long work will take: said once, in a line, as soon as it can be told."""

import time

from tisfm.cli.console import tell
from tisfm.machine.amounts import as_duration
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
