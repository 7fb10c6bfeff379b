"""Photographs so far apart that no track leads from one to the next."""

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import path_error, walk
from tests.rendered import shared
from tisfm.camera import Camera
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS
from tisfm.reconstruction.tracks.photographs import (
    _add_matched_tracks,
    are_photographs,
    match_photographs,
)
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.views import View
from tisfm.rigid import pose_matrix
from tisfm.scenes import Box, Plane, Scene, Texture
from tisfm.settings import Settings

HEIGHT, WIDTH, FOCAL = 360, 480, 390.0
CAMERA = Camera(focal=FOCAL)
ALTITUDE = 10.0  # m
SIDESTEP = 0.3 * ALTITUDE * WIDTH / FOCAL  # m: 30 % of the width of a photograph


@shared
def flight(count=6):
    """Return photographs of houses from above, (N, H, W) uint8, and their poses."""
    random = np.random.default_rng(3)
    lawn = Texture(wavelength=0.12, octaves=6, contrast=90, seed=1)
    objects = [Plane(texture=lawn, point=(0, 0, ALTITUDE))]
    for k in range(60):
        size = random.uniform((0.8, 0.8, 0.6), (2.0, 2.0, 2.5))
        center = *random.uniform((-7, -5), (7 + SIDESTEP * count, 5)), ALTITUDE - size[2] / 2
        roof = Texture(wavelength=0.1, octaves=6, contrast=90, seed=10 + k)
        objects.append(Box(texture=roof, center=center, size=size))
    scene = Scene(objects=objects, camera=CAMERA, height=HEIGHT, width=WIDTH)
    poses = []
    for k in range(count):
        swing = random.uniform(-0.05, 0.05, 3)
        shift = random.uniform(-0.2, 0.2, 3)
        shift = (shift[0] + k * SIDESTEP, *shift[1:])
        poses.append(pose_matrix(np.array((*shift, *swing))))
    frames = [np.rint(scene.render_view(pose, samples=2)[0]) for pose in poses]
    return np.stack(frames).astype(np.uint8), np.array(poses)


def track(frames):
    tracker = Tracker(CAMERA, TRACKING_SETTINGS)
    return [tracker.track(frame) for frame in frames]


@pytest.mark.parametrize("given", [False, True])
def test_photographs_far_apart_get_poses_and_depth(given, tmp_path):
    frames, poses = flight()
    result = tisfm.reconstruct(
        list(frames),
        camera=CAMERA,
        settings=Settings.preset("fast"),
        poses=poses if given else None,
        folder=tmp_path / "result",
    )
    assert result.piece.tolist() == [0] * len(frames)
    assert path_error(result.poses, poses) < 0.01
    assert np.isfinite(result.depth_error).all()
    assert not result.checks or not result.checks[0].pairs
    if given:
        assert set(map(str, result.status)) == {"converged"}
    else:
        assert set(map(str, result.status)) == {"uncertain"}
        assert "too far apart" in result.status[0].message


def test_photographs_are_told_from_films():
    assert are_photographs(track(flight()[0]))
    assert not are_photographs(track(walk(4).frames))
    assert not are_photographs([])


def test_dark_frames_make_no_photographs():
    film, dark = walk(4).frames, np.zeros(walk(4).frames.shape, np.uint8)
    assert not are_photographs(track([*film, *dark, *dark]))


def test_matched_points_become_tracks():
    nothing = Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
    old = Observations(points=np.ones((1, 2)), tracks=np.array([7]))
    views = [
        View(frame=k, observations=nothing, detected=np.arange(6.0).reshape(3, 2) + 10 * k)
        for k in range(3)
    ]
    matches = {
        (0, 1): np.array([[0, 1], [2, 2]]),
        (1, 2): np.array([[1, 0], [2, 2]]),
        (0, 2): np.array([[1, 2]]),  # joins two points of frame 0: no track
    }
    found = _add_matched_tracks([old, nothing, nothing], views, matches)
    assert [seen.tracks.tolist() for seen in found] == [[7, 8], [8], [8]]
    assert found[0].points[1].tolist() == [0, 1]
    assert found[1].points[0].tolist() == [12, 13]
    assert found[2].points[0].tolist() == [20, 21]


def test_frames_that_hardly_move_are_no_photographs():
    """Tracks may end for another reason, such as noise."""
    frames = walk(4, 240, 320).frames
    nothing = [Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))] * 4
    tracks = SequenceTracks(
        observations=nothing, views=(), matches={}, distinct_count=4, shape=frames.shape[1:]
    )
    camera = Camera(focal=192.0)
    found = match_photographs(tracks, lambda k: (frames[k], None), camera, is_focal_known=True)
    assert found is None
