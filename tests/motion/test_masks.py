"""Masks: masked pixels do not affect motion and depth."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.motion.one_motion import CAMERA, OBJECTS, errors, interpreted
from tests.rendered import room, static_scene, three_blocks, two_blocks
from tisfm.metrics import depth_errors, endpoint_error

SIZE = (192, 256)
FIELD = tisfm.Settings()


def covered(scene, seed=0):
    """Return a scene with a logo and a bonnet of noise at fixed positions, and the mask of both."""
    height, width = scene.depth.shape
    rows, columns = np.mgrid[:height, :width]
    mask = rows < (0.82 + 0.06 * np.cos(6 * columns / width)) * height
    mask[height // 10 : height // 4, width // 12 : width // 3] = False
    noise = np.random.default_rng(seed).integers(0, 255, (height, width), np.uint8)
    frames = [np.where(mask, frame, noise) for frame in (scene.frame0, scene.frame1)]
    return replace(scene, frame0=frames[0], frame1=frames[1]), mask


def flow_error(result, scene, seen):
    return endpoint_error(result.flow, scene.flow, mask=seen)


def depth_error(result, scene, seen):
    return depth_errors(result.depth, scene.depth, mask=seen).abs_rel


def same(one, other):
    names = ("rho", "flow", "inverse_depth", "confidence", "occlusion")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


@pytest.mark.parametrize(
    ("render", "settings", "harms"),
    [
        (lambda: static_scene("forward", *SIZE), FIELD, {flow_error: 1.6}),
        (lambda: static_scene("forward", *SIZE), CAMERA, {flow_error: 1.6, depth_error: 3.0}),
        pytest.param(lambda: room(*SIZE), CAMERA, {depth_error: 10.0}, marks=pytest.mark.nightly),
        pytest.param(  # measured: 1.60
            lambda: two_blocks(60, 80, seed=2),
            OBJECTS,
            {flow_error: 1.5},
            marks=pytest.mark.nightly,
        ),
    ],
    ids=["field", "camera", "bare_room", "objects"],
)
def test_visible_pixels_are_as_good_as_without_a_cover(render, settings, harms):
    """Without the mask, the cover multiplies the errors by `harms` at least."""
    scene = render()
    spoilt, mask = covered(scene)
    result = interpreted(spoilt, settings, mask=mask)
    seen = mask & scene.visible & ~result.occlusion
    assert seen.mean() > 0.6
    clean = interpreted(scene, settings)
    unmasked = interpreted(spoilt, settings, fixed_pixels="keep")
    for error, harm in harms.items():
        assert error(result, scene, seen) < 1.3 * error(clean, scene, seen)
        assert error(unmasked, scene, seen) > harm * error(clean, scene, seen)
    # No bit of the result depends on the masked pixels.
    assert same(result, interpreted(scene, settings, mask=mask))


def test_the_pose_is_as_good_as_without_a_cover():
    scene = static_scene("sideways+rotation", *SIZE)
    spoilt, mask = covered(scene)
    clean, wrong = (
        errors(interpreted(pair, fixed_pixels="keep"), scene) for pair in (scene, spoilt)
    )
    found = errors(interpreted(spoilt, mask=mask), scene)
    assert found.direction < max(1.5 * clean.direction, 0.3)
    assert found.rotation < max(1.5 * clean.rotation, 0.01)
    assert wrong.direction > 2 * found.direction


@pytest.mark.nightly
def test_frames_far_apart():
    turned = (0.5, 0, 0.2, 0.03, 0.19, 0)
    scene = three_blocks(240, 320, camera_motion=turned, block_motions=np.zeros((3, 6)))
    spoilt, mask = covered(scene)
    result = interpreted(spoilt, mask=mask)
    found = errors(result, scene)
    assert result.status in ("converged", "iteration_limit")
    assert found.rotation < 0.3 and found.direction < 1.5
    assert same(result, interpreted(scene, mask=mask))


@pytest.mark.parametrize("settings", [FIELD, CAMERA], ids=["field", "camera"])
def test_ignored_pixels_are_not_trusted(settings):
    scene = static_scene("sideways", 120, 160)
    mask = np.ones((120, 160), bool)
    mask[40:80, 60:110] = False
    first = interpreted(scene, settings, mask=np.stack([mask, np.ones_like(mask)]))
    assert first.occlusion[~mask].all() and not first.confidence[~mask].any()
    assert np.isfinite(first.flow).all() and (first.confidence[mask] > 0).mean() > 0.8
    # Without data, smoothness continues the surroundings into the mask.
    inner = np.s_[50:70, 70:100]
    assert np.abs(first.flow - scene.flow)[inner].mean() < 0.25 * np.abs(scene.flow).mean()
    if settings.motion == "camera":
        assert np.isinf(first.inverse_depth_std[~mask]).all()
    # The mask of frame 1 hides the pixels that move to masked positions.
    second = interpreted(scene, settings, mask=np.stack([np.ones_like(mask), mask]))
    columns = np.arange(160) + np.rint(second.flow[..., 0]).astype(int)
    rows = np.arange(120)[:, None] + np.rint(second.flow[..., 1]).astype(int)
    to = ~mask[rows.clip(0, 119), columns.clip(0, 159)]
    assert second.occlusion[to].all() and not second.confidence[to].any()
    assert (second.occlusion != first.occlusion).any()


def test_masks_are_undistorted():
    scene = static_scene("sideways", 120, 160)
    camera = tisfm.Camera(focal=scene.camera.focal, distortion=(-0.2, 0.05, 0.0, 0.0))
    mask = np.ones((120, 160), bool)
    mask[:30] = False
    lens = tisfm.interpret(scene.frame0, scene.frame1, camera=camera, settings=CAMERA, mask=mask)
    rows = np.array([np.flatnonzero(~column)[0] for column in lens.occlusion.T[20:-20]])
    assert rows.max() > rows.min() > 10  # undistortion bends the edge of the mask


@pytest.mark.parametrize(
    "settings", nightly_except(FIELD, CAMERA, of=[FIELD, CAMERA, OBJECTS]), ids=lambda s: s.motion
)
def test_white_masks_are_none(settings):
    scene = two_blocks(64, 80)
    expected = interpreted(scene, settings)
    assert same(interpreted(scene, settings, mask=np.full((64, 80), 255, np.uint8)), expected)


def test_each_frame_may_have_a_mask():
    scene = static_scene("forward", 96, 128)
    mask = np.ones((96, 128), bool)
    mask[70:] = False
    expected = interpreted(scene, FIELD, mask=mask)
    assert same(interpreted(scene, FIELD, mask=[mask, mask]), expected)
    assert same(interpreted(scene, FIELD, mask=mask.astype(np.float32).tolist()), expected)
    first = interpreted(scene, FIELD, mask=np.stack([mask, np.ones_like(mask)]))
    second = interpreted(scene, FIELD, mask=[np.ones_like(mask), 200 * mask.astype(np.uint8)])
    assert not same(first, expected) and not same(second, expected) and not same(first, second)


def test_masks_are_left_as_they_are():
    scene = static_scene("forward", 64, 80)
    mask = np.ones((64, 80), np.uint8)
    mask[50:] = 0
    before = mask.copy()
    interpreted(scene, FIELD, mask=mask)
    np.testing.assert_array_equal(mask, before)


FRAME = np.random.default_rng(0).integers(0, 255, (24, 32), np.uint8)


@pytest.mark.parametrize(
    ("mask", "error", "words"),
    [
        (np.ones((24, 31)), ValueError, r"\(24, 31\): expected \(24, 32\)"),
        (np.ones((3, 24, 32)), ValueError, r"\(3, 24, 32\): expected .* \(2, 24, 32\)"),
        (np.ones(32), ValueError, r"\(32,\)"),
        (np.zeros((24, 32), bool), ValueError, "black at all pixels of frame0"),
        (np.stack([np.ones((24, 32)), np.zeros((24, 32))]), ValueError, "black.*frame1"),
        (np.full((24, 32), np.nan), ValueError, "NaN"),
        (np.full((24, 32), "x"), TypeError, "type <U1"),
        (np.ma.masked_equal(np.ones((24, 32)), 1), ValueError, "masked"),
        (7, ValueError, r"mask is \(\)"),
        ("logo.png", TypeError, "path 'logo.png'.*read_image"),
    ],
    ids=str,
)
def test_other_values_than_masks_are_refused(mask, error, words):
    with pytest.raises(error, match=words):
        tisfm.interpret(FRAME, FRAME[::-1], mask=mask)
