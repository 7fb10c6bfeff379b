"""Trying things out in processes of their own, which may crash or hang."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

_PROBE = Path(__file__).with_name("probe.py")
_CALL = (
    # No module of the working folder is one of Python's.
    "import sys; sys.path[:1] == [''] and sys.path.pop(0); import runpy; "
    "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
)
LIMIT = 60.0  # s

Tried = dict[str, dict[str, Any]]


def try_out(names: Sequence[str], *, limit: float = LIMIT) -> Tried:
    """Try things out in another process; return what it said of each, with ``error`` if it failed.

    Parameters
    ----------
    names : sequence of str
        As `tisfm.doctor.probe` knows them.
    limit : float
        After so many seconds it is ended.
    """
    call = [sys.executable, "-c", _CALL, str(_PROBE), *names]
    ended = ""
    try:
        done = subprocess.run(
            call,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=limit,
            env={**os.environ, "PYTHONIOENCODING": "utf-8"},
        )
        output = done.stdout
        if done.returncode:
            ended = f"the process ended with exit code {done.returncode}"
            if done.returncode < 0:
                ended = f"the process crashed (signal {-done.returncode})"
    except subprocess.TimeoutExpired as error:
        output, ended = error.stdout or b"", f"it did not end within {limit:.0f} s"
    except OSError as error:
        output, ended = b"", f"no process can be started ({error.strerror})"
    return _told(names, output, ended)


class Trials:
    """Several processes that try things out at the same time; a context manager."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(4)

    def begin(self, names: Sequence[str], *, limit: float = LIMIT) -> "Future[Tried]":
        """Begin to try things out."""
        return self._executor.submit(try_out, names, limit=limit)

    def __enter__(self) -> "Trials":
        return self

    def __exit__(self, *about: object) -> None:
        self._executor.shutdown()


def _told(names: Sequence[str], output: bytes, ended: str) -> Tried:
    """Read what the process said; what it had begun as it ended did not work."""
    found: Tried = {}
    for line in output.decode("utf-8", "replace").splitlines():
        try:
            about = json.loads(line)
            found[about.pop("name")] = about
        except (ValueError, LookupError, AttributeError):
            continue
    for name in names:
        about = found.setdefault(name, {"error": ended or "it was not tried"})
        if about.pop("begun", False):
            about["error"] = ended or "it did not say how it ended"
    return found
