"""The readout time of a camera, estimated from points in many views."""

import numpy as np
import pytest

from tisfm.camera import Camera
from tisfm.reconstruction.rolling_shutter.correction import _is_significant
from tisfm.reconstruction.rolling_shutter.readout import _collect_observations, estimate_readout
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View
from tisfm.rigid import pose_matrix
from tisfm.shutter import motion_rates, move_by_twist, points_at_middle_row

CAMERA, SHAPE = Camera(focal=300.0), (240, 320)


def shaken(count):
    """Return poses of a shaken camera, camera to world."""
    at = np.arange(count)
    turns = 0.06 * np.sin(0.9 * at), 0.05 * np.cos(0.7 * at), 0.03 * np.sin(1.3 * at)
    twists = np.stack([0.05 * at, 0.02 * np.sin(at), 0.01 * at, *turns], axis=1)
    return {k: pose_matrix(twist) for k, twist in enumerate(twists)}


def seen_by(poses, readout, noise, outliers=0.0):
    """Return views of points, each row read at its own time; some points are wrong."""
    random = np.random.default_rng(0)
    world = random.uniform((-3, -2, 3), (4, 2, 7), (500, 3))
    rates = motion_rates(poses, np.arange(len(poses)))
    center = np.array(CAMERA.center_for(*SHAPE))
    views = []
    for frame, pose in poses.items():
        local = (world - pose[:3, 3]) @ pose[:3, :3]
        row = np.zeros(len(local))
        for _ in range(8):
            late = readout * (row - (SHAPE[0] - 1) / 2) / SHAPE[0]
            there = move_by_twist(local, rates[frame], late)
            place = CAMERA.focal * there[:, :2] / there[:, 2:] + center
            row = place[:, 1].clip(0, SHAPE[0])
        place += random.normal(0, noise, place.shape)
        wrong = random.random(len(place)) < outliers
        place[wrong] += random.uniform(-40, 40, (int(wrong.sum()), 2))
        inside = ((place >= 0) & (place < SHAPE[::-1])).all(axis=1) & (there[:, 2] > 0)
        half = np.arange(len(world)) < 250
        tracks = np.flatnonzero(inside & half)
        views.append(
            View(
                frame=frame,
                observations=Observations(points=place[tracks], tracks=tracks),
                detected=np.where((inside & ~half)[:, None], place, -1)[250:],
            )
        )
    return views


def matched(views):
    """Return matches of the detected points of neighbouring views."""
    matches = {}
    for k in range(len(views) - 1):
        both = (views[k].detected[:, 0] >= 0) & (views[k + 1].detected[:, 0] >= 0)
        matches[k, k + 1] = np.repeat(np.flatnonzero(both)[:, None], 2, axis=1)
    return matches


@pytest.mark.parametrize("readout", [0.7, -0.4])
def test_readout_is_found_despite_noise_and_outliers(readout):
    poses = shaken(14)
    views = seen_by(poses, readout, 0.3, outliers=0.1)
    rates = motion_rates(poses, np.arange(14))
    found = estimate_readout(views, matched(views), poses, rates, CAMERA, SHAPE)
    assert abs(found.readout - readout) < min(0.03, 4 * found.deviation)
    assert 0 < found.deviation < 0.1 * abs(readout)


def test_global_shutter_is_recognised():
    poses = shaken(14)
    views = seen_by(poses, 0.0, 0.3)
    rates = motion_rates(poses, np.arange(14))
    found = estimate_readout(views, matched(views), poses, rates, CAMERA, SHAPE)
    assert abs(found.readout) < found.deviation < 0.05


def test_steady_motion_shows_little_of_the_readout():
    """Every frame is distorted alike, and slightly bent poses and points explain it as well."""
    poses = {k: pose_matrix((0.05 * k, 0, 0, 0, 0, 0)) for k in range(14)}
    shaking = shaken(14)
    views = [seen_by(path, 0.5, 0.3) for path in (poses, shaking)]
    steady, shaken_ = (
        estimate_readout(v, {}, path, motion_rates(path, np.arange(14)), CAMERA, SHAPE)
        for v, path in zip(views, (poses, shaking), strict=True)
    )
    assert steady.deviation > 5 * shaken_.deviation


@pytest.mark.parametrize(
    "twist",
    [
        (0.05, 0, 0, 0, 0, 0),
        (0, 0.05, 0, 0, 0, 0),
        (0, 0, 0.1, 0, 0, 0),
        (0.05, 0, 0.01, 0, 0.02, 0),
    ],
    ids=["sideways", "up", "forward", "pan"],
)
@pytest.mark.parametrize("readout", [0.0, 0.5])
def test_readout_that_poses_and_focal_length_explain_is_not_seen(twist, readout):
    """In a steady motion, other poses or another focal length move rows in the same way."""
    poses = {k: pose_matrix(np.multiply(k, twist)) for k in range(10)}
    views = seen_by(poses, readout, 0.3)
    found = estimate_readout(views, {}, poses, motion_rates(poses, np.arange(10)), CAMERA, SHAPE)
    assert found.deviation > 1  # larger than any readout time
    assert not _is_significant(found)


def test_estimate_does_not_depend_on_the_axes():
    """Images do not depend on the origin and the axes of the world."""
    poses = shaken(8)
    views = seen_by(poses, 0.5, 0.3)
    elsewhere = pose_matrix((3, -2, 1, 0.5, 1.0, -0.3))
    moved = {frame: elsewhere @ pose for frame, pose in poses.items()}
    rates = motion_rates(poses, np.arange(8))
    here, there = (
        estimate_readout(views, {}, some, rates, CAMERA, SHAPE) for some in (poses, moved)
    )
    assert here.readout == pytest.approx(there.readout, abs=1e-3)
    assert here.deviation == pytest.approx(there.deviation, rel=1e-2)


def test_point_with_two_positions_in_a_view_is_left_out():
    nothing = Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
    positions = np.random.default_rng(0).uniform(0, 200, (3, 3, 2))
    views = [View(frame=k, observations=nothing, detected=positions[k]) for k in range(3)]
    # The second and the third point of view 0 match the same point of view 1.
    matches = {(0, 1): [[0, 0], [1, 1], [2, 1]], (1, 2): [[0, 0], [1, 1]]}
    pairs = {key: np.array(value) for key, value in matches.items()}
    found = _collect_observations(views, pairs, range(3))
    assert found.view.tolist() == [0, 1, 2] and found.point.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(found.position, positions[:, 0])


def test_views_without_common_points_give_no_readout():
    poses = shaken(4)
    nothing = Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
    views = [View(frame=k, observations=nothing, detected=np.empty((0, 2))) for k in range(4)]
    rates = motion_rates(poses, np.arange(4))
    assert estimate_readout(views, {}, poses, rates, CAMERA, SHAPE) is None
    assert estimate_readout([], {}, poses, rates, CAMERA, SHAPE) is None


def test_at_middle_needs_no_point():
    assert points_at_middle_row(
        np.empty((0, 2)), np.empty(0), np.ones(6), 0.5, CAMERA, SHAPE
    ).shape == (0, 2)
