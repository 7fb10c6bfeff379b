"""A flow field between unrelated frames has a status that says so; related frames have none."""

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.pairwise import pairwise
from tests.rendered import bare_patches, static_scene, two_blocks
from tisfm.interpretation import Interpretation

SIZE = (120, 160)
PRESETS = ("paper", "fast", "balanced")


@pytest.fixture(scope="module")
def scene():
    return static_scene("forward+rotation", *SIZE)


def status(frame0, frame1, preset):
    settings = tisfm.Settings.preset(preset)
    return tisfm.interpret(frame0, frame1, settings=settings).status


@pytest.mark.parametrize("preset", nightly_except("paper", "balanced", of=[*PRESETS, "accurate"]))
def test_other_scenes_and_mirrored_frames(scene, preset):
    """The flow of "paper" deforms until half of the frames look alike, but it folds the image."""
    other = static_scene("sideways", *SIZE, seed=9).frame1
    for frame1 in (other, scene.frame0[:, ::-1], scene.frame0[::-1]):
        found = status(scene.frame0, frame1, preset)
        words = "folds" if preset == "paper" else "no flow aligns"
        assert found == "unrelated" and words in found.message


@pytest.mark.parametrize("preset", PRESETS)
def test_noise(scene, preset):
    noise, other = np.random.default_rng(0).integers(0, 256, (2, *SIZE), dtype=np.uint8)
    assert status(scene.frame0, noise, preset) == "unrelated"
    assert status(noise, other, preset) == "unrelated"


@pytest.mark.parametrize("preset", PRESETS)
def test_a_first_frame_without_texture(scene, preset):
    assert status(np.full(SIZE, 90, np.uint8), scene.frame1, preset) == "no_texture"


@pairwise(make=[static_scene, two_blocks, bare_patches], preset=PRESETS, noise=[0, 20], short=True)
def test_frames_of_one_scene(make, noise, preset):
    pair = make("sideways", *SIZE) if make is static_scene else make(*SIZE)
    rng = np.random.default_rng(0)
    frames = (frame + rng.normal(0, noise, frame.shape) for frame in (pair.frame0, pair.frame1))
    frames = [np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in frames]
    assert status(*frames, preset) in ("converged", "iteration_limit")


@pytest.mark.parametrize(("scale", "offset"), [(1 / 255, 0), (1, 1000), (1e4, 0)])
def test_brightness_of_any_scale(scene, scale, offset):
    frames = (scale * frame.astype(np.float32) + offset for frame in (scene.frame0, scene.frame1))
    assert status(*frames, "balanced") == "converged"


def test_it_is_stored(scene, tmp_path):
    result = tisfm.interpret(scene.frame0, scene.frame0[::-1])
    assert result.status == "unrelated" and np.isfinite(result.flow).all()
    result.save(tmp_path / "result.npz")
    assert Interpretation.load(tmp_path / "result.npz").status == "unrelated"


def test_frames_of_a_thin_strip_are_judged():
    noise = np.random.default_rng(0).integers(0, 256, (2, 4, 9000), dtype=np.uint8)
    assert status(*noise, "fast") in ("unrelated", "diverged")
