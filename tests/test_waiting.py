"""The tests themselves: they pass on a busy machine and in the background of a script."""

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from tests import waiting
from tests.waiting import PATIENCE, started, wait_for

TESTS = Path(__file__).parent
SLEEP = (sys.executable, "-c", f"print(flush=True); import time; time.sleep({PATIENCE})")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_a_process_that_a_test_in_the_background_starts():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell does
    try:
        with started(SLEEP, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
            assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
            process.stdout.readline()
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == -signal.SIGINT
    finally:
        signal.signal(signal.SIGINT, before)


def test_no_process_outlives_its_test():
    with pytest.raises(ZeroDivisionError), started(SLEEP, stdout=subprocess.PIPE) as process:
        raise ZeroDivisionError
    assert process.returncode not in (None, 0)


def test_waiting_ends(monkeypatch):
    with started((sys.executable, "-c", "exit('gone')"), stderr=subprocess.PIPE, text=True) as ends:
        with pytest.raises(AssertionError, match="the process ended with exit code 1: gone"):
            wait_for(lambda: False, ends)
        wait_for(lambda: True, ends)
    monkeypatch.setattr(waiting, "PATIENCE", 0.05)
    with pytest.raises(AssertionError, match="the condition did not hold within"):
        wait_for(lambda: False)


def test_drawn_examples_have_no_deadline():
    assert settings.default.deadline is None


def test_limits_are_those_of_a_busy_machine():
    """A limit that must suffice is `PATIENCE`; signals go to what `started` has started."""
    wrong = []
    for path in sorted(TESTS.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        wrong += [
            f"{path.name}: timeout={limit}"
            for limit in re.findall(r"\btimeout=(\d[\d_.]*)[,)]", text)
            if float(limit) >= 1  # a shorter one is there to be exceeded
        ]
        if ".send_signal(" in text and "import PATIENCE, started" not in text:
            wrong.append(f"{path.name}: send_signal without started")
    assert not wrong
