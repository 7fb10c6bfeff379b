"""`tisfm eval --sequence`."""

import json
from pathlib import Path

import numpy as np
import pytest

import tisfm
from tests.cli.command_line import assert_one_line
from tests.evaluation.reconstructed import PATH, N, Result, make_sequence
from tisfm.cli import progress
from tisfm.settings import Settings
from tisfm.trajectory import read_tum, write_kitti, write_tum


@pytest.fixture
def wall(work_folder):
    """A sequence with poses and depth."""
    make_sequence(work_folder / "wall")
    return work_folder / "wall"


@pytest.fixture
def reconstruct(monkeypatch):
    """What `tisfm.reconstruct` was asked; it finds all but frame 2, in a unit of its own."""
    asked = []

    def found(source, **options):
        asked.append((source, options))
        return Result(unit=0.5 if options["poses"] is None else 1).drop(2)

    monkeypatch.setattr(tisfm, "reconstruct", found, raising=False)
    return asked


def evaluated(folder):
    return json.loads((Path(folder) / "eval.json").read_text(encoding="utf-8"))


def test_a_sequence_is_reconstructed_and_compared(tisfm_run, wall, reconstruct):
    options = ["--preset", "fast", "--warps", "2", "-o", "out"]
    code, out, err = tisfm_run("eval", "wall", "--sequence", *options)
    assert code == 0 and err == "1 sequence. Paths and every number in out.\n"
    assert "Paths against the truth" in out and "Depth of sequences" in out and "5 of 6" in out
    ((frames, given),) = reconstruct
    assert [path.name for path in frames] == [f"{k:03d}.png" for k in range(N)]
    assert given["settings"] == Settings.preset("fast", motion="camera", warps=2)
    assert given["camera"].focal == 30 and given["poses"] is None
    (record,) = evaluated("out")["sequences"]
    assert record["posed"] == 5 and record["pieces"][0]["share"] < 1e-9
    assert record["depth"]["without"] == 1
    written = read_tum("out/wall.tum")
    np.testing.assert_array_equal(written.times, [0, 1, 3, 4, 5])
    np.testing.assert_allclose(written.poses[:, :3, 3], 0.5 * PATH[[0, 1, 3, 4, 5], :3, 3])


def test_a_motion_of_pairs_is_refused(tisfm_run, wall, reconstruct):
    code, _, err = tisfm_run("eval", "wall", "--sequence", "--motion", "field")
    assert_one_line(code, err, "--motion field works on pairs", "camera or objects")
    assert not reconstruct


