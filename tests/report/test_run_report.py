"""The report of a run, and of a reconstruction, by the command line."""

import json
import os
import shutil
import subprocess

import cv2
import pytest

import tisfm
from tests.cli.command_line import FRAMES, TISFM, assert_one_line, files, record
from tests.cli.conftest import frames, tisfm_run, work_folder  # noqa: F401
from tests.reconstruction.films import walk
from tests.report.made import Read, assert_self_contained
from tisfm.cli.command_line import main
from tisfm.formats import write_png
from tisfm.report import REPORT, run_report, write_run_report


def read(folder):
    page = Read(folder / REPORT)
    assert_self_contained(page)
    return page


def test_a_run_has_a_report(tisfm_run, frames, work_folder):  # noqa: F811
    code, out, err = tisfm_run("run", "frames", "-o", "out", "--report", "--preset", "fast",
                               "--smoothness", "55", "--no-figures")  # fmt: skip
    assert code == 0 and out == ""
    assert err.splitlines()[-1] == f"Open {os.path.join('out', REPORT)} in a browser."
    page = read(work_folder / "out")
    for words in ("3 of 3", "40 × 24 px", "fast", "except for 1, listed first", "smoothness 55",
                  "f0", "f1", "f2"):  # fmt: skip
        assert words in page.text, words
    assert len(page.all("div", _class="slide")) == 3
    assert len(page.all("img")) == 3 * 4 + 1  # frame, depth, motion, confidence; and a legend
    # The same again, from the folder alone, but for the name of the source.
    before = (work_folder / "out" / REPORT).read_bytes()
    assert tisfm_run("report", "out")[0] == 0
    again = (work_folder / "out" / REPORT).read_bytes()
    assert tisfm_run("report", "out")[0] == 0
    assert (work_folder / "out" / REPORT).read_bytes() == again
    assert len(before) > len(again) > 5000


def test_the_report_has_the_advice_of_statuses(tisfm_run, work_folder):  # noqa: F811
    (work_folder / "still").mkdir()
    for k, frame in enumerate((FRAMES[0], FRAMES[0], FRAMES[1])):
        write_png(work_folder / "still" / f"f{k}.png", frame)
    assert tisfm_run("run", "still", "-o", "out", "--report", "--no-figures")[0] == 0
    page = read(work_folder / "out")
    message = record("out")["pairs"]["f0"]["message"]
    assert "no_motion" in page.text and " ".join(message.split()) in page.text


def test_resume_renews_the_report(tisfm_run, frames, work_folder):  # noqa: F811
    run = ("run", "frames", "-o", "out", "--no-figures")
    assert tisfm_run(*run, "--stop", "3", "--report")[0] == 0
    short = (work_folder / "out" / REPORT).read_bytes()
    assert tisfm_run(*run, "--resume", "--report")[0] == 0
    assert (work_folder / "out" / REPORT).read_bytes() != short
    assert "3 of 3" in read(work_folder / "out").text
    # What an earlier run left does not stay beside the results of another one.
    assert tisfm_run(*run, "--stop", "2")[0] == 0
    assert REPORT not in files("out")


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
def test_a_file_name_with_markup_is_escaped(tisfm_run, work_folder):  # noqa: F811
    (work_folder / "evil").mkdir()
    for k in range(2):
        write_png(work_folder / "evil" / f"{k}<script>alert(1)<.png", FRAMES[k])
    assert tisfm_run("run", "evil", "-o", "out", "--report", "--no-figures")[0] == 0
    page = read(work_folder / "out")
    assert "0<script>alert(1)<" in page.text
    assert all("alert" not in script for script in page.scripts)


def test_impossible_reports_are_refused_before_any_work(tisfm_run, frames, work_folder):  # noqa: F811
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--report", "--outputs", "depth")
    assert_one_line(code, err, "npz", "--report")
    (work_folder / "out").mkdir()
    (work_folder / "out" / REPORT).write_text("mine")
    for command in ("run", "reconstruct"):
        code, _, err = tisfm_run(command, "frames", "-o", "out", "--report")
        assert_one_line(code, err, REPORT, "not a report of tisfm")
    assert (work_folder / "out" / REPORT).read_text() == "mine"


def test_folders_without_results_are_one_line(tisfm_run, work_folder):  # noqa: F811
    code, _, err = tisfm_run("report", "nowhere")
    assert_one_line(code, err, "nowhere", "run.json", "reconstruction.json")
    (work_folder / "bad").mkdir()
    (work_folder / "bad" / "run.json").write_text('{"version": "0", "pairs": {"a": {"status": 3}}}')
    code, _, err = tisfm_run("report", "bad")
    assert_one_line(code, err, "bad")


