"""motion="camera": one rigid motion and inverse depth, on scenes with exact truth."""

import dataclasses
import warnings

import cv2
import numpy as np
import pytest

import tisfm
from bench.reference import flow as flow_of
from bench.reference import motion_matrix
from tests.draws import nightly_except
from tests.motion.one_motion import CAMERA, SIZE, errors, interpreted, shared
from tests.rendered import static_scene, two_blocks
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.metrics import depth_errors, endpoint_error
from tisfm.rigid import pose_matrix
from tisfm.scenes import STATIC_KINDS


@pytest.fixture(
    scope="module", params=nightly_except("sideways", "forward+rotation", of=STATIC_KINDS)
)
def scene(request):
    return static_scene(request.param, seed=11)


@pytest.fixture(scope="module")
def result(scene):
    return shared(scene)


def test_depth_and_motion_of_static_scenes(result, scene):
    assert result.status == "converged"
    assert depth_errors(result.depth, scene.depth, mask=scene.visible).abs_rel < 0.013
    found = errors(result, scene)
    assert found.direction < 0.3 and found.rotation < 0.01
    assert endpoint_error(result.flow, scene.flow, mask=scene.visible) < 0.025


def test_depth_is_far_better_than_that_of_the_field(result, scene):
    field = shared(scene, tisfm.Settings())
    ours = depth_errors(result.depth, scene.depth, mask=scene.visible).abs_rel
    assert ours < 0.2 * depth_errors(field.depth, scene.depth, mask=scene.visible).abs_rel
    assert field.motions is None and field.labels is None and field.inverse_depth_std is None


def test_rho_is_the_field_of_the_flow(result, scene):
    height, width = scene.depth.shape
    expected = flow_of(motion_matrix(scene.camera, height, width, 6), result.rho.astype(float))
    np.testing.assert_allclose(np.moveaxis(result.flow, -1, 0), expected, atol=2e-5)
    # To first order in the motion, it is the field of the twist.
    first_order = result.motions[0][:3, None, None] * result.inverse_depth
    assert np.abs(result.tau - first_order).max() * scene.camera.focal < 0.6
    np.testing.assert_allclose(result.tau[2], first_order[2], atol=1e-7)
    spin = np.broadcast_to(result.motions[0][3:, None, None], result.omega.shape)
    np.testing.assert_allclose(result.omega, spin, atol=1e-7)


def test_motion_has_length_one_and_depth_is_in_its_unit(result, scene):
    assert np.linalg.norm(result.motions[0][:3]) == pytest.approx(1)
    assert result.motions.shape == (1, 6) and result.motions.dtype == np.float64
    assert not result.labels.any() and result.labels.dtype == np.int32
    true_length = np.linalg.norm(scene.motions[0][:3])
    ratio = result.depth * true_length / scene.depth
    assert np.median(ratio[scene.visible]) == pytest.approx(1, abs=0.05)


def test_about_two_thirds_lie_within_one_deviation(result, scene):
    truth = 1 / scene.depth
    visible = scene.visible
    scale = np.median(truth[visible]) / np.median(result.inverse_depth[visible])
    off = np.abs(result.inverse_depth - truth / scale)[visible]
    assert 0.55 < (off < result.inverse_depth_std[visible]).mean() < 0.85
    # Deviations differ between pixels: the half with the smaller ones has smaller errors.
    sure = result.inverse_depth_std < np.median(result.inverse_depth_std)
    assert off[sure[visible]].mean() < 0.7 * off[~sure[visible]].mean()


def test_noise_widens_the_deviation(small):
    rng = np.random.default_rng(0)
    noisy = [
        np.clip(frame + rng.normal(scale=4, size=SIZE), 0, 255).astype(np.uint8)
        for frame in (small.frame0, small.frame1)
    ]
    quiet = interpreted(small)
    loud = tisfm.interpret(*noisy, camera=small.camera, settings=CAMERA)
    assert np.median(loud.inverse_depth_std) > 2 * np.median(quiet.inverse_depth_std)


