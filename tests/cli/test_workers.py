"""`tisfm run --workers` and `--cluster`: several processes share the pairs of a run."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.command_line import TISFM, H, W, assert_one_line, files, make_frames, record
from tests.draws import nightly_except
from tests.waiting import PATIENCE, started, wait_for
from tisfm.camera import Camera
from tisfm.formats import write_png
from tisfm.running.pair_chunks import Chunk, interpret_chunk, split_chunk
from tisfm.running.pair_files import DEFAULT_OUTPUTS, PairFiles
from tisfm.running.pairs import FrameSelection, PairSource, PairWork
from tisfm.settings import Settings
from tisfm.sources import Listing

RUN = ("run", "film", "--preset", "fast")
QUIET = ("--no-figures",)
COUNT = 12


@pytest.fixture
def film(work_folder):
    """A folder of frames."""
    (work_folder / "film").mkdir()
    for k, frame in enumerate(make_frames(COUNT, seed=5)):
        write_png(work_folder / f"film/f{k:02d}.png", frame)
    return work_folder / "film"


def files_of(folder):
    """Return the files of a run without timings; check that no temporary file is left."""
    found = files(folder)
    assert not [name for name in found if name.startswith(".")]
    return found


def assert_same_as_one_process(tisfm_run, *options, source="film", shared=("--workers", "2")):
    """Check that several processes write the same files as one process; return them."""
    command = ("run", source, "--preset", "fast", *options)
    code, _, said = tisfm_run(*command, "-o", "one")
    assert code == 0, said
    code, _, also = tisfm_run(*command, *shared, "-o", "many")
    assert code == 0, also
    assert files_of("many") == files_of("one")
    times = re.compile(r", \d+\.\d+ s each \(median\)")
    assert times.sub("", also).replace("many", "one") == times.sub("", said)
    return files_of("one")


def test_two_workers_write_the_same_files_as_one_process(quick_workers, tisfm_run, film):
    found = assert_same_as_one_process(tisfm_run, "--figures", "4")
    assert len([name for name in found if name.endswith("_figure.png")]) == 3
    assert [pair["number"] for pair in record("many")["pairs"].values()] == list(range(COUNT - 1))


def test_workers_take_steps_and_masks(quick_workers, tisfm_run, film, work_folder):
    (work_folder / "masks").mkdir()
    for k in range(COUNT):
        mask = np.full((H, W), 255, np.uint8)
        mask[-4:, : W // 2 + k] = 0
        write_png(work_folder / f"masks/f{k:02d}.png", mask)
    options = ("--step", "2", "--start", "1", "--mask", "masks", *QUIET)
    found = assert_same_as_one_process(tisfm_run, *options)
    assert {name for name in found if name.endswith(".npz")} == {
        f"f{k:02d}.npz" for k in (1, 3, 5, 7, 9)
    }


@pytest.mark.parametrize("options", nightly_except(QUIET, of=[QUIET, ("--figures", "3")]))
def test_workers_skip_damaged_frames(quick_workers, tisfm_run, film, options):
    for name in ("f00", "f05", "f06"):
        data = Path(f"film/{name}.png").read_bytes()
        Path(f"film/{name}.png").write_bytes(data[: len(data) // 2])
    found = assert_same_as_one_process(tisfm_run, "--bad-frames", "skip", *options)
    assert "f04.npz" in found and "f05.npz" not in found


def make_clip():
    """Write a video of nine frames."""
    writer = cv2.VideoWriter("clip.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write MJPG video")
    for frame in make_frames(9):
        writer.write(cv2.resize(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), (64, 48)))
    writer.release()


def test_workers_share_a_video(quick_workers, tisfm_run, work_folder):
    make_clip()
    assert_same_as_one_process(tisfm_run, *QUIET, source="clip.avi", shared=("--workers", "3"))


@pytest.mark.parametrize("said", nightly_except(2, 11, of=[2, 5, 9, 11]))
def test_workers_share_a_video_with_a_wrong_frame_count(
    quick_workers, tisfm_run, work_folder, said
):
    make_clip()
    data = bytearray(Path("clip.avi").read_bytes())
    for name, offset in ((b"avih", 24), (b"strh", 40)):  # where each has the number
        at = data.index(name) + offset
        assert int.from_bytes(data[at : at + 4], "little") == 9
        data[at : at + 4] = said.to_bytes(4, "little")
    Path("clip.avi").write_bytes(data)
    assert_same_as_one_process(tisfm_run, *QUIET, source="clip.avi")
    assert len(record("many")["pairs"]) == 8


def test_frames_with_decimals_are_not_shared(quick_workers, tisfm_run, work_folder):
    (work_folder / "film").mkdir()
    for k, frame in enumerate(make_frames(3)):
        assert cv2.imwrite(f"film/f{k}.tiff", frame.astype(np.float32) / 300)
    code, _, err = tisfm_run(*RUN, *QUIET, "-o", "out", "--workers", "2")
    assert_one_line(code, err, "frame f0 has decimals")


def test_a_run_is_resumed_with_workers_and_without(quick_workers, tisfm_run, film):
    whole = assert_same_as_one_process(tisfm_run, *QUIET)
    for name in ("f03_depth.png", "f07.npz"):
        Path(f"many/{name}").unlink()
    assert tisfm_run(*RUN, *QUIET, "-o", "many", "--workers", "2", "--resume")[0] == 0
    assert files_of("many") == whole
    Path("many/f05.npz").write_bytes(b"")
    assert tisfm_run(*RUN, *QUIET, "-o", "many", "--resume")[0] == 0
    assert files_of("many") == whole


def test_an_error_in_a_worker_is_one_line(quick_workers, tisfm_run, film):
    write_png("film/f09.png", np.zeros((H, W + 3), np.uint8))
    code, _, err = tisfm_run(*RUN, *QUIET, "-o", "out", "--workers", "2")
    assert_one_line(code, err, "f08", "f09", "must have the same size")
    assert "f00" in record("out")["pairs"] and "f08" not in record("out")["pairs"]


# Errors


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--workers", "0"), "workers is 0"),
        (("--workers", "2", "--cluster", "tcp://127.0.0.1:1"), "give one of them"),
        (("--workers", "2", "--window", "3"), "several workers cannot share the pairs"),
        (("--cluster", "nonsense"), "the cluster nonsense does not answer"),
        pytest.param(  # Dask tries for 10 s
            ("--cluster", "tcp://127.0.0.1:1"),
            "the cluster tcp://127.0.0.1:1 does not answer",
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_options_that_workers_cannot_share(tisfm_run, film, options, words):
    pytest.importorskip("distributed")
    code, _, err = tisfm_run(*RUN, *QUIET, "-o", "out", *options)
    assert_one_line(code, err, words)


def test_a_cluster_needs_dask(tisfm_run, film, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, _, err = tisfm_run(*RUN, *QUIET, "-o", "out", "--cluster", "tcp://127.0.0.1:1")
    assert_one_line(code, err, "pip install 'tisfm[cluster]'")


def make_chunk(folder, **changes):
    files_ = PairFiles(folder=folder, outputs=DEFAULT_OUTPUTS, figures=0, has_pose=False)
    settings = Settings.preset("fast")
    about = dict(
        source=PairSource(source="film", frames=FrameSelection(), settings=settings),
        work=PairWork(camera=Camera(600.0), settings=settings, files=files_),
        first=1,
        end=COUNT - 1,
        arch=None,
        threads=None,
        listing=Listing.from_files([Path(f"f{k:02d}.png") for k in range(COUNT)]),
        presence=folder / "alive",
    )
    return Chunk(**{**about, **changes})


def test_a_worker_of_another_version_is_an_error(film, work_folder):
    (work_folder / "alive").touch()
    error = interpret_chunk(make_chunk(work_folder, version="0.0.7")).error
    assert isinstance(error, RuntimeError) and "the command has 0.0.7" in str(error)


def test_a_worker_without_the_folder_is_an_error(film, work_folder):
    error = interpret_chunk(make_chunk(work_folder)).error
    assert isinstance(error, RuntimeError) and "does not see the folder" in str(error)


def test_a_worker_with_other_vectors_is_an_error(film, work_folder):
    (work_folder / "alive").touch()
    error = interpret_chunk(make_chunk(work_folder, lanes=4)).error
    assert isinstance(error, RuntimeError) and "processor of the command 4" in str(error)


@pytest.mark.parametrize("first", [1, COUNT - 2])
def test_a_worker_with_other_files_is_an_error(film, work_folder, first):
    (work_folder / "alive").touch()
    (film / "f00.png").rename(film / "f0.png")
    error = interpret_chunk(make_chunk(work_folder, first=first)).error
    assert isinstance(error, RuntimeError) and "sees other files in film (12)" in str(error)
    (film / "f0.png").unlink()
    error = interpret_chunk(make_chunk(work_folder, first=first)).error
    assert isinstance(error, RuntimeError) and "(11) than the first process (12)" in str(error)


def test_a_bug_in_a_worker_is_raised(film, work_folder, monkeypatch):
    (work_folder / "alive").touch()
    monkeypatch.setattr(PairWork, "interpret", lambda *arguments: np.zeros(3) + np.zeros(4))
    with pytest.raises(ValueError, match="broadcast"):
        interpret_chunk(make_chunk(work_folder))


def test_a_worker_stops_when_its_run_has_ended(film, work_folder, monkeypatch):
    (work_folder / "alive").touch()
    original = PairWork.interpret

    def last(self, pair, window=None):
        (work_folder / "alive").unlink()
        return original(self, pair, window)

    monkeypatch.setattr(PairWork, "interpret", last)
    done = interpret_chunk(make_chunk(work_folder))
    assert [pair.name for pair in done.pairs] == ["f01"]
    assert not [t for t in threading.enumerate() if t.name.startswith("tisfm-frames")]


@pytest.mark.parametrize(("count", "workers"), [(1, 4), (7, 2), (1000, 3)])
def test_chunks_cover_all_pairs(count, workers, work_folder):
    parts = split_chunk(make_chunk(work_folder, first=1, end=1 + count), workers)
    assert [part.first for part in parts[1:]] == [part.end for part in parts[:-1]]
    assert parts[0].first == 1 and parts[-1].first < 1 + count
    assert parts[-1].end > 10**9  # a video may have more frames than it says
    assert max(part.end - part.first for part in parts[:-1] or [parts[0]]) <= 32 or count == 1
    assert len(parts) >= min(count, workers)


# Workers in processes of their own


def start_process(*options):
    """Start the command in a process of its own."""
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    return started([*TISFM, *options], stderr=pipe, stdout=nowhere, text=True)


# Workers import this file. Each waits at its first pair while the file "hold" exists.
WAITING_WORKERS = """
import os
import sys
import time
from pathlib import Path
from tisfm.cli.command_line import main
from tisfm.running.pairs import PairWork