@pytest.mark.parametrize(
    "path, value",
    [
        (["pairs"], None),
        (["pairs"], ["f0"]),
        (["pairs", "f0", "number"], "one"),
        (["pairs", "f0", "speed"], [1]),
        (["source"], {}),
        (["source", "focal"], "long"),
        (["source", "width"], None),
        (["settings", "preset"], "x"),
        (["settings", "warps"], "many"),
        (["start"], None),
    ],
)
def test_a_wrong_record_is_one_line(a_run, tmp_path, tisfm_run, path, value):  # noqa: F811
    folder = shutil.copytree(a_run, tmp_path / "changed")
    changed = record(folder)
    part = changed
    for name in path[:-1]:
        part = part[name]
    part[path[-1]] = value
    (folder / "run.json").write_text(json.dumps(changed))
    code, _, err = tisfm_run("report", folder)
    assert_one_line(code, err, "changed")


def test_a_bug_of_the_report_is_raised(a_run, monkeypatch):
    def broken(curves):
        raise KeyError("a bug")

    monkeypatch.setattr(run_report, "curves_drawing", broken)
    with pytest.raises(KeyError, match="a bug"):
        write_run_report(a_run, record(a_run))


@pytest.fixture(scope="module")
def a_run(tmp_path_factory):
    """A folder of a run of three pairs."""
    folder = tmp_path_factory.mktemp("a_run")
    (folder / "frames").mkdir()
    for k, frame in enumerate(FRAMES):
        write_png(folder / "frames" / f"f{k}.png", frame)
    call = ["run", folder / "frames", "-o", folder / "out", "--preset", "fast", "--no-figures"]
    assert main([*map(str, call)]) == 0
    return folder / "out"


@pytest.mark.nightly
def test_the_same_results_give_the_same_bytes(tisfm_run, frames, work_folder):  # noqa: F811
    """Other processes and folders give the same bytes."""
    pages = []
    for parent in ("one", "two"):
        call = ["run", "frames", "-o", f"{parent}/out", "--report", "--preset", "fast"]
        subprocess.run([*TISFM, *call], check=True, capture_output=True)
        pages.append((work_folder / parent / "out" / REPORT).read_bytes())
    assert pages[0] == pages[1] and len(pages[0]) > 5000


def test_pairs_without_their_data_have_no_pictures(a_run, tisfm_run, tmp_path):  # noqa: F811
    folder = shutil.copytree(a_run, tmp_path / "changed")
    for path in folder.glob("*.npz"):
        path.unlink()
    assert tisfm_run("report", folder)[0] == 0
    page = read(folder)
    assert "did not write" in page.text and not page.all("img")


def test_a_reconstruction_has_a_report(tisfm_run, work_folder):  # noqa: F811
    film = walk(6, 120, 160)
    (work_folder / "film").mkdir()
    for k in range(6):
        cv2.imwrite(str(work_folder / "film" / f"f{k}.png"), film.frames[k])
    focal = ("--focal", film.camera.focal)
    call = ("reconstruct", "film", "-o", "out", "--preset", "fast", *focal)
    assert tisfm_run(*call, "--report")[0] == 0
    page = read(work_folder / "out")
    assert "6 of 6" in page.text
    assert "Depth of every frame," in (work_folder / "out" / "timings.csv").read_text()
    assert len(page.all("svg")) == 2 and len(page.all("div", _class="slide")) == 6
    first = (work_folder / "out" / REPORT).read_bytes()
    # It is no part of what the folder is held against: it may be made again, or removed.
    (work_folder / "out" / REPORT).unlink()
    code, _, err = tisfm_run(*call, "--resume")
    assert (
        code == 0 and "is already complete" in err and not (work_folder / "out" / REPORT).exists()
    )
    code, _, err = tisfm_run(*call, "--resume", "--report")
    assert code == 0 and "is already complete" in err
    again = (work_folder / "out" / REPORT).read_bytes()
    assert again == first
    shutil.copytree("out", "copy")
    assert tisfm_run("report", "copy")[0] == 0
    assert len(tisfm.Reconstruction.load("copy")) == 6
    # A new one replaces it, and its report.
    assert tisfm_run(*call, "--stop", "4")[0] == 0
    assert not (work_folder / "out" / REPORT).exists()
