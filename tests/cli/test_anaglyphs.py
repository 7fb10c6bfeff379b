"""`tisfm run --disparity --screen`: one plane of the screen for all pairs, and what is refused."""

import numpy as np
import pytest

from tests.cli.command_line import assert_one_line, files, load, record
from tisfm.formats import read_image, write_png
from tisfm.scenes import two_blocks
from tisfm.show import anaglyph

RUN = ("run", "frames", "-o", "out", "--outputs", "anaglyph,npz", "--preset", "fast")


@pytest.fixture
def frames(work_folder):
    scene = two_blocks(48, 64)
    (work_folder / "frames").mkdir()
    for k, frame in enumerate((scene.frame0, scene.frame1, scene.frame0)):
        write_png(work_folder / "frames" / f"f{k}.png", frame)
    return work_folder / "frames"


def drawn(name, **options):
    """Return the anaglyph that a file of a pair holds, and what it should hold."""
    result = load("out", name)
    return read_image(f"out/{name}_anaglyph.png").astype(int), anaglyph(
        result.frame, result.inverse_depth, **options
    ).astype(int)


def test_the_screen_is_that_of_the_first_pair(tisfm_run, frames):
    assert tisfm_run(*RUN, "--disparity", "0.1", "--screen", "0.2")[0] == 0
    about = record("out")
    assert (about["disparity"], about["screen"]) == (0.1, 0.2)
    levels = []
    for name in ("f0", "f1"):
        inverse_depth = np.maximum(load("out", name).inverse_depth, 0)
        levels.append(inverse_depth.mean(dtype=np.float64))
    first = load("out", "f0").inverse_depth
    plane = np.quantile(first[first > 0], 0.2) / levels[0]
    assert about["screen_at"] == pytest.approx(plane, rel=2e-3)  # .npz is rounded
    for name, level in zip(("f0", "f1"), levels, strict=True):
        options = {"limit": about["depth_range"] * level, "disparity": 0.1}
        found, expected = drawn(name, screen_depth=1 / (plane * level), **options)
        other = drawn(name, screen=1.0, **options)[1]
        assert np.abs(found - expected).mean() < 0.3 * np.abs(found - other).mean()


def test_the_default_screen_is_in_the_middle(tisfm_run, frames):
    assert tisfm_run(*RUN)[0] == 0
    about = record("out")
    assert (about["disparity"], about["screen"]) == (0.03, None)
    assert about["screen_at"] == pytest.approx(about["depth_range"] / 2)
    before = files("out")
    assert tisfm_run(*RUN, "--resume")[0] == 0 and files("out") == before
    code, _, err = tisfm_run(*RUN, "--resume", "--screen", "0.5")
    assert_one_line(code, err, "a run with other options", "screen")
    assert files("out") == before


def test_impossible_options_are_refused_before_any_work(tisfm_run, frames):
    for option, said in (
        (("--disparity", "0"), "disparity is 0"),
        (("--disparity", "0.5"), "expected a share of the width, above 0, up to 0.2"),
        (("--screen", "2"), "screen is 2.0, expected a quantile, from 0 to 1"),
        (("--screen", "nan"), "screen is nan"),
    ):
        code, _, err = tisfm_run(*RUN, *option)
        assert_one_line(code, err, said)
    without_anaglyph = ["npz" if word == "anaglyph,npz" else word for word in RUN]
    for option, said in (
        (("--screen", "0.5"), "--screen is only for anaglyphs: add anaglyph"),
        (("--disparity", "0.1"), "--disparity is only for anaglyphs: add"),
    ):
        code, _, err = tisfm_run(*without_anaglyph, *option)
        assert_one_line(code, err, said)
    assert not (frames.parent / "out").exists()
