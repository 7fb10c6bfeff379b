"""The film with moving bodies: its truth, what is seen when, and its options."""

import cv2
import numpy as np
import pytest

from tisfm.scenes import bodies_film, bodies_path, room_film

SIZE = 60, 80


@pytest.fixture(scope="module")
def film():
    return bodies_film(bodies_path(40), *SIZE, samples=1)


@pytest.fixture(scope="module")
def clean():
    return bodies_film(bodies_path(4), 120, 160, noise=0)


def points_of(film, number):
    """Return what each pixel of a frame sees, in the world, (3, H, W)."""
    height, width = film.depth[number].shape
    cx, cy = film.camera.center_for(height, width)
    y, x = np.mgrid[:height, :width]
    rays = np.stack([(x - cx) / film.camera.focal, (y - cy) / film.camera.focal, np.ones(x.shape)])
    pose = film.poses[number]
    return np.tensordot(pose[:3, :3], rays * film.depth[number], 1) + pose[:3, 3, None, None]


def in_body(film, number, body, points):
    """Return points of the world, (3, n), in a body's axes."""
    pose = film.body_poses[body, number]
    return pose[:3, :3].T @ (points - pose[:3, 3:])


def test_labelled_pixels_lie_on_the_faces_of_their_body(film):
    for number in (0, 11, 39):
        points = points_of(film, number)
        for body in range(3):
            on = film.labels[number] == body + 1
            inside = in_body(film, number, body, points[:, on])
            reach = np.abs(inside / (film.body_sizes[body] / 2)[:, None]).max(axis=0)
            np.testing.assert_allclose(reach, 1, atol=1e-5)  # depth is float32


def test_the_room_is_the_one_without_bodies(film):
    bare = room_film(bodies_path(2), *SIZE, samples=1, textured=True)
    none = bodies_film(bodies_path(2), *SIZE, samples=1, bodies=0)
    assert none.labels.max() == 0
    assert none.body_poses.shape == (0, 2, 4, 4) and none.body_sizes.shape == (0, 3)
    np.testing.assert_array_equal(none.frames, bare.frames)
    np.testing.assert_array_equal(none.depth, bare.depth)
    room = film.labels[:2] == 0
    np.testing.assert_array_equal(film.depth[:2][room], bare.depth[room])
    assert (film.depth[:2] <= bare.depth).all()


def test_rows_are_read_in_turn():
    """The middle row is that of the truth; bodies and camera go on above and below."""
    at_once, rolled = (
        bodies_film(bodies_path(3), *SIZE, samples=1, noise=0, readout=readout)
        for readout in (0.0, 0.9)
    )
    for name in ("depth", "labels", "poses", "body_poses"):
        np.testing.assert_array_equal(getattr(rolled, name), getattr(at_once, name))
    off = np.abs(rolled.frames[1].astype(float) - at_once.frames[1]).mean(axis=1)
    middle = SIZE[0] // 2
    assert off[middle - 2 : middle + 2].mean() < 0.3 * min(off[:6].mean(), off[-6:].mean())
    with pytest.raises(ValueError, match=r"readout is 1\.5: expected a number from -1 to 1"):
        bodies_film(bodies_path(2), *SIZE, readout=1.5)


def test_paint_goes_with_the_body(clean):
    frame, after = clean.frames[0].astype(np.float32), clean.frames[1].astype(np.float32)
    height, width = frame.shape
    center = np.array(clean.camera.center_for(height, width))[:, None]
    points = points_of(clean, 0)
    for body in range(3):
        mask = (clean.labels[0] == body + 1).astype(np.uint8)
        on = cv2.erode(mask, np.ones((5, 5), np.uint8)) > 0
        pose = clean.body_poses[body, 1]
        moved = pose[:3, :3] @ in_body(clean, 0, body, points[:, on]) + pose[:3, 3:]

        def grey_at(place, after=after, center=center):
            view = np.linalg.inv(clean.poses[1])
            seen = view[:3, :3] @ place + view[:3, 3:]
            x, y = (clean.camera.focal * seen[:2] / seen[2] + center).astype(np.float32)
            return cv2.remap(after, x[None], y[None], cv2.INTER_LINEAR)[0]

        off = np.abs(grey_at(moved) - frame[on]).mean()
        at_rest = np.abs(grey_at(points[:, on]) - frame[on]).mean()
        assert off < 2 and at_rest > 3 * off


