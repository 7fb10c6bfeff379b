"""Trials of libraries and kernels, in processes of their own that may crash or hang."""

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
# All of these were set by hand.
LIMIT = 30.0  # s, for each item of a trial
IN_ALL = 120.0  # s, for all items of a trial together
_AFTER_ONE = (
    8.0  # s, for each further item once one has hung: the next ones hang for the same reason
)
_LOOK = 0.05  # s, of one look at the output of a process

TrialResults = dict[str, dict[str, Any]]


class Trial:
    """Items that another process tries one after the other, in the background.

    If an item crashes or hangs, a new process tries the remaining items.
    """

    def __init__(
        self,
        names: Sequence[str],  # items, as `tisfm.doctor.probe` names them
        *,
        limit: float = LIMIT,  # seconds after which an item counts as hanging
    ) -> None:
        self._limit, self._end = limit, time.monotonic() + IN_ALL
        self._left, self._found = list(names), TrialResults()
        self._start()

    def poll(self) -> TrialResults | None:
        """Look briefly at the output of the process; return the results once all items are tried.

        The result of an item that failed has an ``error``.
        """
        if not self._left:
            return self._found
        if isinstance(self._process, str):
            self._take_output(self._process)
            return self._found if not self._left else None
        try:
            self._output, _ = self._process.communicate(timeout=_LOOK)
            self._take_output(_exit_text(self._process.returncode))
        except subprocess.TimeoutExpired as error:
            now = time.monotonic()
            if error.stdout is not None and len(error.stdout) > len(self._output):
                self._output, self._since = error.stdout, now
            if now - self._since > self._limit or now > self._end:
                self._process.kill()
                self._output, _ = self._process.communicate()
                self._take_output(f"it did not end within {now - self._since:.0f} s")
                self._limit = min(self._limit, _AFTER_ONE)
        return None if self._left else self._found

    def _start(self) -> None:
        self._output, self._since = b"", time.monotonic()
        self._process: subprocess.Popen[bytes] | str = (
            _started_process(self._left) if self._left else ""
        )

    def _take_output(self, ended: str) -> None:
        """Take the output and the end of a process; start another one for the remaining items."""
        self._found |= _parsed_output(self._left, self._output, ended)
        self._left = [name for name in self._left if name not in self._found]
        if self._left and time.monotonic() > self._end:
            error = f"it was not tried: others took {IN_ALL:.0f} s"
            self._found |= {name: {"error": error} for name in self._left}
            self._left = []
        self._start()


def results(*trials: Trial) -> TrialResults:
    """Wait for trials, and return the results of all.

    No thread is started for them, since memory may not suffice for one.
    """
    found: TrialResults = {}
    left = list(trials)
    while left:
        for trial in list(left):
            done = trial.poll()
            if done is not None:
                found |= done
                left.remove(trial)
    return found


def run_trial(names: Sequence[str], *, limit: float = LIMIT) -> TrialResults:
    """Try items in another process and wait for the results: see `Trial`."""
    return results(Trial(names, limit=limit))


def _started_process(names: Sequence[str]) -> subprocess.Popen[bytes] | str:
    """Start a process that tries items, or return why none can be started."""
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


def _exit_text(code: int) -> str:
    if code < 0:
        return f"the process crashed (signal {-code})"
    return f"the process ended with exit code {code}" if code else ""


def _parsed_output(names: Sequence[str], output: bytes, ended: str) -> TrialResults:
    """Return the result of each item that a process came to, from its output."""
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
    if not found:  # the process ended before the first item
        why = ended or "the process said nothing"
        found = {name: {"error": why} for name in names}
    return {name: about for name, about in found.items() if name in names}
