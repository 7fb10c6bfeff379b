"""Share of the frames that a model explains; it decides which motion is that of the world."""

from types import SimpleNamespace

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import board_film, path_error
from tisfm.reconstruction.mapping.database import colmap_camera, pycolmap
from tisfm.reconstruction.mapping.model_scores import Coverage, grid_points
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View
from tisfm.rigid import pose_matrix

SHAPE = (120, 160)
CAMERA = tisfm.Camera(focal=140.0)
MOTION = np.linalg.inv(pose_matrix((0.2, 0.05, 0.1, 0.01, -0.02, 0.005)))[:3]  # world to camera
OTHER = np.linalg.inv(pose_matrix((-0.1, 0.2, 0.0, -0.02, 0.01, 0.0)))[:3]


def projected(points, motion):
    """Return the positions of points, (N, 3), in a frame after a motion, (3, 4); px."""
    local = points @ motion[:, :3].T + motion[:, 3]
    return CAMERA.focal * local[:, :2] / local[:, 2:] + CAMERA.center_for(*SHAPE)


def points_seen(random, low, high, count):
    """Return points that the first camera sees between two columns, (N, 3)."""
    u, v = random.uniform(low, high, count), random.uniform(10, 110, count)
    z = random.uniform(1.5, 4, count)
    x, y = (np.stack([u, v], axis=1) - CAMERA.center_for(*SHAPE)).T / CAMERA.focal
    return np.stack([z * x, z * y, z], axis=1)


def view_of(frame, points):
    """Return a view with tracks and without detected points."""
    tracks = np.arange(len(points), dtype=np.int64)
    return View(
        frame=frame,
        observations=Observations(points=points, tracks=tracks),
        detected=np.empty((0, 2)),
    )


def model_of(*motions):
    """Return a model of a first view, and of further views with these motions."""
    poses = dict(enumerate((np.eye(4)[:3], *motions), start=1))
    images = {
        number: SimpleNamespace(cam_from_world=lambda pose=pose: pycolmap().Rigid3d(pose))
        for number, pose in poses.items()
    }
    return SimpleNamespace(
        cameras={1: colmap_camera(CAMERA, SHAPE)}, images=images, reg_image_ids=lambda: list(images)
    )


@pytest.fixture
def crowd():
    """Return the coverage of 150 moving points at the left, and 30 points at rest elsewhere."""
    random = np.random.default_rng(0)
    thing, world = points_seen(random, 10, 50, 150), points_seen(random, 60, 150, 30)
    before = np.vstack([projected(thing, np.eye(4)[:3]), projected(world, np.eye(4)[:3])])
    after = np.vstack([projected(thing, OTHER), projected(world, MOTION)])
    same = np.arange(len(before))
    pairs = {(0, 1): np.stack([same, same], axis=1)}
    return Coverage([view_of(0, before), view_of(1, after)], pairs, SHAPE)


def test_model_explains_matches_on_its_epipolar_lines(crowd):
    of_world = crowd.explained_matches([model_of(MOTION)])[0, 1]
    of_thing = crowd.explained_matches([model_of(OTHER)])[0, 1]
    assert of_world[150:].all() and of_thing[:150].all()
    assert of_world[:150].mean() < 0.4 and of_thing[150:].mean() < 0.4


def test_area_counts_and_not_the_number_of_points(crowd):
    of_world = crowd.explained_matches([model_of(MOTION)])
    of_thing = crowd.explained_matches([model_of(OTHER)])
    assert of_thing[0, 1].sum() > 2 * of_world[0, 1].sum()
    assert crowd.explained_area(of_world) > 1.3 * crowd.explained_area(of_thing)


def test_shares_are_those_of_the_nearest_points():
    random = np.random.default_rng(1)
    points = random.uniform(0, 100, (9, 2))
    pairs = {(0, 1): np.array([[0, 0], [2, 2], [5, 5], [8, 8]])}
    cover = Coverage([view_of(0, points), view_of(1, points)], pairs, (100, 130))
    places = grid_points((100, 130))
    distance = np.linalg.norm(places[:, None] - points[None, [0, 2, 5, 8]], axis=-1)
    expected = np.bincount(distance.argmin(axis=1), minlength=4) / len(places)
    for k in range(4):
        assert cover.explained_area({(0, 1): np.arange(4) == k}) == pytest.approx(expected[k])
    assert cover.explained_area({(0, 1): np.ones(4, bool)}) == pytest.approx(1)


def test_grid_points_are_the_middles_of_equal_squares():
    points = grid_points((90, 120))
    np.testing.assert_allclose(points.mean(axis=0), (119 / 2, 89 / 2))
    for positions, length in zip(points.T, (120, 90), strict=True):
        across = np.unique(positions)
        np.testing.assert_allclose(np.diff(across), length / len(across))


def test_no_matches_give_no_coverage():
    assert Coverage([], {}, SHAPE).explained_area({}) == 0
    points = np.empty((0, 2))
    pairs = {(0, 1): np.empty((0, 2), np.int32)}
    cover = Coverage([view_of(0, points), view_of(1, points)], pairs, SHAPE)
    assert cover.explained_area(cover.explained_matches([])) == 0
    assert cover.explained_area(cover.explained_matches([model_of(MOTION)])) == 0


def test_pairs_across_pieces_do_not_count():
    points = np.random.default_rng(2).uniform(10, 110, (20, 2))
    same = np.stack([np.arange(20)] * 2, axis=1)
    views = [view_of(k, points) for k in range(4)]
    cover = Coverage(views, {(0, 1): same, (1, 2): same, (0, 3): same}, SHAPE)
    first, second = model_of(MOTION), model_of(MOTION)
    second.images = {number + 2: image for number, image in second.images.items()}
    second.reg_image_ids = lambda: list(second.images)
    assert set(cover.explained_matches([first, second])) == {(0, 1)}
    assert set(cover.explained_matches([first])) == {(0, 1), (1, 2), (0, 3)}
    assert not cover.explained_matches([first])[1, 2].any()


def test_moving_board_in_a_third_of_the_frames_is_not_the_static_scene():
    film, board = board_film()
    assert 0.3 < board.mean() < 0.4
    alone, _ = board_film(with_board=False)
    errors = [
        path_error(
            tisfm.reconstruct(
                list(one.frames),
                camera=tisfm.Camera(focal=one.camera.focal, readout=0.0),
                depth_of="none",
                settings=tisfm.Settings.preset("fast", motion="camera"),
            ).poses,
            one.poses,
        )
        for one in (film, alone)
    ]
    # Measured: 0.006 with the board, and 0.0025 without.
    assert errors[0] < 0.01 and errors[1] < 0.005
