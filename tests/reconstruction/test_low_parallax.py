"""A turn of the camera without parallax: points that only it shows are deleted, the scale stays."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.rendered import room_film
from tisfm.reconstruction.mapping.parallax import LowParallaxFilter
from tisfm.reconstruction.path.path_solver import find_path
from tisfm.rigid import pose_matrix

GOING, TURNING = 7, 10  # frames


def model(places, tracks, *, depth=2.0):
    """Return a mapper, a model of views at positions and points by the views that see them."""
    deleted = []

    def delete(one):
        deleted.append(one)
        del points[one]
        for image in images.values():
            image.points2D = [seen for seen in image.points2D if seen.point3D_id != one]

    points = {
        one: SimpleNamespace(
            xyz=np.array([0.0, 0.0, depth]),
            track=SimpleNamespace(elements=[SimpleNamespace(image_id=k) for k in numbers]),
        )
        for one, numbers in tracks.items()
    }
    images = {}
    for number, place in places.items():
        pose = np.column_stack([np.eye(3), -np.array(place)])
        seen = [
            SimpleNamespace(point3D_id=one, has_point3D=lambda: True)
            for one, numbers in tracks.items()
            if number in numbers
        ]
        images[number] = SimpleNamespace(
            points2D=[SimpleNamespace(point3D_id=None, has_point3D=lambda: False), *seen],
            cam_from_world=lambda pose=pose: SimpleNamespace(matrix=lambda: pose),
            projection_center=lambda place=place: np.array(place),
        )
    mapper = SimpleNamespace(observation_manager=SimpleNamespace(delete_point3D=delete))
    return mapper, SimpleNamespace(images=images, points3D=points), deleted


PLACES = {1: (-0.5, 0.0, 0.0), 2: (0.0, 0.0, 0.0), 3: (0.01, 0.0, 0.0)}


def test_points_seen_from_one_position_are_deleted():
    mapper, found, deleted = model(PLACES, {10: (1, 2, 3), 11: (2, 3), 12: (1, 2)})
    low_parallax = LowParallaxFilter(mapper, found)
    low_parallax.delete_points(2)
    assert deleted == [11] and set(found.points3D) == {10, 12}
    low_parallax.delete_points(1)
    low_parallax.delete_points(3)
    assert deleted == [11]


def test_smallest_baseline_is_a_share_of_the_depth():
    for depth, gone in ((0.4, []), (0.6, [11])):
        mapper, found, deleted = model(PLACES, {11: (2, 3)}, depth=depth)
        LowParallaxFilter(mapper, found).delete_points(3)
        assert deleted == gone


def test_view_without_points_is_left_alone():
    mapper, found, deleted = model(PLACES, {12: (1, 2)})
    LowParallaxFilter(mapper, found).delete_points(3)
    assert deleted == []


def going_and_turning():
    """Return poses of a camera that moves sideways, turns on the spot, and moves on."""
    at = np.arange(GOING + TURNING + GOING)
    places = np.clip(at, 0, GOING - 1) + np.clip(at - GOING - TURNING + 1, 0, None)
    turns = 0.04 * (np.clip(at - GOING + 1, 0, TURNING) - TURNING / 2)
    poses = np.array([pose_matrix((0, 0, 0, 0, turn, 0)) for turn in turns])
    poses[:, :3, 3] = places[:, None] * np.array([0.06, 0, 0.035])
    return poses


@pytest.mark.nightly  # the tests above delete points of single models
@pytest.mark.parametrize(("textured", "most"), [(True, 0.02), (False, 0.2)])
def test_rotation_on_the_spot_keeps_the_scale(textured, most):
    film = room_film(going_and_turning(), 180, 240, samples=1, textured=textured)
    (piece,) = find_path(((frame, None, None) for frame in film.frames), film.camera).pieces
    assert len(piece.poses) == len(film.frames)
    steps = [np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
             for poses in (np.array(list(piece.poses.values())), film.poses)]  # fmt: skip
    before, after = (
        np.median(steps[0][part]) / np.median(steps[1][part])
        for part in (slice(0, GOING - 1), slice(GOING + TURNING, None))
    )
    assert abs(np.log(after / before)) < most