@pytest.mark.parametrize(
    ("preset", "model"),
    [
        pytest.param("paper", "rigid", marks=pytest.mark.nightly),
        ("fast", "translation"),
        pytest.param("balanced", "translation", marks=pytest.mark.nightly),
        ("accurate", "rigid"),
    ],
)
def test_every_preset_and_model(preset, model):
    scene = static_scene("sideways", *SIZE, seed=2)  # at most a pixel of motion, for a single scale
    found = interpreted(scene, tisfm.Settings.preset(preset, motion="camera", model=model))
    limit = 0.03 if preset != "paper" else 0.15
    assert depth_errors(found.depth, scene.depth, mask=scene.visible).abs_rel < limit


@pytest.mark.parametrize("focal", nightly_except(600.0, of=[150.0, 600.0]))
def test_focal_lengths(focal):
    scene = static_scene("forward+rotation", *SIZE, seed=1, focal=focal)
    result = interpreted(scene)
    assert depth_errors(result.depth, scene.depth, mask=scene.visible).abs_rel < 0.03
    assert errors(result, scene).direction < 1.5


def test_colour_and_sixteen_bits(small):
    colour = [np.repeat(f[..., None].astype(np.uint16) * 257, 3, axis=-1) for f in
              (small.frame0, small.frame1)]  # fmt: skip
    result = tisfm.interpret(*colour, camera=small.camera, settings=CAMERA)
    np.testing.assert_allclose(result.motions, interpreted(small).motions, atol=2e-4)


def test_the_background_of_moving_blocks():
    """Most of the image is static, so its motion is found although two blocks move."""
    pair = two_blocks(240, 320, seed=1)
    result = interpreted(pair)
    assert errors(result, pair).direction < 1.5
    static = pair.visible & (pair.labels < 2)
    away = cv2.erode(static.astype(np.uint8), np.ones((15, 15))) > 0
    assert depth_errors(result.depth, pair.depth, mask=away).abs_rel < 0.03


def test_same_bits_twice_and_frames_untouched(small):
    frames = small.frame0.copy(), small.frame1.copy()
    first, second = (
        tisfm.interpret(*frames, camera=small.camera, settings=CAMERA) for _ in range(2)
    )
    np.testing.assert_array_equal(first.inverse_depth, second.inverse_depth)
    np.testing.assert_array_equal(first.motions, second.motions)
    np.testing.assert_array_equal(frames[0], small.frame0)


def test_energy_never_rises_within_a_warp(small):
    settings = dataclasses.replace(CAMERA, tolerance=0.0, outer_iterations=12)
    history = interpreted(small, settings).history
    for level in np.unique(history.level):
        for warp in np.unique(history.warp[history.level == level]):
            energy = history.energy[(history.level == level) & (history.warp == warp)]
            assert len(energy) == 12
            assert np.all(np.diff(energy) <= 1e-6 * energy[:-1])


@pytest.mark.parametrize("size", [(31, 47), (64, 17), (20, 20)])
def test_odd_and_small_sizes(size):
    scene = static_scene("forward", *size, seed=0)
    result = interpreted(scene)
    assert result.inverse_depth.shape == size
    assert np.isfinite(result.inverse_depth).all() and np.isfinite(result.flow).all()


def test_the_focal_length_is_guessed_with_a_warning(small):
    with pytest.warns(GuessedFocalWarning, match="192"):
        result = tisfm.interpret(small.frame0, small.frame1, settings=CAMERA)
    assert result.camera.focal == 1.2 * SIZE[1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tisfm.interpret(small.frame0, small.frame1)


def test_saved_and_loaded(small, tmp_path):
    result = interpreted(small)
    result.save(tmp_path / "pair.npz")
    again = tisfm.Interpretation.load(tmp_path / "pair.npz")
    for name in ("motions", "labels", "inverse_depth", "inverse_depth_std", "depth"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    assert again.settings == result.settings and again.status == result.status


def test_points_lie_on_the_surfaces(small):
    pose = pose_matrix(small.motions[0])
    result = interpreted(small, pose=pose)
    cloud = result.points(min_confidence=0.3)
    assert 0.5 * small.depth.size < len(cloud) <= small.depth.size
    near, far = np.quantile(cloud.positions[:, 2], [0.01, 0.99])
    assert near > 0.9 * small.depth.min() and far < 1.1 * small.depth.max()
