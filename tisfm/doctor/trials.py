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
_PROBE_CODE = (
    # Modules of the working folder must not replace modules of Python.
    "import sys; sys.path[:1] == [''] and sys.path.pop(0); import runpy; "
    "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
)
# All limits were set by hand.
ITEM_LIMIT = 30.0  # s, for each item of a trial
TOTAL_LIMIT = 120.0  # s, for all items of a trial together
_LIMIT_AFTER_HANG = 8.0  # s, for each item after one that hung: they hang for the same reason
_POLL_INTERVAL = 0.05  # s, for one reading of the output of a process

TrialResults = dict[str, dict[str, Any]]


class Trial:
    """Items that another process tries one after the other, in the background.

    If an item crashes or hangs, a new process tries the remaining items.
    """

    def __init__(
        self,
        names: Sequence[str],  # items, as `tisfm.doctor.probe` names them
        *,
        limit: float = ITEM_LIMIT,  # seconds after which an item counts as hanging
    ) -> None:
        self._limit, self._end = limit, time.monotonic() + TOTAL_LIMIT
        self._remaining, self._results = list(names), TrialResults()
        self._start()

    def poll(self) -> TrialResults | None:
        """Look briefly at the output of the process; return the results once all items are tried.

        The result of an item that failed has an ``error``.
        """
        if not self._remaining:
            return self._results
        if isinstance(self._process, str):
            self._take_output(self._process)
            return self._results if not self._remaining else None
        try:
            self._output, _ = self._process.communicate(timeout=_POLL_INTERVAL)
            self._take_output(_exit_text(self._process.returncode))
        except subprocess.TimeoutExpired as error:
            now = time.monotonic()
            if error.stdout is not None and len(error.stdout) > len(self._output):
                self._output, self._since = error.stdout, now
            if now - self._since > self._limit or now > self._end:
                self._process.kill()
                self._output, _ = self._process.communicate()
                self._take_output(f"it did not end within {now - self._since:.0f} s")
                self._limit = min(self._limit, _LIMIT_AFTER_HANG)
        return None if self._remaining else self._results

    def _start(self) -> None:
        self._output, self._since = b"", time.monotonic()
        self._process: subprocess.Popen[bytes] | str = (
            _start_process(self._remaining) if self._remaining else ""
        )

    def _take_output(self, exit_text: str) -> None:
        """Take the output and the end of a process; start another one for the remaining items."""
        self._results |= _parse_output(self._remaining, self._output, exit_text)
        self._remaining = [name for name in self._remaining if name not in self._results]
        if self._remaining and time.monotonic() > self._end:
            error = f"it was not tried: others took {TOTAL_LIMIT:.0f} s"
            self._results |= {name: {"error": error} for name in self._remaining}
            self._remaining = []
        self._start()


def collect_results(*trials: Trial) -> TrialResults:
    """Wait for trials, and return the results of all.

    No thread is started for them, since memory may not suffice for one.
    """
    all_results: TrialResults = {}
    remaining = list(trials)
    while remaining:
        for trial in list(remaining):
            trial_results = trial.poll()
            if trial_results is not None:
                all_results |= trial_results
                remaining.remove(trial)
    return all_results


def run_trial(names: Sequence[str], *, limit: float = ITEM_LIMIT) -> TrialResults:
    """Try items in another process and wait for the results: see `Trial`."""
    return collect_results(Trial(names, limit=limit))


def _start_process(names: Sequence[str]) -> subprocess.Popen[bytes] | str:
    """Start a process that tries items; return the reason if no process can be started."""
    try:
        return subprocess.Popen(
            [sys.executable, "-c", _PROBE_CODE, str(_PROBE), *names],
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


def _parse_output(names: Sequence[str], output: bytes, exit_text: str) -> TrialResults:
    """Return the result of each item that a process came to, from its output."""
    results: TrialResults = {}
    for line in output.decode("utf-8", "replace").splitlines():
        try:
            result = json.loads(line)
            results[result.pop("name")] = result
        except (ValueError, LookupError, AttributeError):
            continue
    for result in results.values():
        if result.pop("begun", False):
            result["error"] = exit_text or "it did not say how it ended"
    if not results:  # the process ended before the first item
        reason = exit_text or "the process said nothing"
        results = {name: {"error": reason} for name in names}
    return {name: result for name, result in results.items() if name in names}
