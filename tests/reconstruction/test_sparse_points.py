"""Points of tracks with known poses."""

import numpy as np

from tests.reconstruction.films import along
from tisfm import Camera
from tisfm.reconstruction.tracks import triangulation as sparse_points
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import (
    TrackPoints,
    points_of_tracks,
    track_depths,
    triangulate_tracks,
)

CAMERA, SHAPE = Camera(focal=200.0), (120, 160)


def seen_by(poses, points, noise=0.0, seed=0):
    random = np.random.default_rng(seed)
    frames = []
    for pose in poses:
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        places = local[:, :2] / local[:, 2:] * CAMERA.focal + CAMERA.center_for(*SHAPE)
        places += noise * random.standard_normal(places.shape)
        frames.append(Observations(points=places, tracks=np.arange(len(points))))
    return frames


def points_ahead(count=40, seed=2):
    random = np.random.default_rng(seed)
    return random.uniform((-1, -0.7, 3), (1, 0.7, 6), (count, 3))


def test_exact_rays_meet_in_their_points():
    poses, points = along(5), points_ahead()
    found = triangulate_tracks(seen_by(poses, points), dict(enumerate(poses)), CAMERA, SHAPE)
    assert sorted(found) == list(range(len(points)))
    np.testing.assert_allclose([found[k] for k in sorted(found)], points, atol=1e-9)


def test_noise_moves_them_little():
    poses, points = along(9), points_ahead()
    found = triangulate_tracks(
        seen_by(poses, points, noise=0.3), dict(enumerate(poses)), CAMERA, SHAPE
    )
    depth = np.array([found[k][2] / points[k, 2] for k in found])
    assert len(found) > 30 and np.median(np.abs(depth - 1)) < 0.05


def test_points_without_a_ray_are_left_out():
    poses, points = along(5), points_ahead()
    seen = seen_by(poses, points)
    far = [0]  # a track that jumps
    for k, frame in enumerate(seen):
        frame.points[far] += 40 * (k % 2)
    found = triangulate_tracks(seen, dict(enumerate(poses)), CAMERA, SHAPE)
    assert 0 not in found and 1 in found
    still = triangulate_tracks(seen[:1] * 3, dict.fromkeys(range(3), poses[0]), CAMERA, SHAPE)
    assert still == {}
    assert triangulate_tracks(seen, {}, CAMERA, SHAPE) == {}


def test_rays_that_meet_behind_the_camera_have_no_point():
    poses, behind = along(5), points_ahead() * (1, 1, -1)
    assert triangulate_tracks(seen_by(poses, behind), dict(enumerate(poses)), CAMERA, SHAPE) == {}


def test_depths_are_those_before_the_camera():
    poses, points = along(5), points_ahead()
    seen = seen_by(poses, points)
    known = {k: points[k] for k in range(10)} | {11: np.array([0.0, 0.0, -5.0])}
    places, depth = track_depths(seen[2], known, poses[2])
    expected = ((points[:10] - poses[2, :3, 3]) @ poses[2, :3, :3])[:, 2]
    np.testing.assert_allclose(depth, expected)
    np.testing.assert_allclose(places, seen[2].points[:10])


def test_points_in_batches_equal_those_at_once(monkeypatch):
    poses, points = along(9), points_ahead()
    seen = seen_by(poses, points, noise=0.3)
    whole = triangulate_tracks(seen, dict(enumerate(poses)), CAMERA, SHAPE)
    monkeypatch.setattr(sparse_points, "MAX_OBSERVATIONS", 50)
    batched = triangulate_tracks(seen, dict(enumerate(poses)), CAMERA, SHAPE)
    assert len(list(sparse_points._batches(seen, dict(enumerate(poses))))) > 5
    np.testing.assert_array_equal(batched.tracks, whole.tracks)
    np.testing.assert_allclose(batched.positions, whole.positions, rtol=1e-12)


def test_points_of_tracks_are_a_mapping():
    points = {7: np.array([1.0, 2.0, 3.0]), 2: np.array([0.0, 1.0, 0.0])}
    found = TrackPoints.from_mapping(points)
    assert list(found) == [2, 7] and 3 not in found and 8 not in found
    np.testing.assert_array_equal(found[7], points[7])
    both = found | TrackPoints.from_mapping({7: np.zeros(3), 1: np.ones(3)})
    assert list(both) == [1, 2, 7]
    np.testing.assert_array_equal(both[7], np.zeros(3))
    seen = Observations(points=np.arange(6.0).reshape(3, 2), tracks=np.array([1, 2, 9]))
    for one in (found, points):
        index, positions = points_of_tracks(seen, one)
        np.testing.assert_array_equal(index, [1])
        np.testing.assert_array_equal(positions, [points[2]])
