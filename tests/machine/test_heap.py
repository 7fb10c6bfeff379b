"""Memory that is freed: a worker of Dask keeps it."""

import os
import platform
import subprocess
import sys

import pytest

ARRAYS = """
import resource, sys, threading
import numpy as np
from tisfm.machine.heap import keep_freed_memory

def make():
    for _ in range(100):
        np.ones(1 << 22, np.uint8)

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
    assert page_faults("kept", MALLOC_TRIM_THRESHOLD_="65536") * 5 < page_faults(
        "as it is", MALLOC_TRIM_THRESHOLD_="65536"
    )


@pytest.mark.parametrize("asked", ["", "many", "-1", "99999999999999999999999"])
def test_other_thresholds_are_left(asked):
    page_faults("kept", MALLOC_TRIM_THRESHOLD_=asked)
