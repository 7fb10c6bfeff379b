"""Fixtures of the tests of the command line."""

import pickle
import time
from concurrent.futures import Executor, Future
from types import SimpleNamespace

import numpy as np
import pytest

from tests.cli.command_line import FRAMES, H, W
from tisfm import runtime
from tisfm.cli import console, progress
from tisfm.cli.command_line import main
from tisfm.formats import write_flo, write_png
from tisfm.running import pool


@pytest.fixture(autouse=True)
def work_folder(tmp_path, monkeypatch):
    """An empty working folder, and the width of a terminal; standard error is not a terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):  # rich takes a pipe for one
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.fixture(autouse=True)
def no_time_passes_for_forecasts(monkeypatch):
    """On a busy machine a run of a few pairs would print an estimate of its time."""
    monkeypatch.setattr(
        progress, "time", SimpleNamespace(monotonic=lambda: 0.0, perf_counter=time.perf_counter)
    )


class InThisProcess(Executor):
    """Computes each item at once in this process, from a copy as another process gets it."""

    def submit(self, function, /, *arguments):
        done = Future()
        try:
            done.set_result(function(*pickle.loads(pickle.dumps(arguments))))
        except BaseException as error:
            done.set_exception(error)
        return done


@pytest.fixture(params=["here", pytest.param("processes", marks=pytest.mark.nightly)])
def quick_workers(request, monkeypatch):
    """Workers: this process in the short command, processes of their own in the nightly one.

    The value lists the number of workers of each pool that was opened in this process.
    """
    pools = []

    def open_executor(workers):
        pools.append(workers)
        return InThisProcess()

    if request.param == "here":
        runtime.start()  # with all threads, before a piece starts it with its share
        monkeypatch.setattr(pool, "_local_executor", open_executor)
    return pools


@pytest.fixture
def without_vulkan(monkeypatch):
    """A machine without a Vulkan driver: with one, commands print its device."""
    monkeypatch.setattr(console, "vulkan_device", lambda: None)


@pytest.fixture
def frames(work_folder):
    """A folder of four frames f0.png to f3.png."""
    folder = work_folder / "frames"
    folder.mkdir()
    for k, frame in enumerate(FRAMES):
        write_png(folder / f"f{k}.png", frame)
    return folder


@pytest.fixture
def benchmark_folder(work_folder):
    """Two pairs in the layout of Middlebury, with the motion that `make_frames` gives them."""
    folder = work_folder / "flows"
    for k, name in enumerate(("Slow", "Fast")):
        (folder / name).mkdir(parents=True)
        write_png(folder / name / "frame10.png", FRAMES[k])
        write_png(folder / name / "frame11.png", FRAMES[k + 1])
        write_flo(folder / name / "flow10.flo", np.full((H, W, 2), (k + 1.0, 0.0)))
    return folder


@pytest.fixture
def sequence_folder(work_folder):
    """A sequence in the layout of New Tsukuba, whose camera moves to the left."""
    folder = work_folder / "walk"
    folder.mkdir()
    for k, frame in enumerate(FRAMES):
        write_png(folder / f"rgb_{k:05d}.png", frame)
    rows = [f"1 0 0 {-k} 0 1 0 0 0 0 1 0" for k in range(len(FRAMES))]
    (folder / "poses_camera_to_world_3x4_cm.txt").write_text("\n".join(rows))
    return folder


@pytest.fixture
def tisfm_run(capsys):
    """Run the command line in this process; return exit code, stdout and stderr."""

    def run(*arguments):
        capsys.readouterr()  # of commands that fixtures ran
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:  # of help and of options that do not exist
            code = end.code
        return code, *capsys.readouterr()

    return run


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two processes, of one thread each, under a scheduler."""
    distributed = pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("cluster")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        dashboard_address=":0",
        local_directory=str(folder),
        silence_logs=50,
    ) as made:
        yield made
