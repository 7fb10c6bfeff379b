"""Runs that are killed, cut short by the disk, damaged, or not alone."""

import csv
import json
import os
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.command_line import ENDINGS, TISFM, assert_one_line, files, load, record
from tests.draws import nightly_except
from tests.waiting import started, wait_for
from tisfm.folders.files import compare_records
from tisfm.folders.result_folder import LOCK, FolderInUseError, locked_folder
from tisfm.formats import write_png

QUIET = ("run", "frames", "-o", "out", "--no-figures")
MANY = 24


DAMAGES = ("removed", "emptied", "cut off", "flipped")


@pytest.mark.parametrize("shift", nightly_except(0, of=range(len(DAMAGES))))
def test_resume_restores_damaged_files(tisfm_run, frames, shift):
    """Each kind of file has another damage; all pairs of both in the nightly command."""
    assert tisfm_run(*QUIET)[0] == 0
    before = files("out")
    for number, ending in enumerate(sorted(ENDINGS - {"_figure.png"})):
        damage = DAMAGES[(number + shift) % len(DAMAGES)]
        path = Path(f"out/f1{ending}")
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 4
        if damage == "removed":
            path.unlink()
        else:
            path.write_bytes({"emptied": b"", "cut off": data[:-1], "flipped": data}[damage])
        assert tisfm_run(*QUIET, "--resume")[0] == 0
        assert files("out") == before, (ending, damage)


