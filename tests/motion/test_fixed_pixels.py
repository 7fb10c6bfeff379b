"""Pixels of a pair that are fixed on the sensor."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import tisfm
import tisfm.pair as pair_module
from tests.rendered import static_scene
from tisfm.errors import InputError
from tisfm.motion import camera as camera_module
from tisfm.motion.fixed_pixels import find_fixed_pixels
from tisfm.running.pairs import PairWork
from tisfm.sources import FrameSource

HEIGHT, WIDTH = 96, 128


def grain(seed=0):
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return (120 + 50 * smooth / smooth.std()).astype(np.float32)


def found(speed, turn, place):
    """Return the fixed pixels of frames that move by `speed`, px, except at a place.

    `turn` is the part of the motion that a turn of the camera about its vertical axis explains.
    """
    scene = grain(1)
    moved = np.roll(scene, speed, axis=1)
    for frame in (scene, moved):
        frame[place] = grain(2)[place]
    flow = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    flow[..., 0] = speed
    flow[place] = 0
    camera = tisfm.Camera(focal=500.0)
    rotation = cv2.Rodrigues(np.array([0, turn / camera.focal, 0]))[0]
    return find_fixed_pixels(scene, moved, camera, rotation, np.array([1.0, 0, 0]), flow, 0.05)


BONNET = np.s_[70:, :]
LOGO = np.s_[10:30, 80:120]


@pytest.mark.parametrize(("turn", "place"), [(2, BONNET), (2, LOGO), (0, BONNET)])
def test_a_bonnet_and_a_logo_are_found(turn, place):
    mask, covered = found(4, turn, place), np.zeros((HEIGHT, WIDTH), bool)
    covered[place] = True
    assert mask[covered].mean() > 0.95 and mask[~covered].mean() < 0.15


def test_far_points_stay_if_the_camera_only_translates():
    assert found(4, 0, LOGO) is None and found(4, 0, np.s_[:30, :]) is None


def test_nothing_is_fixed_without_an_overlay_or_without_motion():
    nothing = np.s_[:0, :0]
    assert found(4, 2, nothing) is None and found(0, 2, nothing) is None


def test_a_pair_with_a_bonnet():
    scene = static_scene("sideways+rotation", 120, 160)
    frames = [np.array(frame) for frame in (scene.frame0, scene.frame1)]
    bonnet = np.random.default_rng(0).integers(40, 160, (30, 160))
    for frame in frames:
        frame[90:] = cv2.blur(bonnet.astype(np.float32), (3, 3))
    settings = tisfm.Settings.preset("fast", motion="camera")

    def result(**options):
        return tisfm.interpret(*frames, camera=scene.camera, settings=settings, **options)

    masked = result()
    assert "fixed on the sensor" in masked.status.message
    assert np.isinf(masked.inverse_depth_std[95:]).mean() > 0.95
    assert np.isinf(masked.inverse_depth_std[:80]).mean() < 0.2
    assert "fixed" not in result(fixed_pixels="keep").status.message
    with pytest.raises(InputError, match="fixed_pixels is 'yes'"):
        result(fixed_pixels="yes")


def test_a_sequence_and_a_run_keep_fixed_pixels_if_asked(monkeypatch):
    """The word reaches every pair, with and without masks and a window of three frames."""
    words = []

    def interpret(frame0, frame1, *, fixed_pixels, **options):
        words.append(fixed_pixels)
        return two_frames

    frames = [static_scene("sideways", 30, 40).frame0] * 3
    camera, settings = tisfm.Camera(40.0), tisfm.Settings.preset("fast")
    two_frames = tisfm.interpret(*frames[:2], camera=camera, settings=settings)
    for name in ("interpret", "interpret_pair"):
        monkeypatch.setattr(pair_module, name, interpret)
    options = {"camera": camera, "settings": settings}
    for extra in ({}, {"mask": np.eye(30, 40) == 0}, {"window": 3}):
        list(tisfm.interpret_sequence(frames, fixed_pixels="keep", **options, **extra))
    assert words == ["keep"] * 6
    (pair, _) = FrameSource(frames)
    PairWork(**options, fixed_pixels="keep").interpret(pair)
    PairWork(**options).interpret(pair)
    assert words[6:] == ["keep", "mask"]
    with pytest.raises(InputError, match="fixed_pixels is 'yes'"):
        tisfm.interpret_sequence(frames, fixed_pixels="yes")


def test_a_grey_logo_under_changing_light_is_found():
    scene = static_scene("sideways+rotation", 120, 160)
    logo = cv2.blur(np.random.default_rng(0).integers(20, 220, (30, 50)).astype(np.float32), (3, 3))
    frames = [np.array(scene.frame0), np.clip(scene.frame1.astype(int) + 40, 0, 255)]
    for frame in frames:
        frame[10:40, 90:140] = logo
    settings = tisfm.Settings.preset("fast", motion="camera")
    found = tisfm.interpret(
        frames[0], frames[1].astype(np.uint8), camera=scene.camera, settings=settings
    )
    assert "fixed on the sensor" in found.status.message
    assert np.isinf(found.inverse_depth_std[15:35, 95:135]).mean() > 0.95


def test_frames_that_are_resampled_are_not_searched(monkeypatch):
    calls = []
    monkeypatch.setattr(camera_module, "find_fixed_pixels", lambda *frames: calls.append(frames))
    scene = static_scene("sideways+rotation", 60, 80)
    settings = tisfm.Settings.preset("fast", motion="camera")
    lens = (-0.05, 0.0, 0.0, 0.0)
    for changes in ({}, {"distortion": lens, "readout": 0.002}):
        calls.clear()
        camera = replace(scene.camera, **changes)
        tisfm.interpret(scene.frame0, scene.frame1, camera=camera, settings=settings)
        assert bool(calls) == (not changes)
