"""motion="objects" with a partly bare background: depth is interpolated around the objects."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.motion.one_motion import FAST_OBJECTS, interpreted, shared
from tests.motion.one_motion import OBJECTS as BALANCED
from tests.rendered import room, two_blocks
from tisfm.formats import read_image
from tisfm.motion.objects import depth as object_depth
from tisfm.motion.objects import estimation
from tisfm.motion.objects.depth import carry_background_depth
from tisfm.motion.objects.layers import Layering
from tisfm.motion.objects.settings import OBJECTS
from tisfm.motion.problems import pyramid_of
from tisfm.motion.rigid_depth import rigid_depth, scaled_translations
from tisfm.motion.settings import DEPTH
from tisfm.motion.textureless_depth import textureless_depth
from tisfm.motion.window_statistics import window_variance
from tisfm.rigid import rigid_motion

SIZE = (240, 320)
OBJECT = (slice(110, 180), slice(120, 210))  # in frame 0
MOVED = (-6, 5)  # px/frame: left and down
CAMERA_MOTION = (0.18, 0.0, 0.12, 0.003, 0.01, 0.006)


def pasted(frame, thing, move, rng):
    """Return a frame with an object, with noise, in front."""
    rows, columns = (slice(s.start + by, s.stop + by) for s, by in zip(OBJECT, move, strict=True))
    frame = frame.astype(np.float32)
    frame[rows, columns] = thing + 1.5 * rng.standard_normal(thing.shape)
    return np.rint(frame.clip(0, 255)).astype(np.uint8)


def with_object(move):
    """Return a bare room with a textured object in front, which moves on its own."""
    bare = room(*SIZE, seed=5, camera_motion=CAMERA_MOTION)
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.standard_normal((70, 90)), (0, 0), 1.5)
    thing = 120 + 35 * texture / texture.std()
    labels = np.zeros(SIZE, np.int32)
    labels[OBJECT] = 1
    return replace(
        bare,
        frame0=pasted(bare.frame0, thing, (0, 0), rng),
        frame1=pasted(bare.frame1, thing, move[::-1], rng),
        labels=labels,
    )


@pytest.fixture(scope="module")
def scene():
    return with_object(MOVED)


@pytest.fixture(scope="module")
def carried(scene):
    return shared(scene, BALANCED)


def background_error(result, scene):
    """Return the mean |s·Z − true|/true of the background; s is the median of the ratio true/Z."""
    mine = (result.labels == 0) & (scene.labels == 0)
    depth, true = 1 / np.maximum(result.inverse_depth[mine], 1e-9), scene.depth[mine]
    return np.mean(np.abs(depth * np.median(true / depth) - true) / true)


def test_depth_of_the_background(carried, scene, monkeypatch):
    """Interpolation improves the background and leaves the object as it is."""
    # No share is above 2: depth is never interpolated.
    monkeypatch.setattr(object_depth, "DEPTH", replace(DEPTH, min_textureless_share=2.0))
    uncarried = interpreted(scene, BALANCED)
    assert carried.status == "converged"
    assert background_error(carried, scene) < 0.055
    assert background_error(carried, scene) < 0.8 * background_error(uncarried, scene)
    np.testing.assert_array_equal(carried.labels, uncarried.labels)
    mine = carried.labels > 0
    np.testing.assert_array_equal(carried.inverse_depth[mine], uncarried.inverse_depth[mine])
    np.testing.assert_array_equal(carried.flow[mine], uncarried.flow[mine])
    np.testing.assert_array_equal(carried.motions[1:], uncarried.motions[1:])


def test_label_and_motion_of_the_object(carried, scene):
    found = carried.labels == carried.labels[145, 165]
    assert not (found & (carried.labels == 0)).any()
    assert found[OBJECT].mean() > 0.95
    moved = np.median(carried.flow[scene.labels == 1], axis=0)
    np.testing.assert_allclose(moved, MOVED, atol=0.2)


@pytest.mark.parametrize("preset", nightly_except("balanced", of=["fast", "balanced"]))
def test_deviation_and_confidence_of_interpolated_depth(scene, carried, preset):
    """With `fast`, depth is interpolated on a coarser level than that of the labels."""
    result = carried if preset == "balanced" else interpreted(scene, FAST_OBJECTS)
    mine = (result.labels == 0) & (scene.labels == 0) & ~result.occlusion
    inverse = scene.depth[mine] * result.inverse_depth[mine]
    wrong = np.abs(inverse / np.median(inverse) - 1)
    relative = (result.inverse_depth_std / result.inverse_depth)[mine]
    assert np.isfinite(relative).all() and (relative > 0).all()
    surest = relative <= np.quantile(relative, 0.4)
    assert wrong[surest].mean() < 0.9 * wrong.mean()
    confident = result.confidence[mine] > 0.5
    assert 0.1 < confident.mean() < 0.9
    assert wrong[confident].mean() < wrong.mean()


@pytest.mark.nightly
def test_depth_of_textured_scenes_is_not_interpolated(monkeypatch):
    def never(*_, **__):
        raise AssertionError("depth is interpolated")

    scene = two_blocks(60, 80, seed=2)
    monkeypatch.setattr(object_depth, "textureless_depth", never)
    result = interpreted(scene, BALANCED)
    monkeypatch.setattr(estimation, "carry_background_depth", lambda *_: None)
    without = interpreted(scene, BALANCED)
    np.testing.assert_array_equal(result.inverse_depth, without.inverse_depth)
    np.testing.assert_array_equal(result.labels, without.labels)


def solved(scene, labels):
    """Return the input of the interpolation: pyramid, settings, solution, labels and motion."""
    frames = (frame.astype(np.float32) for frame in (scene.frame0, scene.frame1))
    pyramid = pyramid_of(*frames, scene.camera, BALANCED)
    motion = np.column_stack(rigid_motion(scene.motions[0]))
    motions = scaled_translations(np.stack([motion, motion]), labels, scene.camera)
    return pyramid, BALANCED, rigid_depth(pyramid, BALANCED, motions, labels), labels, motion


def test_an_object_does_not_change_depth_behind_it():
    """The object moves along the background's epipolar lines, and so looks like a near point."""
    scene = with_object((-20, 0))
    labels = scene.labels
    body, near, close = (
        cv2.dilate(labels.astype(np.uint8), np.ones((window, window), np.uint8)) > 0
        for window in (1, 51, OBJECTS.background_rim)
    )
    beside = near & ~close
    pyramid, settings, solution, _, motion = solved(scene, labels)
    found = carry_background_depth(pyramid, settings, solution, labels, motion)
    motion = scaled_translations(motion[None], labels, scene.camera)[0]
    behind = textureless_depth(pyramid, settings, motion, support=~close)
    misled = textureless_depth(pyramid, settings, motion)

    def off(solution, where):
        ratio = solution.inverse_depth * scene.depth
        return np.abs(ratio / np.median(ratio[~near]) - 1)[where].mean()

    np.testing.assert_array_equal(found.motions[0], motion)
    assert off(found, beside) < 0.8 * off(misled, beside)
    assert off(behind, body) < 0.4 * off(misled, body)


