"""Points nearest to where frames see them."""

import numpy as np
import pytest

from tests.exports.exported import predicted
from tisfm.camera import Camera
from tisfm.exports import observations
from tisfm.exports.guided_matching import PosedCamera
from tisfm.exports.observations import consistent_points, triangulate
from tisfm.rigid import pose_matrix

SHAPE, CAMERA = (120, 160), Camera(focal=150.0)


def setting(count=5, step=(0.1, 0, 0.02, 0, 0.01, 0), seed=0, points=40):
    """Return poses, points, and where the poses see them."""
    random = np.random.default_rng(seed)
    poses = [
        PosedCamera(camera=CAMERA, matrix=pose_matrix(k * np.array(step))) for k in range(count)
    ]
    world = random.uniform((-1, -0.7, 3), (1, 0.7, 6), (points, 3))
    places = np.stack([predicted(world, pose, SHAPE) for pose in poses], axis=1)
    return poses, world, places


def test_exact_positions_give_the_points_from_any_start():
    poses, world, places = setting()
    begun = world * np.random.default_rng(1).uniform(0.8, 1.25, (len(world), 1))
    found = triangulate(places, poses, SHAPE, begun, np.full(len(world), 1.0))
    np.testing.assert_allclose(found.positions, world, atol=2e-3)
    assert np.nanmax(found.residual) < 0.02


def test_noise_is_spread_over_the_frames():
    poses, world, places = setting(count=8)
    noisy = places + np.random.default_rng(2).normal(scale=0.3, size=places.shape)
    found = triangulate(noisy, poses, SHAPE, world * 1.05, np.full(len(world), 0.5))
    assert np.median(np.linalg.norm(found.positions - world, axis=1)) < 0.06
    assert np.nanmedian(found.residual) < 0.5


def test_without_parallax_depth_is_unchanged():
    poses, world, places = setting(step=(0, 0, 0, 0.01, 0.02, 0))
    begun = 1.3 * world
    found = triangulate(places, poses, SHAPE, begun, np.full(len(world), 0.02))
    np.testing.assert_allclose(found.positions, begun, rtol=1e-4, atol=1e-3)


def test_one_wrong_position_is_dropped():
    poses, world, places = setting()
    places[7, 3] += (9, -4)
    kept, left, found = consistent_points(places, poses, SHAPE, world, np.full(len(world), 0.1), 3)
    assert kept.all() and np.isnan(left[7, 3]).all()
    assert np.isfinite(left).sum() == places.size - 2
    assert np.linalg.norm(found.positions[7] - world[7]) < 0.01


def test_points_that_too_few_frames_see_are_dropped():
    poses, world, places = setting()
    places[0, 2:] = np.nan  # two frames
    places[1, 0] = np.nan  # not where it begins
    places[2] += np.random.default_rng(3).uniform(-30, 30, places[2].shape)
    kept, left, _ = consistent_points(places, poses, SHAPE, world, np.full(len(world), 0.1), 3)
    assert not kept[:3].any() and kept[3:].all() and len(left) == kept.sum()
    kept, _, _ = consistent_points(places, poses, SHAPE, world, np.full(len(world), 0.1), 2)
    assert kept[0]


def test_points_behind_a_camera_are_dropped():
    poses, world, places = setting()
    kept, *_ = consistent_points(places, poses, SHAPE, -world, np.full(len(world), 0.1), 3)
    assert not kept.any()


@pytest.mark.parametrize("points", [0, 1])
def test_few_points(points):
    poses, world, places = setting(points=points)
    kept, left, found = consistent_points(places, poses, SHAPE, world, np.full(points, 0.1), 3)
    assert len(kept) == len(left) == len(found.positions) == points


def test_points_are_the_same_in_lots(monkeypatch):
    poses, world, places = setting(points=23)
    places[5, 2] += 7
    places[11, 1:] = np.nan
    whole = consistent_points(places, poses, SHAPE, world, np.full(23, 0.1), 3)
    monkeypatch.setattr(observations, "MAX_BATCH_OBSERVATIONS", 21)  # four points
    lots = consistent_points(places, poses, SHAPE, world, np.full(23, 0.1), 3)
    np.testing.assert_array_equal(lots[0], whole[0])
    np.testing.assert_array_equal(lots[1], whole[1])
    np.testing.assert_allclose(lots[2].positions, whole[2].positions, atol=1e-9)
    np.testing.assert_allclose(lots[2].residual, whole[2].residual, atol=1e-6)
