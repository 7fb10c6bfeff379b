"""Modules that hang when they are imported, and a trial that notices it at once."""

import os
import subprocess
from pathlib import Path

from tests.waiting import PATIENCE
from tisfm.doctor.trials import Trial

_HANGS = """
import os, pathlib, time
for process in (os.getpid(), os.getppid()):  # on Windows the parent is what was started
    pathlib.Path({folder!r}, f"hanging{{process}}").touch()
time.sleep(1000)
"""


def write_module_that_hangs(folder, name):
    """Write a module that never finishes its import, and leaves a mark when it hangs."""
    (folder / f"{name}.py").write_text(_HANGS.format(folder=os.fspath(folder)))


def hasty_trial(folder):
    """Return a kind of `Trial` that gives up only on processes that hang."""

    class HastyTrial(Trial):
        def __init__(self, names, *, limit=0.0):
            super().__init__(names, limit=limit)

        def poll(self):
            hangs = isinstance(self._process, subprocess.Popen) and (
                Path(folder, f"hanging{self._process.pid}").exists()
            )
            self._limit = 0.0 if hangs else PATIENCE
            return super().poll()

    return HastyTrial