@pytest.mark.nightly
def test_a_limit_of_iterations_is_reported(scene):
    pyramid, settings, solution, labels, motion = solved(scene, scene.labels)
    limited = replace(solution, converged=False)
    found = carry_background_depth(pyramid, settings, limited, labels, motion)
    assert found is not None
    assert not found.converged and found.is_limit_adjustable
    assert found.history[-1] == solution.history[-1]
    found = carry_background_depth(pyramid, settings, solution, labels, motion)
    assert found.converged and found.history[0] == solution.history[0]
    assert len(found.history) > len(solution.history)


def test_too_little_parallax_is_not_interpolated(scene):
    pyramid, settings, solution, labels, motion = solved(scene, scene.labels)
    flat = replace(solution, inverse_depth=np.full(SIZE, 3, np.float32))
    assert carry_background_depth(pyramid, settings, flat, labels, motion) is None


@pytest.mark.parametrize(
    ("folder", "first"), [("tartanair", 2), pytest.param("hololens", 8, marks=pytest.mark.nightly)]
)
def test_bare_walls_at_rest_have_no_label_of_their_own(shared_data, folder, first):
    """Noise in bare windows fits two motions; their edges fit the interpolated background."""
    focal, _, *center = np.loadtxt(shared_data / folder / "camera.txt", skiprows=1)
    files = sorted((shared_data / folder / "images").iterdir())
    result = tisfm.interpret(
        read_image(files[first]),
        read_image(files[first + 1]),
        camera=tisfm.Camera(focal=focal, center=tuple(center)),
        settings=BALANCED,
    )
    assert result.status == "converged"
    assert not result.labels.any()


def test_bare_windows_support_a_label_little(scene):
    """Only windows with more than noise support a label."""
    frames = (frame.astype(np.float32) for frame in (scene.frame0, scene.frame1))
    pyramid = pyramid_of(*frames, scene.camera, BALANCED)
    layering = Layering(pyramid, BALANCED, pyramid.frames0[0])
    varied = window_variance(pyramid.frames0[0], 11)
    shown = {
        name: layering._gain_ratio(np.ones(SIZE, np.float32), mine)
        for name, mine in (
            ("bare", varied < np.quantile(varied, 0.3)),
            ("object", scene.labels == 1),
        )
    }
    assert shown["bare"] < 0.1 / OBJECTS.min_pixel_gain
    assert 0.8 / OBJECTS.min_pixel_gain < shown["object"] <= 1 / OBJECTS.min_pixel_gain
