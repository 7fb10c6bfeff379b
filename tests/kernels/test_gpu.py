"""Kernels on a GPU, and its ways (one lane, arrays on a device, plain vectors) on the CPU."""

import importlib
import os
import pkgutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import taichi as ti

import tisfm
from tests.draws import nightly_except
from tisfm import runtime, scenes

GPUS = ("cuda", "vulkan", "metal")
CAMERA = tisfm.Settings.preset("fast", motion="camera")
# By name: settings, and a scene of an odd size.
CASES = {
    "field": (tisfm.Settings(), lambda: scenes.two_blocks(61, 83)),
    "translation": (
        tisfm.Settings.preset("fast", model="translation", solver="closed_form"),
        lambda: scenes.two_blocks(45, 67),
    ),
    "paper": (
        tisfm.Settings.preset("paper", outer_iterations=20),
        lambda: scenes.two_blocks(37, 51),
    ),
    "camera": (CAMERA, lambda: scenes.static_scene("sideways+rotation", 91, 117)),
    "objects": (
        tisfm.Settings.preset("fast", motion="objects"),
        lambda: scenes.two_blocks(97, 131),
    ),
}
# As on a GPU, whose vectors the compiler takes apart. Only the device is the CPU.
EMULATED = """
import os, warnings
warnings.simplefilter("ignore")  # of slow kernels for vectors: none are compiled here
os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"
import taichi as ti
ti.init(ti.cpu, fast_math=False, log_level=ti.WARN)
from tisfm import runtime
runtime.runs_on_gpu = lambda: True
"""
STARTED = """
from tisfm import runtime
from tisfm.machine.vulkan import software_vulkan
if sys.argv[2] == "vulkan" and software_vulkan():
    sys.exit(f"Vulkan has no GPU here: {software_vulkan()} is software on the CPU")
runtime.start(sys.argv[2])
"""
INTERPRET = """
import pickle
import tisfm
for path in sys.argv[1].split(","):
    frame0, frame1, camera, settings = pickle.load(open(path, "rb"))
    result = tisfm.interpret(frame0, frame1, camera=camera, settings=settings)
    assert runtime.lanes() == 1
    result.save(path + ".npz")
"""

on_each_gpu = pytest.mark.parametrize(
    "arch", [pytest.param(arch, marks=pytest.mark.gpu) for arch in GPUS]
)


def python(code, *arguments, **environment):
    return subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", "import sys\n" + code]
        + [str(argument) for argument in arguments],
        capture_output=True,
        text=True,
        env=os.environ | environment,
        check=False,
    )


@cache
def obstacle(arch):
    """Return why there is no GPU for an arch of Taichi, or an empty string."""
    done = python(STARTED, "", arch)
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["it crashed"])[-1]


def need(arch):
    if obstacle(arch):
        pytest.skip(obstacle(arch))


def interpreted_elsewhere(code, cases, folder, *arguments):
    """Interpret cases in a process of their own; return each result with that of this process."""
    import pickle

    scenes, paths = {case: CASES[case][1]() for case in cases}, []
    for case, scene in scenes.items():
        paths.append(folder / case)
        pair = scene.frame0, scene.frame1, scene.camera, CASES[case][0]
        paths[-1].write_bytes(pickle.dumps(pair))
    done = python(code + INTERPRET, ",".join(map(str, paths)), *arguments)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    found = {}
    for case, scene in scenes.items():
        here = tisfm.interpret(
            scene.frame0, scene.frame1, camera=scene.camera, settings=CASES[case][0]
        )
        found[case] = tisfm.Interpretation.load(f"{folder / case}.npz"), here
    return found


def assert_the_same(result, expected):
    """Roundings differ, and by them now and then a decision at a single pixel."""
    away = np.hypot(*np.moveaxis(result.flow - expected.flow, -1, 0))
    assert np.quantile(away, 0.999) < 0.01
    assert np.abs(expected.flow).max() > 0.3
    assert (result.occlusion != expected.occlusion).mean() < 0.002
    assert result.status == expected.status
    assert np.quantile(np.abs(result.confidence - expected.confidence), 0.99) < 0.01
    if expected.motions is not None:
        assert (result.labels != expected.labels).mean() < 0.002
        np.testing.assert_allclose(result.motions, expected.motions, atol=2e-3)
        both = np.isfinite(result.depth) & np.isfinite(expected.depth)
        assert both.mean() > 0.8
        ratio = result.depth[both] / expected.depth[both]
        assert np.quantile(np.abs(ratio - 1), 0.95) < 0.01


