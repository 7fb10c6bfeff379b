"""Waiting in tests, and processes that tests start: on busy machines, and in the background.

A test waits for an event, never for a number of seconds in which the event should have happened.
"""

import signal
import subprocess
import time
from contextlib import contextmanager

PATIENCE = 600.0  # s until a test gives up; a test that passes does not wait this long
_PAUSE = 0.02  # s


def wait_for(condition, process=None):
    """Wait until a condition holds; fail if a process ends before, or after `PATIENCE`."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if process is not None and process.poll() is not None and not condition():
            said = process.stderr.read() if process.stderr else ""
            raise AssertionError(f"the process ended with exit code {process.returncode}: {said}")
        assert time.monotonic() < end, f"the condition did not hold within {PATIENCE:g} s"
        time.sleep(_PAUSE)


@contextmanager
def started(command, **options):
    """Start a process that Ctrl-C interrupts; leaving the block kills it if it still runs.

    A shell lets its background jobs ignore SIGINT, and every process inherits this from the one
    that starts it. Programs keep it. Tests that send the signal need a process that obeys.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(command, **options)
    finally:
        signal.signal(signal.SIGINT, before)
    with process:
        try:
            yield process
        finally:
            process.kill()
