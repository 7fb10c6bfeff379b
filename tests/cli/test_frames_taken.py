"""Which frames `tisfm run` takes, and what part of them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import tisfm
from tests.cli.command_line import (
    FRAMES,
    H,
    W,
    assert_one_line,
    files,
    kept,
    load,
    promised,
    record,
)

QUIET = ("-o", "out", "--no-figures")


@pytest.mark.parametrize(
    ("options", "names"),
    [(["--start", "1"], ["f1", "f2"]), (["--stop", "3"], ["f0", "f1"]),
     (["--start", "1", "--stop", "3"], ["f1"]), (["--start=1", "--step=2"], ["f1"])],
    ids=" ".join,
)  # fmt: skip
def test_a_range(tisfm_run, frames, options, names):
    assert tisfm_run("run", "frames", *QUIET, *options)[0] == 0
    assert list(record("out")["pairs"]) == names
    assert set(files("out")) == promised(*names, figures=False)


def test_a_range_of_a_video(tisfm_run, work_folder):
    writer = cv2.VideoWriter("clip.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write MJPG video")
    for frame in FRAMES:
        writer.write(cv2.resize(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), (64, 48)))
    writer.release()
    assert tisfm_run("run", "clip.avi", *QUIET, "--start", "1", "--stop", "4")[0] == 0
    pairs = record("out")["pairs"]
    assert list(pairs) == ["clip_000001", "clip_000002"]
    times = [time for pair in pairs.values() for time in pair["times"]]
    assert times == pytest.approx([0.1, 0.2, 0.2, 0.3], abs=1e-6)


def test_times_are_those_of_the_names(tisfm_run, frames):
    assert tisfm_run("run", "frames", *QUIET)[0] == 0
    assert {pair["times"] for pair in record("out")["pairs"].values()} == {None}
    for k, name in enumerate(("12.5", "12.625", "13.0", "14.125")):
        (frames / f"f{k}.png").rename(frames / f"{name}.png")
    assert tisfm_run("run", "frames", *QUIET)[0] == 0
    times = {name: pair["times"] for name, pair in record("out")["pairs"].items()}
    assert times == {"12.5": [12.5, 12.625], "12.625": [12.625, 13.0], "13.0": [13.0, 14.125]}


def test_poses_are_those_of_the_frames_that_are_taken(tisfm_run, frames):
    rows = [f"1 0 0 {0.1 * k**2} 0 1 0 0 0 0 1 0" for k in range(4)]
    Path("poses.txt").write_text("\n".join(rows))
    options = ("--motion", "camera", "--focal", "50", "--poses", "poses.txt")
    assert tisfm_run("run", "frames", *QUIET, *options, "--start", "1")[0] == 0
    sideways = {name: np.loadtxt(f"out/{name}_pose.txt")[3] for name in ("f1", "f2")}
    assert sideways == pytest.approx({"f1": -0.3, "f2": -0.5})


def test_poses_do_not_go_with_skipping(tisfm_run, frames):
    Path("poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 4)
    options = ("--motion", "camera", "--poses", "poses.txt", "--bad-frames", "skip")
    code, _, err = tisfm_run("run", "frames", *QUIET, *options)
    assert_one_line(code, err, "poses.txt", "bad frames may be skipped")


@pytest.mark.parametrize("motion", ["field", "camera"])
@pytest.mark.parametrize("focal", ["50", "guess"])
def test_the_camera_is_that_of_the_whole_frames(tisfm_run, frames, motion, focal):
    crop = ("--crop", "4", "2", "32", "20", "--size", "16")
    options = ("--motion", motion, "--focal", focal, "--preset", "fast")
    code, _, err = tisfm_run("run", "frames", *QUIET, *options, *crop)
    assert code == 0 and ("guessed: 48 px" in err) == (focal == "guess")
    known = 50.0 if focal == "50" else 1.2 * W
    assert record("out")["camera"]["focal"] == known / 2
    center = ((W - 1) / 2 - 4, (H - 1) / 2 - 2)
    center = [(coordinate + 0.5) / 2 - 0.5 for coordinate in center]
    assert record("out")["camera"]["center"] == center
    result = load("out", "f0")
    assert result.frame.shape == (10, 16) and result.camera.center == tuple(center)
    mean = FRAMES[0][2:22, 4:36].reshape(10, 2, 16, 2).mean((1, 3))
    assert np.abs(result.frame - mean).max() <= 0.5


def test_damaged_frames_are_skipped_or_an_error(tisfm_run, frames):
    (frames / "f1.png").write_bytes(b"damaged")
    code, _, err = tisfm_run("run", "frames", *QUIET)
    assert_one_line(code, err, "frame 1: ", "f1.png")
    assert not Path("out").exists()
    code, _, err = tisfm_run("run", "frames", *QUIET, "--bad-frames", "skip")
    assert code == 0
    assert list(record("out")["pairs"]) == ["f0", "f2"]
    told = [line for line in err.splitlines() if line.startswith("skipped: ")]
    assert len(told) == 1 and "frame 1: " in told[0] and "f1.png" in told[0]
    expected = tisfm.interpret(FRAMES[0], FRAMES[2])
    np.testing.assert_array_equal(load("out", "f0").flow, kept(expected).flow)


def test_no_camera_is_one_line(tisfm_run, work_folder, monkeypatch):
    class Absent:
        def __init__(self, number):
            assert number == 1

        def isOpened(self):
            return False

    monkeypatch.setattr(cv2, "VideoCapture", Absent)
    code, _, err = tisfm_run("run", "webcam:1", *QUIET)
    assert_one_line(code, err, "there is no webcam:1 that can be opened")


@pytest.mark.parametrize(
    ("options", "words"),
    [(["--start", "-1"], "start is -1"), (["--start", "9"], "has 4 frames: expected at least 11"),
     (["--stop", "1"], "stop is 1: expected at least 2"), (["--size", "2"], "size is 2"),
     (["--crop", "0", "0", "41", "20"], "crop is (0, 0, 41, 20)"),
     (["--crop", "0", "0", "2", "20"], "crop is (0, 0, 2, 20)")],
    ids=str,
)  # fmt: skip
def test_wrong_values_are_one_line(tisfm_run, frames, options, words):
    code, _, err = tisfm_run("run", "frames", *QUIET, *options)
    assert_one_line(code, err, words)
    assert not Path("out").exists()
