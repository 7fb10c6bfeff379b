"""`tisfm eval`: the table, the files and the faults."""

import json
from pathlib import Path

import numpy as np
import pytest

import tisfm
from tests.cli.command_line import assert_one_line
from tisfm.formats import read_flo, read_image
from tisfm.settings import Settings


def evaluated(folder):
    return json.loads((Path(folder) / "eval.json").read_text(encoding="utf-8"))


def table_of(out):
    rows = [line.strip("│").split("│") for line in out.splitlines() if line.startswith("│")]
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in rows}


@pytest.mark.parametrize("columns", ["100", "30"])  # a narrow terminal loses no column
def test_eval_prints_a_table(tisfm_run, benchmark_folder, work_folder, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    before = set(work_folder.rglob("*"))
    code, out, err = tisfm_run("eval", "flows", "flows/Slow")
    assert code == 0 and err == "2 pairs: 2 converged.\n"
    rows = table_of(out)
    assert list(rows) == ["flows/Fast", "flows/Slow", "flows, mean of 2"]
    assert all(0 < float(row[0]) < 0.2 for row in rows.values())
    assert set(work_folder.rglob("*")) == before


def test_eval_writes_what_it_prints(tisfm_run, benchmark_folder):
    code, out, err = tisfm_run("eval", "flows", "-o", "deep/out", "--preset", "fast")
    assert code == 0
    assert err == (
        "2 pairs: 2 converged. Pictures and flow in deep/out, every number in deep/out/eval.json.\n"
    )
    about = evaluated("deep/out")
    assert about["complete"] is True
    assert Settings(**about["settings"]) == Settings.preset("fast")
    rows = table_of(out)
    for entry in about["pairs"]:
        assert f"{entry['errors']['endpoint']:.3f}" == rows[f"flows/{entry['name']}"][0]
        flow = read_flo(f"deep/out/{entry['outputs']}_flow.flo")
        expected = tisfm.interpret(
            *(read_image(entry["inputs"][key]) for key in ("frame0", "frame1")),
            settings=Settings.preset("fast"),
        )
        np.testing.assert_array_equal(flow, expected.flow)
    assert f"{about['mean']['errors']['endpoint']:.3f}" == rows["flows, mean of 2"][0]


def test_options_reach_the_evaluation(tisfm_run, benchmark_folder):
    options = [
        "--preset",
        "paper",
        "--outer-iterations",
        "7",
        "--focal",
        "55",
        "--center",
        "3",
        "4",
    ]
    code, _, err = tisfm_run("eval", "flows", "-o", "out", *options)
    assert code == 0
    about = evaluated("out")
    assert Settings(**about["settings"]) == Settings.preset("paper", outer_iterations=7)
    camera = {
        "focal": 55.0,
        "center": [3.0, 4.0],
        "distortion": None,
        "aspect": 1.0,
        "readout": None,
    }
    assert about["camera"] == camera and {str(p["camera"]) for p in about["pairs"]} == {str(camera)}
    assert "2 iteration_limit" in err and "raise outer_iterations" in err


def test_a_fault_is_printed_at_the_end(tisfm_run, benchmark_folder):
    (benchmark_folder / "Fast" / "frame11.png").unlink()
    code, out, err = tisfm_run("eval", "flows", "-o", "out")
    assert code == 1
    assert list(table_of(out)) == ["flows/Fast (failed)", "flows/Slow", "flows, mean of 1"]
    lines = err.splitlines()
    assert len(lines) == 2 and lines[0].startswith("1 pair: 1 converged.")
    assert lines[1].startswith("tisfm: flows/Fast: ") and "frame11.png does not exist" in lines[1]
    assert evaluated("out")["complete"] is True
    assert [bool(entry["fault"]) for entry in evaluated("out")["pairs"]] == [True, False]


@pytest.mark.parametrize("step", [1, 2])
def test_eval_of_a_sequence(tisfm_run, sequence_folder, benchmark_folder, step):
    given = ["--step", step] if step > 1 else []
    code, out, err = tisfm_run("eval", "walk", "flows", "-o", "out", *given, "--preset", "fast")
    assert code == 0 and err.startswith(f"{6 - step} pairs: {6 - step} converged.")
    names = [f"walk/rgb_{k:05d}" for k in range(4 - step)]
    assert list(table_of(out)) == ["flows/Fast", "flows/Slow", "flows, mean of 2", *names]
    about = evaluated("out")
    pairs = {f"{entry['dataset']}/{entry['name']}": entry for entry in about["pairs"]}
    assert list(pairs) == [*names, "flows/Fast", "flows/Slow"]
    for k, name in enumerate(names):
        assert pairs[name]["inputs"]["pose_rows"] == [k, k + step]
        assert pairs[name]["inputs"]["frame1"].endswith(f"rgb_{k + step:05d}.png")
        assert (Path("out") / f"{name}_flow.flo").is_file()
        assert not (Path("out") / f"{name}_flow.png").exists()
    assert about["mean"]["pairs"] == 6 - step and about["mean"]["flow_pairs"] == 2


def test_a_damaged_pose_is_one_line(tisfm_run, sequence_folder):
    poses = sequence_folder / "poses_camera_to_world_3x4_cm.txt"
    poses.write_text(poses.read_text().replace("-3", "nan"))
    code, out, err = tisfm_run("eval", "walk", "--preset", "fast")
    assert code == 1 and "walk/rgb_00002 (failed)" in out
    lines = err.splitlines()
    assert len(lines) == 2 and lines[0] == "2 pairs: 2 converged."
    assert lines[1].startswith("tisfm: walk/rgb_00002: ")
    assert lines[1].endswith("cm.txt, row 3 is not finite: there is no pose of this frame")


def test_an_interrupted_evaluation_is_one_line(tisfm_run, benchmark_folder, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(tisfm.evaluation.files, "save_figure", interrupted)
    assert tisfm_run("eval", "flows", "-o", "out") == (130, "", "tisfm: interrupted\n")
    assert evaluated("out")["complete"] is False and evaluated("out")["pairs"] == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["FOLDER is missing", "tisfm eval FOLDER -o DIR"]),
        (["gone"], ["there is no folder gone"]),
        (["flows", "frames"], ["frames holds no pair", "flow10.flo", "flow_occ", "disparity"]),
        (["frames", "--layout", "kitti"], ["frames holds no pair", "flow_occ"]),
        (["flows", "--layout", "sintel"], ["flows holds no pair", "frame_NNNN.flo"]),
        (["flows/Slow/flow10.flo"], ["flow10.flo is a file", "folder of a dataset"]),
        (["flows", "--step", "2"], ["step is 2", "no sequence with poses in flows"]),
        (["flows", "--step", "0"], ["step is 0", "positive whole number"]),
        (["flows", "--focal", "0"], ["focal is 0", "positive"]),
        (["flows", "--center", "3", "4"], ["center is given without focal"]),
        (["flows", "--warps", "0"], ["warps is 0", "at least 1"]),
        (["flows", "--threads", "0"], ["threads is 0", "positive integer"]),
        (["flows", "--arch", "vulkan"], ["Taichi ", "on 'vulkan'"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_wrong_evaluations_are_one_line(
    tisfm_run, frames, benchmark_folder, without_vulkan, arguments, words
):
    code, out, err = tisfm_run("eval", *arguments, "-o", "out")
    assert code == 1 and out == ""
    assert_one_line(code, err, *words)
    assert not Path("out").exists()