# On the CPU as on a GPU


@pytest.mark.parametrize("case", nightly_except("translation", of=CASES))
def test_kernels_of_a_gpu_give_the_same_answer(case, tmp_path):
    assert_the_same(*interpreted_elsewhere(EMULATED, [case], tmp_path)[case])


def test_arrays_of_a_grid_stay_on_the_device(monkeypatch):
    monkeypatch.setattr(runtime, "runs_on_gpu", lambda: True)
    pair = scenes.two_blocks(24, 33, samples=1)
    grids = []

    def counted(height, width):
        grids.append(lane_grid(height, width))
        return grids[-1]

    lane_grid = runtime.lane_grid
    monkeypatch.setattr("tisfm.solver.coarse_to_fine.lane_grid", counted)
    tisfm.interpret(pair.frame0, pair.frame1, settings=tisfm.Settings.preset("fast"))
    assert grids and all(grid.on_device and grid.lanes == 1 for grid in grids)
    assert isinstance(grids[0].allocate(2), ti.Ndarray)


def test_arrays_come_back_from_the_device():
    from tisfm.kernels.layout.lanes import LaneGrid, on_host

    values = np.random.default_rng(0).normal(size=(2, 7, 8)).astype(np.float32)
    device, host = LaneGrid(5, 6, lanes=1, on_device=True), LaneGrid(5, 6, lanes=1)
    placed = device.place(values)
    assert isinstance(placed, ti.Ndarray) and not isinstance(host.place(values), ti.Ndarray)
    for grid, array in ((device, placed), (host, values)):
        other = grid.allocate(2)
        assert not on_host(other).any()
        grid.check(other, 2, "other")
        grid.copy(array, other)
        np.testing.assert_array_equal(on_host(other), values)
    assert on_host(values) is values
    vectors = device.place(values, vectors=True)
    assert (vectors.shape, vectors.element_shape) == ((2, 7), (8,))
    np.testing.assert_array_equal(on_host(vectors), values)
    with pytest.raises(ValueError, match=r"rho is \(2, 7, 8\): expected \(3, 7, 8\)"):
        device.check(placed, 3, "rho")
    with pytest.raises(TypeError, match="rho is i32: expected a NumPy array of float32"):
        device.check(ti.ndarray(ti.i32, (2, 7, 8)), 2, "rho")
    with pytest.raises(ValueError, match="lanes is 8 and on_device is True: expected 1 lane"):
        LaneGrid(5, 6, lanes=8, on_device=True)


def test_no_kernel_for_one_lane_has_float64():
    """Many GPUs have none."""
    from tisfm import kernels
    from tisfm.kernels.layout.launch import Kernel

    found = 0
    for info in pkgutil.walk_packages(kernels.__path__, "tisfm.kernels."):
        module = importlib.import_module(info.name)
        for value in vars(module).values():
            kernel = value.get(1) if isinstance(value, dict) else value
            if isinstance(kernel, Kernel):
                found += 1
                for annotation in kernel.arguments.annotations:
                    kind = getattr(annotation, "dtype", annotation)
                    assert kind is not ti.f64, info.name
    assert found > 15


# On a GPU


@on_each_gpu
@pytest.mark.parametrize("case", CASES)
def test_a_gpu_gives_the_answer_of_the_cpu(arch, case, tmp_path):
    need(arch)
    assert_the_same(*interpreted_elsewhere(STARTED, [case], tmp_path, arch)[case])


@on_each_gpu
def test_a_gpu_gives_the_same_flow_twice(arch, tmp_path):
    need(arch)
    first, second = (
        interpreted_elsewhere(STARTED, ["field"], tmp_path, arch)["field"][0] for _ in range(2)
    )
    np.testing.assert_array_equal(first.flow, second.flow)


@on_each_gpu
def test_every_kernel_agrees_with_the_reference_on_a_gpu(arch):
    need(arch)
    folder = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider"]
        + [
            str(folder / name)
            for name in ("test_fields.py", "test_data.py", "test_solve.py", "test_epipolar.py")
        ],
        cwd=folder.parents[1],
        env=os.environ | {"TI_ARCH": arch},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:]
