"""Memory that is freed: a worker of Dask keeps it."""

import os
import platform
import subprocess
import sys

import pytest

from tisfm.machine import memory

ARRAYS = """
import resource, sys, threading
import numpy as np
from tisfm.machine.memory import keep_freed_memory

def make():
    for _ in range(100):
        np.ones(1 << 20, np.uint8)  # less than a huge page

if sys.argv[1] == "kept":
    keep_freed_memory()
make()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
make()
thread = threading.Thread(target=make)
thread.start()
thread.join()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(kind, **environment):
    run = subprocess.run(
        [sys.executable, "-c", ARRAYS, kind],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return int(run.stdout)


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="the C library has no such thresholds"
)
def test_arrays_of_a_worker_take_no_new_pages():
    given_back = page_faults("as it is", MALLOC_TRIM_THRESHOLD_="65536")
    if given_back < 10_000:
        pytest.skip("the system counts no page faults, or has larger pages")
    assert page_faults("kept", MALLOC_TRIM_THRESHOLD_="65536") * 5 < given_back


@pytest.mark.parametrize(
    ("asked", "changed"),
    [("65536", True), ("0", True), ("67108864", False), ("-1", False), ("", False), ("x", False),
     (None, False)],
)  # fmt: skip
def test_only_a_small_threshold_is_changed(asked, changed, monkeypatch):
    calls = []

    class Library:
        mallopt = staticmethod(lambda *arguments: calls.append(arguments))

    monkeypatch.setattr(memory.ctypes, "CDLL", lambda name: Library)
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)
    if asked is not None:
        monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", asked)
    memory.keep_freed_memory()
    assert [parameter for parameter, _ in calls] == ([-3, -1] if changed else [])


def test_a_c_library_without_it(monkeypatch):
    monkeypatch.setattr(memory.ctypes, "CDLL", lambda name: object())
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    memory.keep_freed_memory()
