"""Options and fixtures of the benchmarks; `python -m bench` sets the options."""

import subprocess
import time

import cv2
import numpy as np
import pytest

from bench.shared.problems import Problem, problem_at
from tisfm import runtime

SLOW = 2.0  # s: a slower call is timed once


def pytest_addoption(parser):
    group = parser.getgroup("tisfm")
    group.addoption("--arch", default="cpu", help="where kernels run")
    group.addoption("--threads", type=int, default=2, help="threads of Taichi in this process")
    group.addoption("--sizes", default="240x320", help="sizes, HxW, separated by commas")
    lanes = str(runtime.cpu_lanes())
    group.addoption("--lanes", default=lanes, help="lane counts, separated by commas")
    group.addoption("--seconds", type=float, default=0.5, help="time to spend on a measurement")
    group.addoption("--full-reference", action="store_true", help="NumPy pairs at every size")


def pytest_sessionstart(session):
    """Start Taichi and OpenCV, whose numbers of threads are fixed in a process."""
    threads = session.config.getoption("threads")
    runtime.start(session.config.getoption("arch"), threads=threads)
    cv2.setNumThreads(threads)


def pytest_generate_tests(metafunc):
    sizes = metafunc.config.getoption("sizes").split(",")
    lanes = [int(count) for count in metafunc.config.getoption("lanes").split(",")]
    if "problem" in metafunc.fixturenames:
        # By session, so that all benchmarks of one size run before the next size.
        metafunc.parametrize("problem", sizes, indirect=True, scope="session")
    if "lanes" in metafunc.fixturenames:
        metafunc.parametrize("lanes", lanes, ids=[f"lanes{count}" for count in lanes])


def pytest_benchmark_update_machine_info(config, machine_info):
    import taichi

    machine_info["numpy"] = np.__version__
    machine_info["taichi"] = ".".join(map(str, taichi.__version__))
    machine_info["threads"] = config.getoption("threads")
    machine_info["arch"] = config.getoption("arch")
    machine_info["gpu"] = nvidia_gpu() if machine_info["arch"] == "cuda" else None


def nvidia_gpu() -> str | None:
    """Return the name of the GPU if nvidia-smi reports one."""
    command = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    return next(iter(lines.splitlines()), None)


@pytest.fixture(scope="session")
def problem(request) -> Problem:
    height, width = map(int, request.param.split("x"))
    return problem_at(height, width)


@pytest.fixture
def measure(benchmark, request):
    """Return a function that times a call and stores the timings under a label.

    The call must have run before, so that it is compiled. `warm=False` skips the warm-up of a long
    call.
    """

    def timed(call, *, warm=True, **label):
        option = request.config.getoption
        benchmark.extra_info.update(label, threads=option("threads"))
        if not warm:
            return benchmark.pedantic(call)
        start_time = time.perf_counter()
        call()
        once = time.perf_counter() - start_time
        rounds = min(max(round(option("seconds") / once), 3 if once < SLOW else 1), 200)
        return benchmark.pedantic(call, rounds=rounds)

    return timed


@pytest.fixture
def full_reference(request) -> bool:
    return request.config.getoption("full_reference")
