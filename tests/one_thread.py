"""The same bits on one thread, in a process of its own, since the threads are chosen once."""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

several_threads = pytest.mark.skipif(
    os.cpu_count() == 1, reason="there is one core, so one thread for any number"
)
# For every name of a module that it reads, it prints the mark and the bits. It ends with its input.
MARK = "bits: "
SCRIPT = f"""
import sys
from importlib import import_module
from tisfm import runtime
runtime.start(threads=1)
for line in sys.stdin:
    found = import_module(line.strip()).bits()
    assert runtime.threads() == 1
    print({MARK!r} + found, flush=True)
"""


def bits_on_one_thread(module):
    """Return what the function `bits` of a module of tests returns on one thread."""
    process = _process()
    process.stdin.write(module + "\n")
    process.stdin.flush()
    others = []  # Taichi greets, and an error is told
    for line in process.stdout:
        if line.startswith(MARK):
            return line.removeprefix(MARK).strip()
        others.append(line)
    _process.cache_clear()
    raise AssertionError(f"{module} on one thread: {''.join(others)}")


@cache
def _process():
    """Start the process that all modules share: it imports and compiles once."""
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        cwd=Path(__file__).parents[1],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
