"""`tisfm demo` and `tisfm figures`."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import tisfm
from tests.cli.command_line import H, W, assert_one_line, files, load, promised, record
from tests.draws import nightly_except
from tests.waiting import PATIENCE, started, wait_for
from tisfm.camera_file import write_camera
from tisfm.cli import demo_scenes, figures
from tisfm.formats import read_image
from tisfm.settings import Settings

DEMO_FILES = promised("demo") | {
    "demo_flow.flo",
    "figure_lambda.png",
    "figure_presmoothing.png",
    "figure_contrast.png",
    "demo.webp",
}


@pytest.fixture
def interpreted(monkeypatch):
    """Return a list that receives the frames and settings of each interpretation of the demo."""
    seen, original = [], demo_scenes.interpret

    def interpret(frame0, frame1, *, camera, settings):
        seen.append((frame0.shape, frame0.tobytes(), settings))
        return original(frame0, frame1, camera=camera, settings=settings)

    for module in (demo_scenes, figures):
        monkeypatch.setattr(module, "interpret", interpret)
    return seen


@pytest.mark.nightly
def test_demo(quick_workers, tisfm_run, interpreted):
    """It interprets no pair twice with the same settings, and is right."""
    code, out, err = tisfm_run("demo", "--height", "96", "--width", "128", "-o", "out")
    assert code == 0
    figure = os.path.join("out", "demo_figure.png")
    assert err.startswith(f"Pictures and data in out. Open {figure} first, then ")
    rows = [line for line in out.splitlines() if line.startswith("│")]
    assert len(rows) == 6
    for row, label in zip(rows[:3], ("paper", "balanced", "Horn–Schunck"), strict=True):
        cells = [cell.strip() for cell in row.strip("│").split("│")]
        assert label in cells[0]
        assert 0 < float(cells[1]) < 0.5  # px
    assert set(files("out")) == DEMO_FILES
    assert load("out", "demo").settings == Settings()
    assert list(record("out")["pairs"]) == ["demo"]
    assert "then out/camera/demo_figure.png and out/objects/demo_figure.png.\n" in err
    cells = [[cell.strip() for cell in row.strip("│").split("│")] for row in rows[3:]]
    by_motion = {name: values for name, *values in cells}
    field, camera = by_motion["field, at rest"], by_motion["camera, at rest"]
    assert field[1] == "–" and 40 < float(camera[1].removesuffix(" %")) < 95
    assert float(camera[0]) < 0.05 < 0.1 < float(field[0])  # of the depth, forward
    assert float(camera[2]) < 0.1 and float(field[2]) < 0.1
    assert float(camera[3]) < 2 and float(camera[4]) < 0.1
    assert field[5] == camera[5] == "converged"
    objects = by_motion["objects, moving"]
    assert float(objects[0]) < 0.1 and 40 < float(objects[1].removesuffix(" %")) < 95
    expected = promised("demo") | {"demo_pose.txt", "demo_flow.flo"}
    assert set(files("out/camera")) == set(files("out/objects")) == expected
    assert load("out/camera", "demo").settings == Settings(motion="camera")
    whole = [call for call in interpreted if call[0] == (96, 128)]
    assert len(set(whole)) == len(whole)
    assert len(whole) == 8 or quick_workers == []  # other processes list their own calls


def test_the_demo_has_a_default_folder(quick_workers, tisfm_run):
    """Its table has a row for each method."""
    code, out, err = tisfm_run("demo", "--height", "24", "--width", "32")
    assert code == 0
    assert err.startswith(f"Pictures and data in tisfm-demo. Open {Path('tisfm-demo')}")
    assert len([line for line in out.splitlines() if line.startswith("│")]) == 6
    assert set(files("tisfm-demo")) == DEMO_FILES
    for motion in ("camera", "objects"):
        folder = f"tisfm-demo/{motion}"
        assert set(files(folder)) == promised("demo") | {"demo_pose.txt", "demo_flow.flo"}
        assert load(folder, "demo").settings == Settings(motion=motion)


@pytest.mark.nightly  # test_workers.py ends another command with its processes
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_ctrl_c_ends_the_demo(work_folder):
    code = """
import sys
import time
from pathlib import Path
from tisfm.cli import demo_scenes
from tisfm.cli.command_line import main

def endless(*frames, **options):
    Path("begun").touch()
    while True:
        time.sleep(0.1)

demo_scenes.interpret = demo_scenes.horn_schunck = endless  # workers import this file too
if __name__ == "__main__":
    sys.exit(main(["demo", "--height", "60", "--width", "80", "-o", "out"]))
"""
    (work_folder / "script.py").write_text(code)
    out, command = work_folder / "out", [sys.executable, "script.py"]
    with started(command, stderr=subprocess.PIPE, text=True) as process:
        wait_for((work_folder / "begun").exists, process)
        process.send_signal(signal.SIGINT)
        err = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 130 and err == "tisfm: interrupted\n"
    assert set(out.rglob("*")) == {out / "camera", out / "objects"}


@pytest.mark.parametrize(
    "options",
    nightly_except(
        ["--height", "0"],
        of=(["--height", "0"], ["--width", "-3"], ["--height", "2"], ["--seed", "-1"]),
    ),
    ids=" ".join,
)
def test_bad_sizes_of_the_demo_are_one_line(quick_workers, tisfm_run, options):
    code, out, err = tisfm_run("demo", "-o", "out", "--width", "16", "--height", "12", *options)
    assert out == ""
    assert_one_line(code, err)


def test_figures(tisfm_run, frames):
    code, out, err = tisfm_run("figures", "frames/f0.png", "frames/f1.png", "-o", "out")
    assert code == 0 and out == ""
    names = ["figure_lambda.png", "figure_presmoothing.png", "figure_contrast.png"]
    assert err == "wrote " + ", ".join(f"out/{name}" for name in names) + "\n"
    written = files("out")
    assert set(written) == set(names) and len(set(written.values())) == 3
    for name in names:
        assert read_image(f"out/{name}").shape[1] > 300


def test_figures_read_a_camera_file(tisfm_run, frames, monkeypatch):
    seen = []

    def draw(output, frame0, frame1, *, camera, inputs):
        seen.append(camera)
        return [output / "drawn.png"]

    monkeypatch.setattr(figures, "write_paper_figures", draw)
    doubt = {"seen": False, "message": "the focal length is a guess"}
    write_camera("lens.json", tisfm.Camera(focal=100.0), (2 * H, 2 * W), doubt)
    pair = frames / "f0.png", frames / "f1.png"
    code, _, err = tisfm_run("figures", *pair, "-o", "out", "--camera", "lens.json")
    assert code == 0 and err.startswith("lens.json: the focal length is a guess\n")
    assert seen == [tisfm.Camera(focal=50.0)]


def test_figures_of_a_missing_file(tisfm_run, frames, work_folder):
    code, _, err = tisfm_run("figures", "frames/f0.png", "gone.png", "-o", "out")
    assert_one_line(code, err, "gone.png")
    assert not (work_folder / "out").exists()
