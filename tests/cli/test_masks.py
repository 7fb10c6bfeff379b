"""`tisfm run --mask`: pixels that are ignored."""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.command_line import H, W, assert_one_line, files, load
from tisfm.formats import write_png

QUIET = ("-o", "out", "--no-figures")
BONNET = np.full((H, W), 255, np.uint8)
BONNET[-6:] = 0


@pytest.fixture
def masks(work_folder):
    """A folder of masks called like the frames; the bonnet is in the second one alone."""
    folder = work_folder / "masks"
    folder.mkdir()
    for k in range(4):
        write_png(folder / f"f{k}.png", BONNET if k == 1 else np.full((H, W), 255, np.uint8))
    return folder


def test_one_picture(tisfm_run, frames):
    write_png("bonnet.png", BONNET)
    assert tisfm_run("run", "frames", *QUIET, "--mask", "bonnet.png")[0] == 0
    for name in ("f0", "f1", "f2"):
        result = load("out", name)
        assert result.occlusion[-6:].all() and not result.confidence[-6:].any()
        assert result.occlusion[:-6].mean() < 0.4


def test_a_folder_of_masks(tisfm_run, frames, masks):
    assert tisfm_run("run", "frames", *QUIET)[0] == 0
    without = files("out")
    assert tisfm_run("run", "frames", *QUIET, "--mask", "masks")[0] == 0
    given = files("out")
    assert load("out", "f1").occlusion[-6:].all()
    assert load("out", "f0").occlusion[-5:, : W - 4].all()  # where it goes in f1
    # Pairs without an ignored pixel are as they were.
    assert given["f2.npz"] == without["f2.npz"]
    assert all(given[f"{name}.npz"] != without[f"{name}.npz"] for name in ("f0", "f1"))


def test_masks_are_cropped_and_shrunk_with_the_frames(tisfm_run, frames):
    write_png("bonnet.png", BONNET)
    view = ("--crop", "4", "4", "32", "20", "--size", "16")
    assert tisfm_run("run", "frames", *QUIET, *view, "--mask", "bonnet.png")[0] == 0
    result = load("out", "f0")
    assert result.occlusion.shape == (10, 16)
    assert result.occlusion[-3:].all() and not result.occlusion[:-4].all()


def test_another_mask_does_not_resume(tisfm_run, frames):
    write_png("bonnet.png", BONNET)
    assert tisfm_run("run", "frames", *QUIET, "--mask", "bonnet.png")[0] == 0
    before = files("out")
    assert tisfm_run("run", "frames", *QUIET, "--mask", "bonnet.png", "--resume")[0] == 0
    assert files("out") == before
    assert_one_line(*tisfm_run("run", "frames", *QUIET, "--resume")[::2], "mask")
    assert files("out") == before


@pytest.mark.parametrize(
    ("mask", "words"),
    [("gone.png", "gone.png"), ("small.png", "(5, 7)"), ("black.png", "black at all pixels")],
)
def test_wrong_masks_are_refused(tisfm_run, frames, mask, words):
    write_png("small.png", np.ones((5, 7), np.uint8))
    write_png("black.png", np.zeros((H, W), np.uint8))
    code, _, err = tisfm_run("run", "frames", *QUIET, "--mask", mask)
    assert_one_line(code, err, words)


def test_too_few_masks(tisfm_run, frames, masks):
    Path("masks/f3.png").unlink()
    code, _, err = tisfm_run("run", "frames", *QUIET, "--mask", "masks")
    assert_one_line(code, err, "f3.png")


def test_masks_are_not_overwritten(tisfm_run, frames, masks):
    write_png("f0_depth.png", BONNET)
    code, _, err = tisfm_run("run", "frames", "-o", ".", "--no-figures", "--mask", "f0_depth.png")
    assert_one_line(code, err, "f0_depth.png")
    code, _, err = tisfm_run("run", "frames", "-o", "masks", "--mask", "masks")
    assert_one_line(code, err, "among the masks")
    write_png("bonnet.png", BONNET)  # beside results it may lie
    code, _, err = tisfm_run("run", "frames", "-o", ".", "--no-figures", "--mask", "bonnet.png")
    assert code == 0
