"""Pools of processes: kills and errors."""

import os
import signal
import time
from pathlib import Path

import pytest

from tisfm.running.pool import open_pool


def square(number):
    return number**2


def square_or_die(item):
    """Kill the process at one item, the first so many times."""
    number, folder, times = item
    if number == 2:
        marks = len(list(Path(folder).iterdir()))
        if marks < times:
            Path(folder, f"{marks}").touch()
            time.sleep(0.2)  # others have begun
            os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def refuse(number):
    if number == 1:
        raise ValueError("one is refused")
    return number


@pytest.mark.nightly
def test_each_item_is_computed_once():
    with open_pool(2) as two:
        assert sorted(two.map_unordered(square, range(7))) == [(k, k**2) for k in range(7)]
        assert list(two.map_unordered(square, [])) == []


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="processes are not killed here")
def test_items_of_a_killed_process_are_computed_again(tmp_path):
    items = [(k, str(tmp_path), 2) for k in range(6)]
    with open_pool(2) as two:
        assert sorted(two.map_unordered(square_or_die, items)) == [(k, k**2) for k in range(6)]
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="processes are not killed here")
def test_an_item_that_always_kills_its_process_is_an_error(tmp_path):
    with open_pool(2) as two, pytest.raises(RuntimeError, match="workers were killed 3 times"):
        list(two.map_unordered(square_or_die, [(2, str(tmp_path), 100)]))


def test_an_error_is_raised_in_the_parent_process():
    with open_pool(2) as two, pytest.raises(ValueError, match="one is refused"):
        list(two.map_unordered(refuse, range(3)))
