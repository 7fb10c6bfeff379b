"""`tisfm run --window`: three frames for each interpretation."""

from pathlib import Path

import numpy as np

import tisfm
from tests.cli.command_line import ENDINGS, FRAMES, assert_one_line, files, kept, load, record


def test_a_window_is_that_of_a_sequence(tisfm_run, frames):
    run = ("run", "frames", "-o", "out", "--no-figures", "--window", "3")
    assert tisfm_run(*run)[0] == 0
    camera = tisfm.Camera(600.0)
    expected = list(tisfm.interpret_sequence(FRAMES, camera=camera, window=3))
    for name, result in zip(record("out")["pairs"], expected, strict=True):
        np.testing.assert_array_equal(load("out", name).flow, kept(result).flow)
    assert record("out")["window"] == 3


def test_a_run_with_a_window_is_resumed(tisfm_run, frames):
    run = ("run", "frames", "-o", "out", "--no-figures", "--window", "3")
    assert tisfm_run(*run)[0] == 0
    before = files("out")
    names = list(record("out")["pairs"])
    for ending in ENDINGS - {"_figure.png"}:
        Path(f"out/{names[-1]}{ending}").unlink()
    assert tisfm_run(*run, "--resume")[0] == 0
    assert files("out") == before
    code, _, err = tisfm_run(*run[:-2], "--resume")
    assert_one_line(code, err, "other options")


def test_wrong_windows_are_refused(tisfm_run, frames):
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--window", "3", "--motion", "camera")
    assert_one_line(code, err, "window is 3", 'motion="camera"')
    assert not Path("out").exists()
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--window", "4")
    assert code != 0 and "Traceback" not in err
