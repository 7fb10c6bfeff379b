"""The same bits on one thread, in a process of its own, since the threads are chosen once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

several_threads = pytest.mark.skipif(
    os.cpu_count() == 1, reason="there is one core, so one thread for any number"
)


def bits_on_one_thread(module):
    """Return what the function `bits` of a module of tests returns on one thread."""
    script = (
        "from tisfm import runtime\n"
        "runtime.start(threads=1)\n"
        f"from {module} import bits\n"
        "assert runtime.threads() == 1\n"
        "print(bits())\n"
    )
    root = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=root, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()
