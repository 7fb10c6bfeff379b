"""`tisfm eval --objects`."""

import json
from pathlib import Path

import pytest

from tests.cli.command_line import assert_one_line
from tests.evaluation.test_masks import save, truth


@pytest.fixture
def folders(work_folder):
    save(work_folder / "camel" / "masks", truth(), name="{:05d}.png")
    save(work_folder / "found" / "masks", truth() // 255, indexed=True)


def test_masks_are_compared(tisfm_run, folders):
    code, out, err = tisfm_run("eval", "camel", "--objects", "--result", "found", "-o", "out")
    assert code == 0 and err == "1 object in 4 frames. Every number in out.\n"
    assert "Moving objects of camel" in out and "1.000" in out and "4 of 4" in out
    record = json.loads(Path("out/eval.json").read_text(encoding="utf-8"))["objects"]
    assert record["name"] == "camel" and record["iou"] == 1 and record["switches"] == 0
    assert record["objects"][0]["label"] == 1


def test_several_objects_have_a_mean(tisfm_run, folders, work_folder):
    two = truth()
    two[:, 7, 8:] = 7
    save(work_folder / "camel" / "masks", two, name="{:05d}.png")
    code, out, err = tisfm_run("eval", "camel/masks", "--objects", "--result", "found")
    assert code == 0 and err == "2 objects in 4 frames.\n"
    assert "0.500" in out and "4 of 8" in out and "all" in out


def test_a_step_is_taken(tisfm_run, folders, work_folder):
    save(work_folder / "half" / "masks", truth()[::2] // 255, indexed=True)
    code, _, err = tisfm_run("eval", "camel", "--objects", "--result", "half", "--step", "2")
    assert code == 0 and err == "1 object in 2 frames.\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["camel", "--objects"], ["--result is missing", "--objects --result DIR"]),
        (["camel", "found", "--objects", "--result", "found"], ["2 folders, camel, found"]),
        (["camel", "--objects", "--result", "camel/masks"], ["has no folder masks", "--motion"]),
        (["gone", "--objects", "--result", "found"], ["there is no folder gone"]),
        (["camel", "--objects", "--sequence", "--result", "found"], ["give one of them"]),
        (["camel", "--objects", "--result", "found", "--step", "2"], ["masks of 4 frames"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_wrong_words_are_one_line(tisfm_run, folders, arguments, words):
    code, out, err = tisfm_run("eval", *arguments, "-o", "out")
    assert out == ""
    assert_one_line(code, err, *words)
    assert not Path("out").exists()