interpret = PairWork.interpret

def wait_and_interpret(self, pair, window=None):
    Path(f"waiting-{os.getpid()}").touch()
    while Path("hold").exists():
        time.sleep(0.02)
    if Path("refuse").exists():
        raise OSError("the pair is refused")
    return interpret(self, pair, window)

if __name__ == "__main__":
    sys.exit(main())
PairWork.interpret = wait_and_interpret
"""


@contextmanager
def waiting_worker():
    """Resume a run with two workers, one of which waits at the pair that is missing; give both."""
    shutil.copytree("one", "many")
    Path("many/f06.npz").unlink()
    Path("script.py").write_text(WAITING_WORKERS)
    Path("hold").touch()
    command = [sys.executable, "script.py", *RUN, *QUIET, "-o", "many", "--workers", "2"]
    with started([*command, "--resume"], stderr=subprocess.PIPE, text=True) as process:
        wait_for(lambda: list(Path().glob("waiting-*")), process)
        (file,) = Path().glob("waiting-*")
        yield process, int(file.name.partition("-")[2])


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


on_linux = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="there is no /proc")


@pytest.mark.nightly  # tests/running/test_pool.py kills a process of a pool
@on_linux
def test_killed_worker_is_replaced(tisfm_run, film):
    assert tisfm_run(*RUN, *QUIET, "-o", "one")[0] == 0
    with waiting_worker() as (process, worker):
        os.kill(worker, signal.SIGKILL)
        Path("hold").unlink()
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert files_of("many") == files_of("one")


@on_linux
@pytest.mark.parametrize("sent", nightly_except(signal.SIGINT, of=[signal.SIGINT, signal.SIGKILL]))
def test_workers_end_with_the_run(tisfm_run, film, sent):
    assert tisfm_run(*RUN, *QUIET, "-o", "one")[0] == 0
    with waiting_worker() as (process, worker):
        Path("refuse").touch()
        process.send_signal(sent)
        if sent == signal.SIGINT:  # the run waits for its workers
            Path("hold").unlink()
        _, said = process.communicate(timeout=PATIENCE)
    if sent == signal.SIGINT:
        assert process.returncode == 130 and said.splitlines()[-1] == "tisfm: interrupted"
        assert not is_running(worker)
        assert not [path for path in Path("many").iterdir() if path.name.startswith(".tisfm-")]
    wait_for(lambda: not is_running(worker))
    assert tisfm_run(*RUN, *QUIET, "-o", "many", "--resume")[0] == 0
    assert files_of("many") == files_of("one")


# A cluster


def test_a_cluster_writes_the_same_files_as_one_process(quick_workers, tisfm_run, film):
    """Its worker is a thread of this process, which has loaded the kernels."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp",
        dashboard_address=":0", local_directory="dask", silence_logs=50,
    ) as cluster:  # fmt: skip
        assert_same_as_one_process(
            tisfm_run, *QUIET, shared=("--cluster", cluster.scheduler_address)
        )


@pytest.mark.nightly
@on_linux
def test_killed_cluster_worker_is_replaced(tisfm_run, film, cluster):
    assert_same_as_one_process(
        tisfm_run, "--figures", "4", shared=("--cluster", cluster.scheduler_address)
    )
    with start_process(*RUN, "-o", "killed", "--cluster", cluster.scheduler_address) as process:
        wait_for(lambda: list(Path("killed").glob("*.npz")), process)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert tisfm_run(*RUN, "-o", "whole")[0] == 0
    assert files_of("killed") == files_of("whole")
