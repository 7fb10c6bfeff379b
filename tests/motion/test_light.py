"""Changes of light between the frames of a pair."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.rendered import static_scene
from tisfm.metrics import depth_errors
from tisfm.motion import first_motion as module
from tisfm.motion.light import LightChange, find_light_change, with_light_note
from tisfm.status import Status

HEIGHT, WIDTH = 60, 80
STILL = np.zeros((HEIGHT, WIDTH, 2), np.float32)
TRUSTED = np.ones((HEIGHT, WIDTH), np.float32)


def picture(seed=0):
    """Return grains of 1 px in 20 to 200 grey levels, (HEIGHT, WIDTH) float32."""
    return np.random.default_rng(seed).uniform(20, 200, (HEIGHT, WIDTH)).astype(np.float32)


def test_same_light_is_no_change():
    frame = picture()
    noise = np.random.default_rng(1).normal(0, 2, frame.shape).astype(np.float32)
    assert find_light_change(frame, frame + noise, STILL, TRUSTED) is None


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 30.0), (0.7, 0.0), (1.2, -15.0)])
def test_gain_and_offset_are_found_and_undone(gain, offset):
    frame = picture()
    change = find_light_change(frame, gain * frame + offset, STILL, TRUSTED)
    assert change.is_large and abs(change.offset - offset) < 2
    assert np.abs(change.undo(gain * frame + offset) - frame).max() < 2


def test_a_lamp_at_one_side_is_undone():
    frame = picture()
    lit = frame * np.linspace(0.8, 1.3, WIDTH, dtype=np.float32)
    before, after = (
        np.abs(image - frame).mean()
        for image in (lit, find_light_change(frame, lit, STILL, TRUSTED).undo(lit))
    )
    assert after < before / 4


def test_a_region_without_trusted_flow_has_no_change():
    frame = picture()
    assert find_light_change(frame, frame + 30, STILL, 0 * TRUSTED) is None


def test_a_small_change_is_not_mentioned():
    status = Status("converged", "well")
    change = find_light_change(picture(), picture() + 30, STILL, TRUSTED)
    assert "by up to 30 grey levels" in with_light_note(status, (change,)).message
    small = replace(change, typical_change=1.0, largest_change=2.0)
    assert with_light_note(status, (small,)) is status


@pytest.mark.parametrize(
    ("before", "after", "remains"),
    [
        ((10, 20), (6, 6), True),
        ((10, 20), (1, 12), True),
        ((10, 20), (4, 9), False),
        ((0.3, 8), (0.2, 1), False),  # a small change need not become smaller
        ((0.3, 8), (0.1, 7), True),
    ],
)
def test_most_of_a_change_remains(before, after, remains):
    changes = [
        LightChange(gain=TRUSTED, offset=0.0, typical_change=typical, largest_change=largest)
        for typical, largest in (before, after)
    ]
    assert changes[0].remains(changes[1]) == remains


def test_a_change_in_other_coordinates():
    gain = np.linspace(1, 2, WIDTH, dtype=np.float32) + np.zeros((HEIGHT, 1), np.float32)
    change = LightChange(gain=gain, offset=3.0, typical_change=9.0, largest_change=9.0)
    moved = change.warp(np.array([[1.0, 0, 7], [0, 1, 2], [0, 0, 1]]), gain.shape)
    np.testing.assert_allclose(moved.gain[2:, 7:], gain[:-2, :-7], atol=1e-4)
    assert moved.offset == 3.0


@pytest.mark.parametrize("motion", ["camera", "objects"])
def test_depth_of_a_pair_whose_second_frame_is_brighter(motion):
    scene = static_scene("sideways", 96, 128)
    bright = np.clip(scene.frame1.astype(int) + 40, 0, 255).astype(np.uint8)
    settings = tisfm.Settings.preset("fast", motion=motion)

    def result(frame1):
        return tisfm.interpret(scene.frame0, frame1, camera=scene.camera, settings=settings)

    even, changed = result(scene.frame1), result(bright)
    assert changed.status == "converged" and "frame 1 was brought to the light" in (
        changed.status.message
    )
    assert "light" not in even.status.message
    errors = [depth_errors(found.depth, scene.depth).abs_rel for found in (even, changed)]
    assert errors[1] < 1.3 * errors[0] + 0.01


def test_light_stays_if_the_flow_was_wrong(monkeypatch):
    scene = static_scene("sideways", 96, 128)
    settings = tisfm.Settings.preset("fast", motion="camera")
    frames = scene.frame0, scene.frame1
    change = find_light_change(picture(), picture() + 30, STILL, TRUSTED)
    expected = tisfm.interpret(*frames, camera=scene.camera, settings=settings)
    monkeypatch.setattr(module, "find_light_change", lambda *arguments: change)
    found = tisfm.interpret(*frames, camera=scene.camera, settings=settings)
    assert np.array_equal(found.depth, expected.depth, equal_nan=True)
