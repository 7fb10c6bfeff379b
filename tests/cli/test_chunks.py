"""`tisfm reconstruct` in chunks, by several processes, and after a kill."""

import os
import shutil
import signal
import subprocess
from functools import cache
from pathlib import Path

import cv2
import pytest

from tests.cli.command_line import TISFM, assert_one_line
from tests.cli.conftest import InThisProcess
from tests.reconstruction.films import along
from tests.rendered import room_film
from tests.waiting import PATIENCE, started, wait_for
from tisfm import Reconstruction
from tisfm.cli.command_line import main
from tisfm.running import pool
from tisfm.trajectory import read_kitti

COUNT = 14  # frames: two chunks of at most 12
FAST = ("--preset", "fast", "--depth-of", "keyframes")
NO_DEPTH = ("--preset", "fast", "--depth-of", "none")
CHUNKS = (*FAST, "--chunk", "12")


@cache
def film():
    """Return a film of a slow steady camera."""
    return room_film(along(COUNT, (0.06, 0, 0.025, 0, 0.006, 0)), 120, 160, samples=1)


@pytest.fixture
def frames(work_folder):
    """The folder `film` with the frames of the film."""
    (work_folder / "film").mkdir()
    for k, frame in enumerate(film().frames):
        cv2.imwrite(str(work_folder / "film" / f"f{k:02d}.png"), frame)
    return work_folder / "film"


def command(*more, output="out"):
    return ("reconstruct", "film", "-o", output, "--focal", str(film().camera.focal), *more)


