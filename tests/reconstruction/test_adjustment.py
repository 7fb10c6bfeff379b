"""Adjustment of poses to the images, jointly with the depth of keyframes."""

import cv2
import numpy as np

from tests.reconstruction.films import path_error, walk
from tisfm.reconstruction.depth.pose_adjustment import adjust_poses, make_keyframe_window
from tisfm.rigid import pose_matrix
from tisfm.settings import Settings

SETTINGS = Settings.preset("balanced", motion="camera")


def stars_of(film, keys, noise=0.0):
    random = np.random.default_rng(5)
    stars = []
    for key in keys:
        inverse = 1 / film.depth[key]
        inverse = inverse * (1 + noise * random.standard_normal(inverse.shape))
        members = [k for k in range(len(film.frames)) if k != key and abs(k - key) <= 4]
        frame = film.frames[key].astype(np.float32)
        stars.append(
            make_keyframe_window(key, members, frame, inverse.astype("f4"), 0.02 * inverse)
        )
    return stars


def shaken(poses, amount, seed=1):
    random = np.random.default_rng(seed)
    twists = amount * random.standard_normal((len(poses), 6))
    twists[0] = 0
    return {
        k: pose @ pose_matrix(twist)
        for k, (pose, twist) in enumerate(zip(poses, twists, strict=True))
    }


def adjusted_path(film, start, stars, rounds=3):
    found = adjust_poses(
        start, stars, lambda k: film.frames[k].astype(np.float32), film.camera, SETTINGS,
        rounds=rounds,
    )  # fmt: skip
    return np.array([found[k] for k in sorted(found)])


def test_shaken_poses_come_nearer_to_the_truth():
    film = walk()
    start = shaken(film.poses, 0.003)
    before = path_error(np.array(list(start.values())), film.poses)
    found = adjusted_path(film, start, stars_of(film, (0, 4, 8), noise=0.02), rounds=5)
    assert path_error(found, film.poses) < before / 3
    np.testing.assert_array_equal(found[0], start[0])


def test_fixed_frames_stay_and_correct_the_others():
    film = walk()
    start = shaken(film.poses, 0.003)
    held = {k: film.poses[k] for k in (0, 1, 2, 3)}
    images = [frame.astype(np.float32) for frame in film.frames]
    found = adjust_poses(
        {**start, **held}, stars_of(film, (0, 4, 8), noise=0.02), images.__getitem__, film.camera,
        SETTINGS, fixed_frames=held, rounds=5,
    )  # fmt: skip
    for frame, pose in held.items():
        np.testing.assert_array_equal(found[frame], pose)
    free = range(4, len(images))
    away = [
        np.mean([np.linalg.norm((one[k] - film.poses[k])[:3, 3]) for k in free])
        for one in (found, start)
    ]
    assert away[0] < away[1] / 2


def test_true_path_stays():
    film = walk()
    start = dict(enumerate(film.poses))
    found = adjusted_path(film, start, stars_of(film, (0, 4, 8)))
    assert path_error(found, film.poses) < 0.004


def test_depth_of_a_star_is_found_with_its_motions():
    film = walk()
    (star,) = stars = stars_of(film, (4,))
    (true,) = stars_of(film, (4,))
    bumps = np.random.default_rng(4).normal(0, 0.06, (4, 5)).astype(np.float32)
    star.inverse_depth = true.inverse_depth * (1 + cv2.resize(bumps, true.weight.shape[::-1]))

    def off():
        ratio = star.inverse_depth / true.inverse_depth
        return np.average(np.abs(ratio / np.median(ratio) - 1), weights=star.weight)

    before = off()
    adjusted_path(film, dict(enumerate(film.poses)), stars)
    assert off() < before / 1.5


def test_poses_stay_without_keyframe_windows():
    film = walk()
    start = dict(enumerate(film.poses))
    found = adjust_poses(start, [], lambda k: film.frames[k], film.camera, SETTINGS)
    assert all((found[k] == start[k]).all() for k in start)


def test_windows_of_frames_without_poses_are_ignored():
    film = walk()
    start = {0: film.poses[0], 8: film.poses[8]}
    found = adjust_poses(
        start, stars_of(film, (0,)), lambda k: film.frames[k], film.camera, SETTINGS
    )
    assert all((found[k] == start[k]).all() for k in start)


def test_frames_that_no_star_has_stay():
    film = walk()
    start = {k: pose for k, pose in enumerate(film.poses)}
    stars = stars_of(film, (0,))
    found = adjust_poses(
        start, stars, lambda k: film.frames[k].astype(np.float32), film.camera, SETTINGS
    )
    np.testing.assert_allclose(found[8], start[8], atol=1e-12)
