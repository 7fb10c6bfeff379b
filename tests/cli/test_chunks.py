"""`tisfm reconstruct` in chunks, by several processes, and after a kill."""

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.cli.command_line import TISFM, assert_one_line
from tests.cli.conftest import InThisProcess
from tests.reconstruction.chunked.filmed import COUNT, contents, film, in_turn, write_frames
from tests.waiting import PATIENCE, started, wait_for
from tisfm import Reconstruction
from tisfm.reconstruction.chunks import runs
from tisfm.running import pool
from tisfm.trajectory import read_kitti

CHUNKS = ("--preset", "fast", "--depth-of", "keyframes", "--chunk", "12")


@pytest.fixture
def frames(place):
    """The folder `film` with images."""
    return write_frames(place / "film", film().frames)


def command(*more, output="out"):
    return ("reconstruct", "film", "-o", output, "--focal", str(film().camera.focal), *more)


@pytest.fixture
def in_this_process(monkeypatch):
    """Let workers be this process; return what they were asked for."""
    asked = []

    class Here:
        def __init__(self, **options):
            asked.append(options)

        def __enter__(self):
            return self

        def __exit__(self, *about):
            pass

        def map_unordered(self, function, items):
            items = [item.__class__(**{**vars(item), "threads": None}) for item in items]
            return in_turn(function, items)

    monkeypatch.setattr(pool, "open_pool", Here)
    return asked


def test_the_folder_is_that_of_any_reconstruction(tisfm_run, frames, place, in_this_process):
    code, out, err = tisfm_run(*command(*CHUNKS, "--workers", "2"))
    assert code == 0 and out == ""
    assert err.startswith(f"{COUNT} of {COUNT} frames have a pose, in 1 piece")
    assert in_this_process == [{"workers": 2, "cluster": None}]
    assert len(read_kitti("out/poses.txt").poses) == len(Reconstruction.load("out")) == COUNT
    assert not [path for path in place.joinpath("out").iterdir() if path.name.startswith(".")]
    assert tisfm_run(*command(*CHUNKS, output="alone"))[0] == 0  # chunks, but one process
    assert contents(place / "out") == contents(place / "alone")
    cluster = ("--cluster", "tcp://127.0.0.1:8786")
    assert tisfm_run(*command(*CHUNKS, *cluster, output="there"))[0] == 0
    assert in_this_process[1:] == [{"workers": 1, "cluster": "tcp://127.0.0.1:8786"}]
    assert contents(place / "there") == contents(place / "alone")


def test_chunks_have_a_length_by_default(tisfm_run, frames, in_this_process):
    fast = ("--preset", "fast", "--depth-of", "none")
    assert tisfm_run(*command(*fast, "--workers", "2"))[0] == 0
    code, _, err = tisfm_run(*command(*fast, "--chunk", "150", "--resume"))
    assert code == 0 and "out is complete" in err


def test_nothing_is_left_to_do(tisfm_run, frames, place, monkeypatch):
    run = command(*CHUNKS[:4], "--scale", "0", "20", "2.5", "--ply")
    assert tisfm_run(*run, "--resume")[0] == 0  # there is nothing to go on with
    before = contents(place / "out")
    monkeypatch.setattr(runs, "reconstruct", None)
    code, _, err = tisfm_run(*run, "--resume")
    assert (code, err) == (0, "out is already complete. Results in out.\n")
    assert contents(place / "out") == before


@pytest.mark.parametrize(
    "names",
    [
        ["points.ply"],
        pytest.param(["poses.txt", "asked.json", "frames/000003.jpg"], marks=pytest.mark.nightly),
    ],
)
def test_an_incomplete_result_is_made_again(tisfm_run, frames, place, names):
    run = command(*CHUNKS[:4], "--ply", "--stop", "12")
    assert tisfm_run(*run)[0] == 0
    before = contents(place / "out")
    for name in names:
        (place / "out" / name).unlink()
        code, _, err = tisfm_run(*run, "--resume")
        assert code == 0 and "have a pose" in err, name
        assert contents(place / "out") == before, name


OTHER_OPTIONS = [
    (("--preset", "balanced"), "settings"),
    (("--chunk", "12"), "chunk was null, now 12"),
    (("--stop", "20"), "stop was null, now 20"),
    (("--size", "200"), "size was null, now 200"),
    (("--scale", "0", "8", "3"), "scale was null, now"),
    (("--mask", "mask.png"), "mask was null, now"),
]


def test_resume_refuses_other_options(tisfm_run, frames, place):
    fast = ("--preset", "fast", "--depth-of", "none")
    (place / "mask.png").write_bytes((frames / "f00.png").read_bytes())
    assert tisfm_run(*command(*fast))[0] == 0
    before = contents(place / "out")
    for options, text in OTHER_OPTIONS:
        code, _, err = tisfm_run(*command(*fast), *options, "--resume")
        assert_one_line(code, err, text, "without --resume")
        assert contents(place / "out") == before


