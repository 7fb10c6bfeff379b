"""Taichi's cache after a process was killed that wrote there."""

import os
import subprocess
import sys
import time

import pytest

from tisfm.machine.kernel_cache import _take_turn, remove_stale_lock

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Taichi keeps its cache elsewhere there")
UNDISTORT = """
import numpy as np
import tisfm
frame = np.random.default_rng(0).integers(0, 255, (30, 40)).astype(np.uint8)
camera = tisfm.Camera(40.0, distortion=(-0.2, 0.0, 0.0, 0.0))
print(tisfm.lens.undistort(frame, camera).sum(dtype=int))
"""


@pytest.fixture
def cache(tmp_path):
    folder = tmp_path / "taichi" / "ticache"
    folder.mkdir(parents=True)
    return folder


def undistort(cache):
    """Compile or load kernels in a process of their own, and print a sum."""
    variables = {
        **os.environ,
        "XDG_CACHE_HOME": str(cache.parents[1]),
        "PYTHONWARNINGS": "ignore::DeprecationWarning",
    }
    variables.pop("TI_OFFLINE_CACHE_FILE_PATH", None)
    done = subprocess.run(
        [sys.executable, "-c", UNDISTORT], env=variables, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout


def leave(path, age):
    path.touch()
    os.utime(path, (time.time() - age,) * 2)


@pytest.mark.nightly
def test_a_stale_lock_is_removed_and_kernels_are_kept(cache):
    """Left there, Taichi would complain, and neither read nor write."""
    leave(cache / "ticache.lock", age=600)
    first = undistort(cache)
    assert not (cache / "ticache.lock").exists()
    assert list(cache.glob("T*.tic")) and (cache / "ticache.tcb").exists()

    kernels = {path: path.stat().st_size for path in cache.glob("T*.tic")}
    (cache / "ticache.tcb").unlink()  # killed before it was written, in the middle of kernels
    for path in kernels:
        path.write_bytes(b"")
    leave(cache / "ticache.lock", age=600)
    assert undistort(cache) == first
    assert {path: path.stat().st_size for path in cache.glob("T*.tic")} == kernels


@pytest.mark.parametrize("listed", [None, 700])
def test_kernels_from_before_the_lock_are_kept(cache, listed):
    if listed:
        leave(cache / "ticache.tcb", age=listed)
    leave(cache / "Told.tic", age=700)
    leave(cache / "ticache.lock", age=600)
    leave(cache / "Tcut.tic", age=599)
    leave(cache / "other", age=599)
    remove_stale_lock(cache)
    left = sorted(path.name for path in cache.iterdir() if path.suffix != ".tcb")
    assert left == ["Told.tic", "other"]


def test_kernels_that_were_listed_are_kept(cache):
    """They are whole; without a file, a kernel that is listed would never be written again."""
    leave(cache / "ticache.lock", age=600)
    leave(cache / "Tone.tic", age=599)
    leave(cache / "ticache.tcb", age=598)
    remove_stale_lock(cache)
    assert sorted(path.name for path in cache.iterdir()) == ["Tone.tic", "ticache.tcb"]


@pytest.mark.parametrize("age", [0, 60, -3600], ids=["new", "a minute", "a clock ahead"])
def test_a_lock_that_may_be_held_is_left(cache, age):
    leave(cache / "ticache.lock", age=age)
    remove_stale_lock(cache)
    assert (cache / "ticache.lock").exists()


def test_a_cache_without_a_lock_is_unchanged(cache):
    leave(cache / "Tone.tic", age=600)
    remove_stale_lock(cache)
    assert (cache / "Tone.tic").exists()


@pytest.mark.skipif(os.name == "nt", reason="there are no such locks")
def test_processes_that_end_together_write_one_after_the_other(cache):
    turns = f"""
import pathlib, sys, time
from tisfm.machine.kernel_cache import _take_turn
print("ready", flush=True)
sys.stdin.readline()
_take_turn(pathlib.Path({str(cache)!r}))
print(time.time(), flush=True)
sys.stdin.readline()
print(time.time(), flush=True)
"""
    first, second = (
        subprocess.Popen(
            [sys.executable, "-c", turns],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for _ in range(2)
    )  # fmt: skip
    with first, second:
        for process in (first, second):
            assert process.stdout.readline() == "ready\n"
        first.stdin.write("\n")
        first.stdin.flush()
        first.stdout.readline()  # it has its turn
        second.stdin.write("\n")
        second.stdin.flush()
        time.sleep(0.3)
        first.stdin.write("\n")
        first.stdin.flush()
        ended = float(first.stdout.readline())
        assert float(second.stdout.readline()) >= ended
        second.stdin.write("\n")


@pytest.mark.skipif(os.name == "nt", reason="there are no such locks")
def test_a_turn_that_never_comes_is_not_waited_for(cache, monkeypatch):
    import fcntl

    monkeypatch.setattr("tisfm.machine.kernel_cache._MAX_LOCK_WAIT", 0.1)
    with open(cache / "tisfm.turn", "w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        begin = time.monotonic()
        _take_turn(cache)
        assert time.monotonic() - begin >= 0.1  # and it ends
    _take_turn(cache / "gone")
