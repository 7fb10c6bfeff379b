"""Trying things out in processes of their own, which may crash or hang."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_PROBE = Path(__file__).with_name("probe.py")
_CALL = (
    # No module of the working folder is one of Python's.
    "import sys; sys.path[:1] == [''] and sys.path.pop(0); import runpy; "
    "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
)
LIMIT, IN_ALL = 30.0, 120.0  # s: for each thing, and for all that are tried one after the other
_AFTER_ONE = 8.0  # s: where one has hung, others that wait for the same are not given more
_LOOK = 0.05  # s, of a look at what a process says

TrialResults = dict[str, dict[str, Any]]


class Trial:
    """Things that are tried out one after the other, in the background, in another process.

    Where one of them crashes or hangs, those after it are tried in a new process.

    Parameters
    ----------
    names : sequence of str
        As `tisfm.doctor.probe` knows them.
    limit : float
        Seconds after which a thing is said to hang.
    """

    def __init__(self, names: Sequence[str], *, limit: float = LIMIT) -> None:
        self._limit, self._end = limit, time.monotonic() + IN_ALL
        self._left, self._found = list(names), TrialResults()
        self._begin()

    def go_on(self) -> TrialResults | None:
        """Look, for a moment, at what the process says; return what is found when all is tried.

        Of what failed, that has an ``error``.
        """
        if not self._left:
            return self._found
        if isinstance(self._process, str):
            self._take(self._process)
            return self._found if not self._left else None
        try:
            self._said, _ = self._process.communicate(timeout=_LOOK)
            self._take(_exit_of(self._process.returncode))
        except subprocess.TimeoutExpired as error:
            now = time.monotonic()
            if error.stdout is not None and len(error.stdout) > len(self._said):
                self._said, self._since = error.stdout, now
            if now - self._since > self._limit or now > self._end:
                self._process.kill()
                self._said, _ = self._process.communicate()
                self._take(f"it did not end within {now - self._since:.0f} s")
                self._limit = min(self._limit, _AFTER_ONE)
        return None if self._left else self._found

    def _begin(self) -> None:
        self._said, self._since = b"", time.monotonic()
        self._process: subprocess.Popen[bytes] | str = _begun(self._left) if self._left else ""

    def _take(self, ended: str) -> None:
        """Take what a process has said, which ended so; begin another for what is left."""
        self._found |= _told(self._left, self._said, ended)
        self._left = [name for name in self._left if name not in self._found]
        if self._left and time.monotonic() > self._end:
            error = f"it was not tried: others took {IN_ALL:.0f} s"
            self._found |= {name: {"error": error} for name in self._left}
            self._left = []
        self._begin()


def results(*trials: Trial) -> TrialResults:
    """Wait for trials, and return what was found of all.

    No thread is started for them, as there may be no memory for one.
    """
    found: TrialResults = {}
    left = list(trials)
    while left:
        for trial in list(left):
            done = trial.go_on()
            if done is not None:
                found |= done
                left.remove(trial)
    return found


def run_trial(names: Sequence[str], *, limit: float = LIMIT) -> TrialResults:
    """Try things out in another process, and wait for them: see `Trial`."""
    return results(Trial(names, limit=limit))


def _begun(names: Sequence[str]) -> subprocess.Popen[bytes] | str:
    """Begin a process, or say why there is none."""
    try:
        return subprocess.Popen(
            [sys.executable, "-c", _CALL, str(_PROBE), *names],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONIOENCODING": "utf-8"},
        )
    except (OSError, MemoryError) as error:
        return f"no process can be started ({getattr(error, 'strerror', None) or 'no memory'})"


def _exit_of(code: int) -> str:
    if code < 0:
        return f"the process crashed (signal {-code})"
    return f"the process ended with exit code {code}" if code else ""


def _told(names: Sequence[str], output: bytes, ended: str) -> TrialResults:
    """Read what the process said: of each thing that it came to, how that ended."""
    found: TrialResults = {}
    for line in output.decode("utf-8", "replace").splitlines():
        try:
            about = json.loads(line)
            found[about.pop("name")] = about
        except (ValueError, LookupError, AttributeError):
            continue
    for about in found.values():
        if about.pop("begun", False):
            about["error"] = ended or "it did not say how it ended"
    if not found:  # not even the first was begun
        why = ended or "the process said nothing"
        found = {name: {"error": why} for name in names}
    return {name: about for name, about in found.items() if name in names}