def test_chunks_of_another_command_are_not_gone_on_with(tisfm_run, frames, place):
    """Neither at once, nor with other chunks."""
    (place / "out" / ".tisfm-chunks").mkdir(parents=True)
    assert tisfm_run(*command(*CHUNKS, output="whole"))[0] == 0
    asked = (place / "whole" / "asked.json").read_bytes()
    (place / "out" / ".tisfm-chunks" / "asked.json").write_bytes(asked)
    for options in (CHUNKS[:4], (*CHUNKS[:5], "13")):
        code, _, err = tisfm_run(*command(*options, "--resume"))
        assert_one_line(code, err, "chunk was 12, now")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--workers", "0"), "workers is 0: expected a positive number"),
        (("--workers", "2", "--cluster", "tcp://here:1"), "has workers of its own"),
        (("--chunk", "0"), "chunk is 0"),
        (("--chunk", "11"), "expected a number of frames, at least 12"),
        (("--workers", "2", "--motion", "objects"), "reconstruct it in one process"),
        (("--workers", "2", "--labels", "film"), "--labels and --object-sizes"),
        (("--chunk", "20", "--object-sizes", "1=2"), "--labels and --object-sizes"),
    ],
)
def test_what_cannot_be_made_in_chunks(tisfm_run, frames, place, options, text):
    code, _, err = tisfm_run(*command(*options))
    assert_one_line(code, err, text)
    assert not (place / "out").exists()


def test_a_camera_at_the_computer_has_no_chunks(tisfm_run, place):
    webcam = ("reconstruct", "webcam:0", "-o", "out")
    code, _, err = tisfm_run(*webcam, "--workers", "2")
    assert_one_line(code, err, "record the camera to a file first")
    code, _, err = tisfm_run(*webcam, "--resume")
    assert_one_line(code, err, "webcam:0 shows other frames now")
    assert not (place / "out").exists()


def begun(*arguments):
    """Start the command in a process of its own."""
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    return started([*TISFM, *arguments], stderr=pipe, stdout=nowhere, text=True)


class InterruptedAtTheThird(InThisProcess):
    """Finds the camera and makes a chunk; then somebody presses Ctrl-C."""

    def __init__(self):
        self.done = 0

    def submit(self, function, /, *arguments):
        self.done += 1
        if self.done == 3:
            raise KeyboardInterrupt
        return super().submit(function, *arguments)


def test_an_interrupted_command_goes_on_with_resume(
    quick_workers, tisfm_run, frames, place, monkeypatch
):
    arguments = command(*CHUNKS, "--workers", "2")
    with monkeypatch.context() as patch:
        patch.setattr(pool, "_local_executor", lambda workers: InterruptedAtTheThird())
        assert tisfm_run(*arguments)[0] == 130
    assert Path("out/.tisfm-chunks/000.json").exists()
    assert not Path("out/reconstruction.json").exists()
    assert tisfm_run(*arguments, "--resume")[0] == 0
    assert tisfm_run(*command(*CHUNKS, output="whole"))[0] == 0
    assert contents(place / "out") == contents(place / "whole")


@pytest.mark.nightly
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no such signal")
@pytest.mark.parametrize(("workers", "seen"), [("1", "001"), ("2", "000.json")])
def test_killed_and_given_again(tisfm_run, frames, place, workers, seen):
    """Whatever is there by then; the bytes are those of a run that nobody interrupted."""
    arguments = command(*CHUNKS, "--workers", workers)
    with begun(*arguments) as process:
        wait_for(Path("out/.tisfm-chunks", seen).exists, process)
        process.kill()
    assert not Path("out/reconstruction.json").exists()
    with begun(*arguments, "--resume") as process:
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert tisfm_run(*command(*CHUNKS, output="whole"))[0] == 0
    assert contents(place / "out") == contents(place / "whole")


@pytest.mark.nightly
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no such signal")
def test_a_cluster_whose_workers_are_killed(tisfm_run, frames, place, cluster):
    """Chunks of a worker that dies are made by others; a resumed one finds them."""
    shared = ("--cluster", cluster.scheduler_address)
    arguments = command(*CHUNKS, *shared)
    with begun(*arguments) as process:
        wait_for(Path("out/.tisfm-chunks/000").exists, process)
        killed = next(iter(cluster.workers.values())).pid
        os.kill(killed, signal.SIGKILL)
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert tisfm_run(*command(*CHUNKS, output="whole"))[0] == 0
    assert contents(place / "out") == contents(place / "whole")
    code, _, err = tisfm_run(*arguments, "--resume")
    assert code == 0 and "out is complete" in err