def test_bodies_are_seen_at_first_and_pass_behind_each_other(film):
    share = np.array([(film.labels == label).mean(axis=(1, 2)) for label in (1, 2, 3)])
    assert (share[:, :3] > 0.018).all()  # all are seen at first
    assert (share > 0.015).mean() > 0.75  # and most of the time
    two = bodies_film(bodies_path(30), *SIZE, samples=1, bodies=2)
    assert (two.labels == 1).mean(axis=(1, 2)).min() > 0.04  # only the third comes before the first
    assert (two.labels == 2).mean(axis=(1, 2)).min() < 0.003  # which hides the second
    assert share[0, 30:].min() < 0.005  # the third hides the first
    assert (share[:, -1] > 0.018).all()  # all come out again


def test_bodies_move_against_the_room_and_turn(film):
    steps = np.linalg.norm(np.diff(film.body_poses[:, :, :3, 3], axis=1), axis=-1)
    assert (np.median(steps, axis=1) > 0.02).all() and steps.max() < 0.1
    for poses in film.body_poses:
        gram = poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1)
        np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-12)
        cosine = (np.trace(poses[0, :3, :3].T @ poses[-1, :3, :3]) - 1) / 2
        assert np.degrees(np.arccos(cosine)) > 45


def test_bodies_do_not_touch_each_other(film):
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 9)] * 3)).reshape(3, -1)
    for number in range(40):
        for body in range(3):
            pose = film.body_poses[body, number]
            points = pose[:3, :3] @ (grid * film.body_sizes[body][:, None]) + pose[:3, 3:]
            for other in {0, 1, 2} - {body}:
                inside = np.abs(in_body(film, number, other, points))
                assert not (inside < film.body_sizes[other][:, None] / 2).all(axis=0).any()


def test_fewer_bodies_leave_the_others_as_they_are(film):
    two = bodies_film(bodies_path(3), *SIZE, samples=1, bodies=2)
    np.testing.assert_array_equal(two.body_poses, film.body_poses[:2, :3])
    assert set(np.unique(two.labels)) == {0, 1, 2}


def test_the_same_film_twice_and_its_types():
    first, second = (bodies_film(bodies_path(2), 41, 53, seed=3) for _ in range(2))
    for name in ("frames", "depth", "labels", "poses", "body_poses", "body_sizes"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.frames.dtype == first.labels.dtype == np.uint8
    assert first.depth.dtype == np.float32 and first.depth.shape == (2, 41, 53)
    assert first.camera.focal == pytest.approx(0.6 * 53)


@pytest.mark.parametrize(
    "change",
    [
        {"bodies": 2},
        {"seed": 1},
        {"focal": 90.0},
        {"textured": False},
        {"noise": 0.0},
        {"samples": 1},
    ],
)
def test_every_option_changes_the_film(change):
    usual, other = (
        bodies_film(bodies_path(1), 48, 64),
        bodies_film(bodies_path(1), 48, 64, **change),
    )
    assert (usual.frames != other.frames).any()


def test_the_camera_goes_and_comes_back():
    path = bodies_path(81)
    np.testing.assert_allclose(path[[0, 80]], np.stack([np.eye(4)] * 2), atol=1e-12)
    np.testing.assert_allclose(path[35], path[45], atol=1e-12)
    assert path[40, 0, 3] > 0.5
    with pytest.raises(ValueError, match="count is 0"):
        bodies_path(0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"height": 0}, "height is 0: expected a positive whole number"),
        ({"bodies": 4}, "bodies is 4: expected 3 at most"),
        ({"bodies": -1}, "bodies is -1: expected a non-negative whole number"),
        ({"bodies": 1.5}, "bodies is 1.5"),
        ({"noise": -1.0}, "noise is -1.0: expected a number of at least 0"),
        ({"poses": np.eye(4)}, r"poses is \(4, 4\): expected \(N, 4, 4\)"),
        ({"poses": np.zeros((2, 3, 4))}, r"poses is \(2, 3, 4\)"),
        ({"poses": np.zeros((1, 4, 4))}, "expected a rotation"),
    ],
)
def test_errors_name_the_argument(change, words):
    with pytest.raises(ValueError, match=words):
        bodies_film(**{"poses": bodies_path(1), "height": 10, "width": 12, **change})
