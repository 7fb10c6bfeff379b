"""Poses before a single plane, aligned to the grey levels of all pixels."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.reconstruction.films import path_error
from tisfm.camera import Camera
from tisfm.reconstruction.depth import plane_alignment
from tisfm.reconstruction.depth.plane_alignment import align_plane
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.rigid import pose_matrix
from tisfm.scenes import Plane, Scene, Texture

SHAPE, CAMERA = (120, 160), Camera(focal=150.0)
NORMAL = np.array([0.3, -0.2, -0.93])
COUNT = 10


@cache
def film():
    """Return noisy frames of a tilted plane, and the true poses, camera to world."""
    texture = Texture(wavelength=0.2, mean=120, contrast=60, seed=3)
    scene = Scene(
        objects=[Plane(texture=texture, point=(0, 0, 5), normal=NORMAL)],
        camera=CAMERA,
        height=SHAPE[0],
        width=SHAPE[1],
    )
    turn = 0.01 * np.sin(np.outer(np.arange(COUNT), (0.7, 0.5, 0.9)))
    poses = np.array([pose_matrix((0.08 * k, 0.02 * k, 0.09 * k, *turn[k])) for k in range(COUNT)])
    random = np.random.default_rng(0)
    frames = [
        (scene.render_frame(pose, samples=2) + random.normal(0, 1.5, SHAPE)).astype(np.float32)
        for pose in poses
    ]
    return frames, poses


def tracks(poses, points):
    """Return the points as frames show them, with an error of 0.05 px."""
    random, center = np.random.default_rng(1), np.array(CAMERA.center_for(*SHAPE))
    found = []
    for pose in poses:
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        seen = CAMERA.focal * local[:, :2] / local[:, 2:] + center
        noisy = seen + random.normal(0, 0.05, seen.shape)
        found.append(Observations(points=noisy, tracks=np.arange(len(points))))
    return found


def on_plane(relief=0.0, share=1.0):
    """Return points of the plane, a share of them nearer to the first camera by `relief`."""
    random = np.random.default_rng(2)
    rays = random.uniform((-0.5, -0.4, 1), (0.5, 0.4, 1), (300, 3))
    points = rays * (5 * NORMAL[2] / (rays @ NORMAL))[:, None]
    points[: int(share * len(points))] *= 1 - relief
    return points


def disturbed(poses, size=0.002):
    """Return poses with errors of position and direction, by frame."""
    random = np.random.default_rng(4)
    errors = [random.normal(0, size, 6) * (5, 5, 5, 1, 1, 1) for _ in poses[1:]]
    changed = [poses[0], *(p @ pose_matrix(e) for p, e in zip(poses[1:], errors, strict=True))]
    return dict(enumerate(changed))


def align(frames, poses, points, observations, used=None):
    used = np.ones(SHAPE, bool) if used is None else used
    return align_plane(
        poses,
        dict(enumerate(points)),
        observations,
        frames.__getitem__,
        lambda _: used,
        CAMERA,
        SHAPE,
    )


@pytest.mark.parametrize("gain, offset", [(1.0, 0.0), (1.15, -10.0)])
def test_poses_before_a_plane_fit_all_pixels(gain, offset):
    """Every second frame is brighter: a change of light is no motion."""
    frames, true = film()
    frames = [gain * f + offset if k % 2 else f for k, f in enumerate(frames)]
    start, points = disturbed(true), on_plane()
    before = start.copy()
    found = align(frames, start, points, tracks(true, points))
    assert list(found) == list(range(COUNT))
    np.testing.assert_array_equal(found[0], true[0])
    error, start_error = (path_error(list(p.values()), true) for p in (found, start))
    assert start_error > 0.005
    assert error < 0.0015  # as from the true poses: the limit that noise sets
    for frame, pose in start.items():
        np.testing.assert_array_equal(pose, before[frame])


def test_ignored_pixels_are_not_compared():
    frames, true = film()
    points, used = on_plane(), np.ones(SHAPE, bool)
    used[:, :40] = False
    dark = [np.where(used, frame, 20).astype(np.float32) for frame in frames]
    found = align(dark, disturbed(true), points, tracks(true, points), used)
    assert path_error(list(found.values()), true) < 0.0025


def test_thin_strip_of_used_pixels_gives_no_homography():
    """Every pixel of the strip has an unused neighbour, so no pixel is compared."""
    frames, true = film()
    points, used = on_plane(), np.zeros(SHAPE, bool)
    used[60:63] = True
    assert align(frames, dict(enumerate(true)), points, tracks(true, points), used) is None


def cut(observations, length):
    """Return tracks that end after `length` frames and begin anew, each at another frame."""
    found = []
    for k, seen in enumerate(observations):
        parts = (k + seen.tracks) // length
        found.append(replace(seen, tracks=seen.tracks + 1000 * parts))
    return found


@pytest.mark.parametrize("relief, is_plane", [(0.0, True), (0.3, False)])
def test_short_tracks_show_relief(relief, is_plane):
    """Tracks of five frames; a third of the points comes late, and may be nearer than the plane."""
    frames, true = film()
    points = on_plane(relief, 1 / 3)
    seen = tracks(true, points)
    late = [Observations(points=each.points[100:], tracks=each.tracks[100:]) for each in seen[:5]]
    short = cut([*late, *seen[5:]], 5)
    assert not len(short[0].common_tracks(short[8])[0])
    assert (align(frames, dict(enumerate(true)), points, short) is not None) == is_plane


def test_tracks_of_single_frames_show_no_plane():
    frames, true = film()
    points = on_plane()
    short = cut(tracks(true, points), 1)
    assert align(frames, dict(enumerate(true)), points, short) is None


def test_poses_that_leave_the_tracks_are_not_taken(monkeypatch):
    """The tracks fit a plane exactly, but another path than the images."""
    frames, true = film()
    points = on_plane()
    turns = [pose_matrix((0, 0, 0, 0, 0.003 * (k % 2), 0)) for k in range(COUNT)]
    turned = np.array([pose @ turn for pose, turn in zip(true, turns, strict=True)])
    arguments = frames, dict(enumerate(turned)), points, tracks(turned, points)
    assert align(*arguments) is None
    settings = replace(DEPTH, max_track_growth=np.inf)
    monkeypatch.setattr(plane_alignment, "DEPTH", settings)
    assert align(*arguments) is not None


@pytest.mark.parametrize("relief, share", [(0.05, 0.1), (0.3, 1 / 3), (0.3, 0.7)])
def test_relief_is_no_plane(relief, share):
    frames, true = film()
    points = on_plane(relief, share)
    assert align(frames, dict(enumerate(true)), points, tracks(true, points)) is None


def test_frames_that_do_not_fit_are_not_aligned():
    frames, true = film()
    points = on_plane()
    others = [np.roll(frame, 60 * (k % 2), axis=1) for k, frame in enumerate(frames)]
    assert align(others, dict(enumerate(true)), points, tracks(true, points)) is None


def test_frames_without_texture_are_not_aligned():
    frames, true = film()
    points = on_plane()
    bare = [np.full_like(frame, 120) for frame in frames]
    assert align(bare, dict(enumerate(true)), points, tracks(true, points)) is None
    pair = dict(enumerate(true[:2]))
    assert align(frames, pair, points, tracks(true, points)) is None  # a path has three frames