def test_files_left_by_killed_runs_are_removed(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    before = files("out")
    for name in (".tisfm-0123456789abcdef.tmp", LOCK):
        Path("out", name).write_bytes(b"half")
    assert tisfm_run(*QUIET, "--resume")[0] == 0
    assert files("out") == before


def test_two_runs_in_a_folder_refuse_each_other(tisfm_run, frames):
    Path("out").mkdir()
    with locked_folder("out"):
        for more in ((), ("--resume",)):
            code, _, err = tisfm_run(*QUIET, *more)
            assert_one_line(code, err, "another run writes to out", "another folder with -o")
        with pytest.raises(FolderInUseError), locked_folder("out"):
            pass
        assert set(os.listdir("out")) == {LOCK}
    assert os.listdir("out") == []
    assert tisfm_run(*QUIET)[0] == 0


def test_resume_names_the_options_that_differ(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    code, _, err = tisfm_run(*QUIET, "--resume", "--beta", "0.5", "--focal", "50")
    assert_one_line(code, err, "camera.focal was 600.0, now 50.0; settings.beta was ")
    changed = record("out") | {"version": "0.0.1"}
    Path("out/run.json").write_text(json.dumps(changed))
    code, _, err = tisfm_run(*QUIET, "--resume")
    assert_one_line(code, err, 'version was "0.0.1", now ')


def test_values_missing_in_one_record_differ():
    assert list(compare_records({"a": 1}, {"a": 1, "b": {"c": 2}})) == ['b was null, now {"c": 2}']
    assert list(compare_records({"a": {"b": 1}}, {"a": {}})) == ["a.b was 1, now null"]


DAMAGED_PAIRS = [
    {"../f0": {}}, {"f0": {}}, {"f0": 3}, [], {"f0": {"frames": "", "status": 1}}, "f0",
    {"../f0": {"frames": "", "status": "", "message": "", "files": {}}},
    {"f0": {"frames": "", "status": "", "message": "", "files": {".npz": [1]}}},
]  # fmt: skip


def test_a_damaged_record_is_one_line(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    about = record("out")
    for pairs in DAMAGED_PAIRS:
        Path("out/run.json").write_text(json.dumps(about | {"pairs": pairs}))
        code, _, err = tisfm_run(*QUIET, "--resume")
        assert_one_line(code, err, "run.json is damaged", "run without --resume")


def test_files_of_an_earlier_run_are_removed(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    Path("out/note.txt").write_text("mine")
    assert tisfm_run(*QUIET, "--step", "2", "--outputs", "flow")[0] == 0
    assert set(files("out")) == {"f0_flow.flo", "run.json", "run.csv", "note.txt"}


def test_files_of_others_are_kept(tisfm_run, frames):
    assert tisfm_run(*QUIET, "--outputs", "flow")[0] == 0
    for name in ("f0.ply", "f1_depth.png"):
        Path("out", name).write_text("mine")
    assert tisfm_run(*QUIET, "--outputs", "npz")[0] == 0
    assert set(files("out")) == {
        *(f"f{k}.npz" for k in range(3)), "f0.ply", "f1_depth.png", "run.json", "run.csv"
    }  # fmt: skip


def test_a_mask_among_the_results_is_refused_before_files_are_removed(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    before = files("out")
    options = ("run", "frames", "-o", "out", "--step", "2", "--mask", "out/f2_depth.png")
    code, _, err = tisfm_run(*options)
    assert_one_line(code, err, "would replace the input")
    assert files("out") == before


def test_a_run_that_is_killed_while_it_removes_an_earlier_one(tisfm_run, frames, monkeypatch):
    assert tisfm_run(*QUIET)[0] == 0
    other = (*QUIET, "--outputs", "flow,npz")
    removed, original = [], Path.unlink

    def unlink(path, missing_ok=False):
        removed.append(path)
        if len(removed) == 6:
            raise KeyboardInterrupt
        original(path, missing_ok=missing_ok)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", unlink)
        assert tisfm_run(*other)[0] == 130
    assert tisfm_run(*other)[0] == 0
    assert tisfm_run(*other, "-o", "whole")[0] == 0
    assert files("out") == files("whole")


def test_a_run_is_resumed_with_more_frames(tisfm_run, frames):
    assert tisfm_run(*QUIET, "--stop", "3")[0] == 0
    assert tisfm_run(*QUIET, "--resume")[0] == 0
    assert tisfm_run("run", "frames", "-o", "whole", "--no-figures")[0] == 0
    assert files("out") == files("whole")


def test_resume_restores_the_table(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    before = files("out")
    Path("out/run.csv").write_text("")
    assert tisfm_run(*QUIET, "--resume")[0] == 0
    assert files("out") == before


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_a_pipe_in_place_of_a_file_is_replaced(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    Path("out/f1_depth.png").unlink()
    os.mkfifo("out/f1_depth.png")
    code, _, err = tisfm_run(*QUIET, "--resume")
    assert_one_line(code, err, "cannot write out/f1_depth.png", "a device or a pipe")


WRONG_VALUES = [
    {"status": []}, {"status": None}, {"times": 3}, {"twists": 3}, {"times": ["a", 1]},
    {"files": {"/../../x": [1, 2]}}, {"files": {"_flow.flo\0": [1, 2]}},
]  # fmt: skip


def test_a_record_with_wrong_values_is_one_line(tisfm_run, frames):
    assert tisfm_run(*QUIET)[0] == 0
    for change in WRONG_VALUES:
        about = record("out")
        about["pairs"]["f0"] |= change
        Path("out/run.json").write_text(json.dumps(about))
        code, _, err = tisfm_run(*QUIET, "--resume")
        assert_one_line(code, err, "run.json is damaged", "run without --resume")
        assert tisfm_run(*QUIET)[0] == 0


def test_outputs_are_chosen(tisfm_run, frames):
    options = ("run", "frames", "-o", "out", "--preset", "fast", "--outputs")
    assert tisfm_run(*options, "depth, npz,figure", "--figures", "2", "--ply")[0] == 0
    some = {f"f{k}{end}" for k in range(3) for end in ("_depth.png", ".npz", ".ply")}
    assert set(files("out")) == some | {
        "f0_figure.png", "f2_figure.png", "run.json", "run.csv"
    }  # fmt: skip
    assert record("out")["outputs"] == ["depth", "figure", "ply", "npz"]
    before = files("out")
    Path("out/f2_figure.png").unlink()
    again = ("depth,npz,figure", "--figures", "2", "--ply", "--resume")
    assert tisfm_run(*options, *again)[0] == 0
    assert files("out") == before
    for wrong in ("depth,color", "", ","):
        code, _, err = tisfm_run(*options, wrong)
        assert_one_line(code, err, "--outputs ", "expected", "depth16", "flow")
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--figures", "-1")
    assert_one_line(code, err, "figures is -1")


def test_the_table_has_a_row_for_each_pair(tisfm_run, frames):
    options = ("--motion", "camera", "--focal", "50")
    assert tisfm_run(*QUIET, *options)[0] == 0
    with open("out/run.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["pair"] for row in rows] == ["f0", "f1", "f2"]
    for row in rows:
        result = load("out", row["pair"])
        assert (row["status"], row["message"]) == (str(result.status), result.status.message)
        speed = np.linalg.norm(result.flow.astype(float), axis=-1).mean()
        assert float(row["speed"]) == pytest.approx(speed, rel=1e-5)
        twist = [float(row[key]) for key in ("tx", "ty", "tz", "rx", "ry", "rz")]
        np.testing.assert_allclose(twist, result.motions[0])
        assert row["time0"] == ""
    with open("out/timings.csv", newline="", encoding="utf-8") as file:
        assert all(float(row["seconds"]) > 0 for row in csv.DictReader(file))


def test_resume_with_a_window_of_three_needs_npz_files(tisfm_run, frames):
    code, _, err = tisfm_run(*QUIET, "--window", "3", "--resume", "--outputs", "flow")
    assert_one_line(code, err, "add npz to --outputs")


@pytest.mark.skipif(os.name == "nt", reason="names of files there are Unicode")
def test_file_names_that_are_not_unicode(tisfm_run, frames):
    try:
        for k in range(4):
            (frames / f"f{k}.png").rename(frames / f"f\udcff{k}.png")
    except OSError:
        pytest.skip("this file system takes no such names")
    for more in ((), ("--resume",)):
        assert tisfm_run("run", "frames", "-o", "out", "--figures", "5", *more)[0] == 0
    assert list(record("out")["pairs"]) == [f"f\udcff{k}" for k in range(3)]
    assert Path("out/f\udcff0_figure.png").exists()


def test_a_full_disk_names_the_file(tisfm_run, frames):
    """On a file system of 64 kB, where one may be mounted."""
    Path("small").mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", "small"], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("no file system can be mounted here")
    try:
        options = ("run", "frames", "-o", "small", "--no-figures")
        code, _, err = tisfm_run(*options)
        *before_it, last = err.splitlines(keepends=True)
        assert_one_line(code, last, "cannot write small/", "No space left on device")
        assert all("for 3 pairs, but" in line for line in before_it)
        assert not [name for name in os.listdir("small") if name.startswith(".")]
        subprocess.run(["mount", "-o", "remount,size=8m", "small"], check=True)
        assert tisfm_run(*options, "--resume")[0] == 0
        assert tisfm_run("run", "frames", "-o", "whole", "--no-figures")[0] == 0
        assert files("small") == files("whole")
    finally:
        subprocess.run(["umount", "small"], check=True)


def killed(command, folder, more):
    """Start a command, and kill it once it has left so many more files in a folder."""
    there = len(os.listdir(folder)) if os.path.isdir(folder) else 0
    with started(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        wait_for(
            lambda: (
                process.poll() is not None
                or (os.path.isdir(folder) and len(os.listdir(folder)) >= there + more)
            )
        )
        process.kill()
    return process.returncode


@pytest.mark.parametrize(
    ("more", "most_kills"),
    [
        ((), 1),
        pytest.param((), 5, marks=pytest.mark.nightly),
        pytest.param(("--window", "3", "--figures", "5"), 5, marks=pytest.mark.nightly),
    ],
)
def test_runs_that_are_killed_end_in_the_same_bytes(work_folder, tisfm_run, more, most_kills):
    noise = np.random.default_rng(0).integers(0, 256, (120, 200), dtype=np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 1.5)
    os.mkdir("many")
    for k in range(MANY):
        write_png(f"many/f{k:02d}.png", texture[:, MANY - k : 160 - k])
    options = ("run", "many", "--preset", "fast", *(more or ("--no-figures",)))
    assert tisfm_run(*options, "-o", "whole")[0] == 0
    random, kills = np.random.default_rng(7), 0
    command = [*TISFM, *options, "-o", "out", "--resume"]
    for _ in range(most_kills):
        kills += killed(command, "out", random.integers(1, MANY // 2)) != 0
    assert kills > 0
    assert tisfm_run(*options, "-o", "out", "--resume")[0] == 0
    assert files("out") == files("whole")


@pytest.mark.parametrize("outputs", ["figure", "pose"])
def test_pairs_without_a_file_of_their_own_are_complete(tisfm_run, frames, outputs):
    run = ("run", "frames", "-o", "out", "--outputs", outputs, "--figures", "2")
    assert tisfm_run(*run)[0] == 0
    before = files("out")
    Path("out/f1.ply").write_text("mine")
    assert tisfm_run(*run, "--resume")[0] == 0
    assert tisfm_run(*run)[0] == 0
    assert files("out") == before | {"f1.ply": b"mine"}
