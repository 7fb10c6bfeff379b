"""Bandwidth of the memory, to which the bandwidth of kernels is compared."""

import numpy as np
import pytest
import taichi as ti

from tisfm import runtime
from tisfm.kernels.layout.lanes import LaneArray, aligned_zeros, lane_kernel, on_host

LENGTH = 2**26  # float32, 256 MiB per array, larger than the caches


@lane_kernel
def _copy(a: LaneArray(1), out: LaneArray(1)):
    for i in range(out.shape[0]):
        out[i] = a[i]


@lane_kernel
def _triad(a: LaneArray(1), b: LaneArray(1), out: LaneArray(1)):
    for i in range(out.shape[0]):
        out[i] = a[i] + 3.0 * b[i]


@pytest.fixture(scope="module")
def arrays():
    lanes, grid = runtime.lanes(), runtime.lane_grid(1, 1)
    a, b, out = (aligned_zeros((LENGTH // lanes, lanes)) for _ in range(3))
    a[...] = np.arange(lanes) + 1
    b[...] = 1
    shape = (LENGTH,) if lanes == 1 else a.shape
    return tuple(grid.place(array.reshape(shape)) for array in (a, b, out))


STREAMS = {
    "copy": (2, lambda a, b, out: _copy[runtime.lanes()](a, out)),
    "triad": (3, lambda a, b, out: _triad[runtime.lanes()](a, b, out)),
    "NumPy copy": (2, lambda a, b, out: np.copyto(out, a)),
}


@pytest.mark.parametrize("name", STREAMS)
def bench_stream(name, arrays, measure):
    if name == "NumPy copy" and runtime.runs_on_gpu():
        pytest.skip("NumPy cannot access the memory of a GPU")
    words, move = STREAMS[name]

    def call():
        move(*arrays)
        ti.sync()

    call()
    a, b, out = map(on_host, arrays)
    assert np.array_equal(out, a + 3 * b if name == "triad" else a)
    measure(call, implementation="stream", kernel=name, bytes=4 * words * LENGTH)
