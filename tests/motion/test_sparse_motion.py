"""Motions from matched points: the simplest model that explains them, with noise and outliers."""

import numpy as np
import pytest

from tests.rendered import three_blocks
from tisfm.camera import Camera
from tisfm.motion.epipolar_fit import Rays, pose_cost
from tisfm.motion.homographies import angle_between
from tisfm.motion.settings import SPARSE
from tisfm.motion.sparse_matches import Matches, sparse_matches
from tisfm.motion.sparse_motion import sparse_motions
from tisfm.rigid import rigid_motion

SHAPE = (240, 320)
CAMERA = Camera(focal=300.0)
TWIST = (0.4, 0.1, -0.3, 0.02, 0.16, -0.05)
PLANE = np.array([0.15, -0.1, 0.2])  # 1/Z = n · x̂


def made(kind, *, count=300, noise=0.2, wrong=0.0, twist=TWIST):
    """Return matches of points at random depths, of a plane, or of a turning camera."""
    rng = np.random.default_rng(3)
    before = rng.uniform(0, np.array(SHAPE[::-1]) - 1, (count, 2))
    center = np.array(CAMERA.center_for(*SHAPE))
    rays = np.column_stack([(before - center) / CAMERA.focal, np.ones(count)])
    depth = rng.uniform(2, 8, count) if kind == "depth" else 1 / (rays @ PLANE)
    rotation, translation = rigid_motion(twist)
    moved = depth[:, None] * rays @ rotation.T + (translation if kind != "rotation" else 0)
    after = CAMERA.focal * moved[:, :2] / moved[:, 2:] + center
    after += rng.normal(scale=noise, size=after.shape)
    lost = rng.random(count) < wrong
    after[lost] = rng.uniform(0, np.array(SHAPE[::-1]) - 1, (lost.sum(), 2))
    return (
        Matches(points0=before, points1=after),
        rotation,
        translation / np.linalg.norm(translation),
    )


def turn(a, b):
    """Angle of the rotation from b to a, degrees."""
    return np.degrees(np.arccos(np.clip((np.trace(a @ b.T) - 1) / 2, -1, 1)))


@pytest.mark.parametrize("kind", ["depth", "plane", "rotation"])
@pytest.mark.parametrize("wrong", [0, 0.3])
def test_the_simplest_model_that_explains_the_matches(kind, wrong):
    matches, rotation, translation = made(kind, wrong=wrong)
    motions, judge = sparse_motions(matches, CAMERA, SHAPE)
    assert judge is not None and all(motion.model == kind for motion in motions)
    if kind == "rotation":
        assert turn(motions[0].rotation_alone, rotation) < 0.1
        assert motions[0].parallax < 1
        return
    # A plane allows two motions; if one is right, the images cannot exclude the other.
    right = [m for m in motions if np.degrees(angle_between(m.translation, translation)) < 2]
    assert len(right) == 1 and turn(right[0].rotation, rotation) < 0.3
    if kind == "depth":
        assert right == motions
    assert right[0].inliers == pytest.approx((1 - wrong) * 300, abs=20)
    assert right[0].residual < 0.5 and right[0].parallax > 5 and right[0].coverage > 0.8
    assert right[0].cost <= SPARSE.max_cost_ratio * motions[0].cost


def test_exact_matches_give_the_exact_motion():
    matches, rotation, translation = made("depth", noise=0)
    motions, _ = sparse_motions(matches, CAMERA, SHAPE)
    assert len(motions) == 1
    assert (
        np.degrees(angle_between(motions[0].translation, translation)) < 1e-3
    )  # including the sign
    assert turn(motions[0].rotation, rotation) < 1e-3
    assert motions[0].inliers == 300


def test_the_judge_prefers_the_true_motion():
    matches, rotation, translation = made("depth", wrong=0.2)
    motions, judge = sparse_motions(matches, CAMERA, SHAPE)
    off = rigid_motion((0, 0, 0, 0, 0.02, 0))[0]
    true = judge.cost((rotation, translation))
    assert motions[0].cost < 1.05 * true
    assert judge.cost((off @ rotation, translation)) > 1.5 * true
    rays = judge.rays
    everything = pose_cost(rays, (rotation, translation), judge.scale)
    assert true == everything and isinstance(rays, Rays)


def test_lengths_scale_between_levels():
    motion = sparse_motions(made("depth")[0], CAMERA, SHAPE)[0][0]
    half = motion.scaled(0.5)
    assert half.parallax == motion.parallax / 2 and half.residual == motion.residual / 2
    assert half.rotation is motion.rotation and half.inliers == motion.inliers


@pytest.mark.parametrize("count", [0, 1, SPARSE.min_matches - 1])
def test_too_few_matches_show_no_motion(count):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 200, (2, count, 2))
    assert sparse_motions(Matches(points0=points[0], points1=points[1]), CAMERA, SHAPE) == (
        [],
        None,
    )


def test_points_on_one_spot_give_no_error():
    points = np.full((40, 2), 50.0)
    motions, _ = sparse_motions(Matches(points0=points, points1=points + 3), CAMERA, SHAPE)
    assert all(np.isfinite(motion.rotation).all() for motion in motions)


@pytest.fixture(scope="module")
def far():
    return three_blocks(
        *SHAPE, camera_motion=(0.5, 0, 0, 0, 0.17, 0), block_motions=np.zeros((3, 6))
    )


def test_matches_follow_the_true_flow(far):
    matches = sparse_matches(*(frame.astype(np.float32) for frame in (far.frame0, far.frame1)))
    assert len(matches.points0) > 100
    column, row = np.rint(matches.points0).astype(int).T
    off = np.linalg.norm(matches.points1 - matches.points0 - far.flow[row, column], axis=1)
    assert np.linalg.norm(far.flow[row, column], axis=1).min() > 15
    assert np.median(off) < 0.5 and (off < 2).mean() > 0.8


def test_matches_are_spread_and_the_same_every_time(far):
    frames = [frame.astype(np.float32) for frame in (far.frame0, far.frame1)]
    first, second = sparse_matches(*frames), sparse_matches(*frames)
    np.testing.assert_array_equal(first.points0, second.points0)
    np.testing.assert_array_equal(first.points1, second.points1)
    side = (SHAPE[0] * SHAPE[1]) ** 0.5 / SPARSE.cells
    cells, count = np.unique((first.points0 // side).astype(int), axis=0, return_counts=True)
    assert count.max() <= SPARSE.points_per_cell and len(cells) > 30


@pytest.mark.parametrize(("scale", "offset"), [(1 / 255, 0), (1e4, -300)])
def test_brightness_of_any_scale_gives_the_same_matches(far, scale, offset):
    frames = [frame.astype(np.float32) for frame in (far.frame0, far.frame1)]
    usual = sparse_matches(*frames)
    other = sparse_matches(*(np.float32(scale) * frame + np.float32(offset) for frame in frames))
    common = {tuple(pair) for pair in np.hstack([usual.points0, usual.points1])}
    again = {tuple(pair) for pair in np.hstack([other.points0, other.points1])}
    assert len(common & again) > 0.95 * len(common)  # rounding changes a few grey levels


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (7, 9), (60, 80)])
def test_frames_without_points_have_no_matches(size):
    flat = np.full(size, 7, np.float32)
    assert len(sparse_matches(flat, flat).points0) == 0
    ramp = np.tile(np.linspace(0, 255, size[1], dtype=np.float32), (size[0], 1))
    assert len(sparse_matches(ramp, ramp).points0) == 0