def contents(folder):
    """Return the files below a folder by name, without timings."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file() and path.name != "timings.csv"
    }


@pytest.fixture
def chunked(make_once, frames, work_folder):
    """The folder `whole`: the result of one process in chunks, without interruption."""

    def reconstruct(folder):
        assert main([*command(*CHUNKS, output=str(folder / "result"))]) == 0

    folder = make_once("chunked_reconstruction", reconstruct)
    shutil.copytree(folder / "result", work_folder / "whole")
    return work_folder / "whole"


def test_workers_write_the_same_folder_as_one_process(
    quick_workers, tisfm_run, frames, chunked, work_folder
):
    code, out, err = tisfm_run(*command(*CHUNKS, "--workers", "2"))
    assert code == 0 and out == ""
    assert err.startswith(f"{COUNT} of {COUNT} frames have a pose, in 1 piece")
    assert quick_workers in ([], [2])  # [] with processes
    assert len(read_kitti("out/poses.txt").poses) == len(Reconstruction.load("out")) == COUNT
    assert not [path for path in Path("out").iterdir() if path.name.startswith(".")]
    assert contents("out") == contents(chunked)


def test_workers_have_a_default_chunk_length(quick_workers, tisfm_run, frames):
    assert tisfm_run(*command(*NO_DEPTH, "--stop", "8", "--workers", "2"))[0] == 0
    code, _, err = tisfm_run(*command(*NO_DEPTH, "--stop", "8", "--chunk", "150", "--resume"))
    assert code == 0 and "is already complete" in err


OTHER_OPTIONS = [
    (("--preset", "balanced"), "settings"),
    (("--chunk", "12"), "chunk was null, now 12"),
    (("--stop", "7"), "stop was 8, now 7"),
    (("--size", "100"), "size was null, now 100"),
    (("--scale", "0", "7", "3"), "scale was [0, 5, 2.5], now"),
    (("--mask", "mask.png"), "mask was null, now"),
]


def test_resume_completes_a_result_and_refuses_other_options(tisfm_run, frames, work_folder):
    run = command(*FAST, "--stop", "8", "--scale", "0", "5", "2.5", "--ply")
    assert tisfm_run(*run, "--resume")[0] == 0  # no earlier result exists
    before = contents("out")
    shutil.copy(frames / "f00.png", "mask.png")
    for options, text in OTHER_OPTIONS:
        code, _, err = tisfm_run(*run, *options, "--resume")
        assert_one_line(code, err, text, "without --resume")
        assert contents("out") == before
    code, _, err = tisfm_run(*run, "--resume")  # a finished result is not computed again
    assert (code, err) == (0, "out is already complete. Results in out.\n")
    assert contents("out") == before
    Path("out/points.ply").unlink()
    code, _, err = tisfm_run(*run, "--resume")
    assert code == 0 and "have a pose" in err
    assert contents("out") == before


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["poses.txt", "asked.json", "frames/000003.jpg"])
def test_resume_restores_a_missing_file(tisfm_run, frames, work_folder, name):
    run = command(*FAST, "--stop", "8")
    assert tisfm_run(*run)[0] == 0
    before = contents("out")
    Path("out", name).unlink()
    code, _, err = tisfm_run(*run, "--resume")
    assert code == 0 and "have a pose" in err
    assert contents("out") == before


def test_chunks_of_another_command_are_refused(tisfm_run, frames, chunked, work_folder):
    """Chunks of 12 frames are continued neither without chunks, nor with chunks of 13."""
    Path("out/.tisfm-chunks").mkdir(parents=True)
    shutil.copy(chunked / "asked.json", "out/.tisfm-chunks/asked.json")
    for options in (FAST, (*FAST, "--chunk", "13")):
        code, _, err = tisfm_run(*command(*options, "--resume"))
        assert_one_line(code, err, "chunk was 12, now")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--workers", "0"), "workers is 0: expected a positive number"),
        (("--workers", "2", "--cluster", "tcp://here:1"), "has workers of its own"),
        (("--chunk", "0"), "chunk is 0"),
        (("--chunk", "11"), "expected a number of frames, at least 12"),
        (("--workers", "2", "--labels", "film"), "do not work in chunks"),
        (("--chunk", "20", "--object-sizes", "1=2"), "do not work in chunks"),
    ],
)
def test_impossible_options_of_chunks_are_refused(tisfm_run, frames, work_folder, options, text):
    code, _, err = tisfm_run(*command(*options))
    assert_one_line(code, err, text)
    assert not (work_folder / "out").exists()


def test_a_cluster_that_does_not_answer_is_named(tisfm_run, frames):
    pytest.importorskip("distributed")
    code, _, err = tisfm_run(*command(*NO_DEPTH, "--cluster", "nonsense"))
    assert_one_line(code, err, "the cluster nonsense does not answer")


def test_a_webcam_has_no_chunks(tisfm_run, work_folder):
    webcam = ("reconstruct", "webcam:0", "-o", "out")
    code, _, err = tisfm_run(*webcam, "--workers", "2")
    assert_one_line(code, err, "record it to a file first")
    code, _, err = tisfm_run(*webcam, "--resume")
    assert_one_line(code, err, "webcam:0 shows other frames now")
    assert not (work_folder / "out").exists()


def start_process(*arguments):
    """Start the command in a process of its own."""
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    return started([*TISFM, *arguments], stderr=pipe, stdout=nowhere, text=True)


class InterruptedAtTheThirdItem(InThisProcess):
    """Computes the camera and a chunk; then Ctrl-C comes."""

    def __init__(self):
        self.done = 0

    def submit(self, function, /, *arguments):
        self.done += 1
        if self.done == 3:
            raise KeyboardInterrupt
        return super().submit(function, *arguments)


@pytest.mark.nightly  # tests/reconstruction/chunked/test_resume.py has a kill
def test_an_interrupted_command_is_resumed(
    quick_workers, tisfm_run, frames, chunked, work_folder, monkeypatch
):
    arguments = command(*CHUNKS, "--workers", "2")
    with monkeypatch.context() as patch:
        patch.setattr(pool, "_local_executor", lambda workers: InterruptedAtTheThirdItem())
        assert tisfm_run(*arguments)[0] == 130
    assert Path("out/.tisfm-chunks/000.json").exists()
    assert not Path("out/reconstruction.json").exists()
    assert tisfm_run(*arguments, "--resume")[0] == 0
    assert contents("out") == contents(chunked)


@pytest.mark.nightly
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no such signal")
@pytest.mark.parametrize(("workers", "file"), [("1", "001"), ("2", "000.json")])
def test_a_killed_command_is_resumed(tisfm_run, frames, chunked, work_folder, workers, file):
    """The command is killed once a file is there."""
    arguments = command(*CHUNKS, "--workers", workers)
    with start_process(*arguments) as process:
        wait_for(Path("out/.tisfm-chunks", file).exists, process)
        process.kill()
    assert not Path("out/reconstruction.json").exists()
    with start_process(*arguments, "--resume") as process:
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert contents("out") == contents(chunked)


@pytest.mark.nightly
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no such signal")
def test_chunks_of_a_killed_cluster_worker_are_computed_again(
    tisfm_run, frames, chunked, work_folder, cluster
):
    arguments = command(*CHUNKS, "--cluster", cluster.scheduler_address)
    with start_process(*arguments) as process:
        wait_for(Path("out/.tisfm-chunks/000").exists, process)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert contents("out") == contents(chunked)
    code, _, err = tisfm_run(*arguments, "--resume")
    assert code == 0 and "is already complete" in err
