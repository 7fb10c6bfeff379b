"""Fixtures shared by the tests."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

import tisfm
from bench import reference
from tests import draws, rendered
from tisfm import runtime

# Real sequences are no part of the project: a folder of them may lie beside the checkout.
BESIDE = Path(__file__).parents[2] / "shared" / "data"
SHARED_DATA = Path(os.environ.get("TISFM_DATA") or BESIDE)


def pytest_configure(config):
    """Choose between the short draws of properties and the long ones of -m nightly."""
    draws.configure(config)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Start Taichi once, before any test builds a kernel; on a GPU there is one lane."""
    draws.mark_drawn(items)
    if items and runtime.runs_on_gpu():
        wide = [item for item in items if _parameter(item, "lanes") not in (None, 1)]
        config.hook.pytest_deselected(items=wide)
        items[:] = [item for item in items if _parameter(item, "lanes") in (None, 1)]


def _parameter(item, name):
    return item.callspec.params.get(name) if hasattr(item, "callspec") else None


@pytest.fixture(autouse=True)
def arrays_on_the_device(monkeypatch):
    """On a GPU, give kernels copies there, as the driver does, and bring back what they left."""
    if not runtime.runs_on_gpu():
        return
    from tisfm.kernels.layout.lanes import LaneGrid, on_host
    from tisfm.kernels.layout.launch import Kernel

    grid, bind = LaneGrid(1, 1, lanes=1, on_device=True), Kernel.bind

    def placed(kernel, *arguments):
        def run():
            arrays = {
                index: grid.place(arguments[index])
                for index, _, axes, *_ in kernel.arguments.arrays
                if axes is None and getattr(arguments[index], "dtype", None) == np.float32
            }
            bind(kernel, *(arrays.get(index, value) for index, value in enumerate(arguments)))()
            for index, array in arrays.items():
                arguments[index][...] = on_host(array)

        return run

    monkeypatch.setattr(Kernel, "bind", placed)


@pytest.fixture
def shared_data():
    """Folder of real sequences; tests that need it skip where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no real sequences: TISFM_DATA is not set, and none lie beside the checkout")
    return SHARED_DATA


@pytest.fixture(scope="session", autouse=True)
def folder_of_films(tmp_path_factory):
    """Name the folder of rendered films, one for all processes of a run."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    folder = folder / "films"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(rendered.FOLDER, str(folder))
        yield


@pytest.fixture(scope="session")
def make_once(tmp_path_factory):
    """Return a function that fills a new folder once for all processes of a run."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent

    def make(name, fill):
        """Return the folder of a name, which `fill(folder)` has filled; nobody writes into it."""
        folder = base / "made_once" / name
        complete = folder.with_suffix(".complete")
        folder.parent.mkdir(exist_ok=True)
        with FileLock(f"{folder}.lock"):
            if not complete.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                fill(folder)
                complete.touch()
        return folder

    return make


@pytest.fixture(scope="session")
def documented_files(make_once):
    """A folder with the files that the documentation names."""
    from tests import documented

    return make_once("documented", documented.make)


@pytest.fixture
def documented_here(documented_files, tmp_path, monkeypatch):
    """The same in a new folder, the current one: hard links, as tisfm never writes into a file."""
    here = tmp_path / "here"
    shutil.copytree(
        documented_files, here, copy_function=os.link, ignore=shutil.ignore_patterns("*.lock")
    )
    monkeypatch.chdir(here)
    return here


@dataclass
class Problem:
    """A small linearised problem, as float64 arrays for the reference and in lanes."""

    grid: object
    unknowns: object
    camera: tisfm.Camera
    motion: np.ndarray  # (2, n, H, W)
    tensor: np.ndarray  # (6, H, W)
    constraints: np.ndarray  # (channels, 3, H, W)
    rho: np.ndarray  # (n, H, W)
    tensor_lanes: np.ndarray

    def to_lanes(self, images):
        """Lay (k, H, W) into lanes, halo columns included, the rest zero."""
        grid = self.grid
        out = grid.allocate(len(images))
        for lane in range(grid.lanes):
            for position in range(grid.strip_width + 2):
                x = lane * grid.strip_width + position - 1
                if 0 <= x < grid.width:
                    site = (slice(None), slice(1, -1), position)
                    out[site if grid.lanes == 1 else (*site, lane)] = images[:, :, x]
        return out

    def system(self, weights, *, alpha=1.0, stiffness=1.0):
        """Return the linear system of these weights of edges, (2n or 2, H, W)."""
        from tisfm.kernels.solve.linear_system import LinearSystem

        return LinearSystem(
            grid=self.grid,
            tensor=self.tensor_lanes,
            weights=self.to_lanes(weights),
            x_hat=self.unknowns.x_hat,
            y_hat=self.unknowns.y_hat,
            alpha=alpha,
            stiffness=np.broadcast_to(stiffness, len(self.rho)),
        )

    def from_lanes(self, array):
        """Read a lane array back as (k, H, W) by plain indexing."""
        grid = self.grid
        columns = [divmod(x, grid.strip_width) for x in range(grid.width)]
        inner = array if grid.lanes > 1 else array[..., None]
        return np.stack([inner[:, 1:-1, s + 1, lane] for lane, s in columns], axis=-1)


@pytest.fixture
def make_problem():
    """Build a random linearised problem of a given size, model and lane count."""

    def make(height, width, components, lanes, *, seed=0, focal=50.0, channels=1):
        from tisfm.kernels.layout.lanes import LaneGrid
        from tisfm.solver.unknowns import Unknowns

        rng = np.random.default_rng(seed)
        camera = tisfm.Camera(focal=focal, center=(0.4 * width, 0.6 * height))
        grid = LaneGrid(height, width, lanes)
        unknowns = Unknowns(grid, camera, components)
        size = (channels, height, width, 3)
        constraints = rng.normal(scale=(10, 10, 5), size=size).transpose(0, 3, 1, 2)
        constraints = constraints.astype(np.float32).astype(np.float64)
        tensor = reference.tensors_of([constraints])[0].astype(np.float32).astype(np.float64)
        rho = rng.normal(size=(components, height, width)).astype(np.float32).astype(np.float64)
        motion = reference.motion_matrix(camera, height, width, components)
        problem = Problem(grid, unknowns, camera, motion, tensor, constraints, rho, None)
        problem.tensor_lanes = problem.to_lanes(tensor)
        unknowns.rho[...] = problem.to_lanes(rho)
        return problem

    return make