def test_the_time_of_a_sequence_is_estimated(tisfm_run, wall, reconstruct, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    finds = tisfm.reconstruct

    def slow(source, *, progress, **options):
        for done in range(1, 60):
            progress("path", done, 100)
            now[0] += 4.0
        return finds(source, **options)

    monkeypatch.setattr(tisfm, "reconstruct", slow)
    code, _, err = tisfm_run("eval", "wall", "--sequence", "--give-poses")
    assert code == 0
    assert err.splitlines()[0] == "100 frames of wall, path: about 6 min 20 s to go, 0.25 a second"


def test_given_poses_are_not_compared(tisfm_run, wall, reconstruct):
    code, out, _ = tisfm_run("eval", "wall", "--sequence", "--give-poses")
    assert code == 0 and "Paths against the truth" not in out and "Depth of sequences" in out
    np.testing.assert_allclose(reconstruct[0][1]["poses"], PATH)


@pytest.mark.parametrize(
    "write", [write_kitti, lambda path, poses: write_tum(path, poses, range(N))]
)
def test_a_path_of_another_program_is_compared(tisfm_run, wall, write):
    found = PATH.copy()
    found[:, :3, 3] *= 3
    write("found.txt", found)
    code, out, err = tisfm_run("eval", "wall", "--sequence", "--result", "found.txt", "-o", "out")
    assert code == 0 and err.startswith("1 sequence.")
    assert "Depth" not in out
    (piece,) = evaluated("out")["sequences"][0]["pieces"]
    assert piece["absolute"]["scale"] == pytest.approx(1 / 3) and piece["share"] < 1e-9


def test_a_saved_evaluation_is_loaded(tisfm_run, wall, work_folder, monkeypatch):
    class Reconstruction:
        @staticmethod
        def load(folder):
            assert folder == Path("saved")
            return Result(unit=4)

    monkeypatch.setattr(tisfm, "Reconstruction", Reconstruction, raising=False)
    (work_folder / "saved").mkdir()
    code, out, _ = tisfm_run("eval", "wall", "--sequence", "--result", "saved")
    assert code == 0 and "6 of 6" in out and "Depth of sequences" in out


def test_sequences_of_one_name_have_a_file_each(tisfm_run, work_folder, reconstruct):
    for part in ("a", "b"):
        make_sequence(work_folder / part / "wall")
    code, _, _ = tisfm_run("eval", "a", "b", "--sequence", "-o", "out")
    assert code == 0
    assert {path.name for path in Path("out").iterdir()} == {"wall.tum", "wall_2.tum", "eval.json"}


def test_every_piece_has_a_file(tisfm_run, wall, monkeypatch):
    result = Result()
    result.piece[:2], result.piece[2:] = 0, 1
    monkeypatch.setattr(tisfm, "reconstruct", lambda source, **_: result, raising=False)
    assert tisfm_run("eval", "wall", "--sequence", "-o", "out")[0] == 0
    np.testing.assert_array_equal(read_tum("out/wall.tum").times, [2, 3, 4, 5])
    np.testing.assert_array_equal(read_tum("out/wall-piece2.tum").times, [0, 1])


def test_a_fault_of_one_sequence_does_not_stop_the_others(
    tisfm_run, work_folder, wall, reconstruct
):
    make_sequence(work_folder / "broken")
    (work_folder / "broken" / "poses.txt").write_text("1 2 3\n")
    code, out, err = tisfm_run("eval", ".", "--sequence", "-o", "out")
    assert code == 1 and "broken (failed)" in out
    lines = err.splitlines()
    assert lines[0].startswith("1 sequence.") and len(lines) == 2
    assert lines[1].startswith("tisfm: broken: ") and "line 1 has 3 numbers" in lines[1]
    assert [entry["fault"] is None for entry in evaluated("out")["sequences"]] == [False, True]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["flows", "--sequence"], ["there is no folder flows"]),
        (["wall/images", "--sequence"], ["holds no sequence whose path or depth is known"]),
        (["wall", "--sequence", "--layout", "kitti"], ["layout is 'kitti'", "no sequences"]),
        (["wall", "--layout", "tum"], ["layout is 'tum'", "give --sequence"]),
        (["wall", "--result", "wall/poses.txt"], ["pairs are compared: give --sequence"]),
        (["wall", "--sequence", "--max-depth", "0"], ["max_depth is 0"]),
        (["wall", "other", "--sequence", "--result", "x"], ["2 sequences, wall, other"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_wrong_words_are_one_line(tisfm_run, work_folder, wall, arguments, words):
    make_sequence(work_folder / "other")
    code, out, err = tisfm_run("eval", *arguments, "-o", "out")
    assert out == ""
    assert_one_line(code, err, *words)
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--result", "gone.txt"], "gone.txt"),
        (["--result", "wall/camera.txt"], "wall/camera.txt is not a trajectory"),
        (["--step", "0"], "step is 0: expected a positive whole number"),
        (["--step", "9"], "has 1 frames at a step of 9"),
    ],
)
def test_faults_of_a_sequence_are_one_line(tisfm_run, wall, reconstruct, arguments, words):
    code, _, err = tisfm_run("eval", "wall", "--sequence", *arguments)
    assert code == 1 and err.startswith("tisfm: wall: ") and words in err
    assert err.count("\n") == 1
