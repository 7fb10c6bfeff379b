"""A known pose, and a pose that contradicts the images."""

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.motion.one_motion import FAST, errors, interpreted
from tests.pairwise import pairwise
from tests.rendered import static_scene, two_blocks
from tisfm.metrics import depth_errors, pose_errors
from tisfm.rigid import pose_matrix, rigid_motion
from tisfm.scenes import STATIC_KINDS


def test_known_pose_gives_metric_depth(small):
    pose = pose_matrix(small.motions[0])
    result = interpreted(small, pose=pose)
    ratio = result.depth / small.depth
    assert np.median(ratio[small.visible]) == pytest.approx(1, abs=0.01)
    found = pose_errors(pose_matrix(result.motions[0]), pose)
    assert found.direction < 1e-4 and found.rotation < 1e-4
    assert np.linalg.norm(result.motions[0][:3]) == pytest.approx(1)
    # In another unit, depth scales and the motion stays.
    pose[:3, 3] *= 1000
    again = interpreted(small, pose=pose)
    np.testing.assert_allclose(again.depth, 1000 * result.depth, rtol=1e-4)
    np.testing.assert_allclose(again.flow, result.flow, atol=1e-4)


def test_known_rotation_leaves_the_direction_to_be_found(small):
    rotation, _ = rigid_motion(small.motions[0])
    result = interpreted(small, pose=rotation)
    found = errors(result, small)
    assert found.rotation < 1e-4
    assert found.direction < 2
    assert depth_errors(result.depth, small.depth, mask=small.visible).abs_rel < 0.03


def test_a_pose_that_is_a_rotation_shows_no_depth(small):
    pose = np.eye(4)
    pose[:3, :3], _ = rigid_motion((0, 0, 0, 0.01, 0.02, 0))
    result = interpreted(small, pose=pose)
    assert result.status == "pure_rotation"
    assert not result.inverse_depth.any()


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (np.eye(2), "shape"),
        (np.zeros((3, 4)), "shape"),
        (np.diag([1.0, 1, -1]), "not a rotation"),
        (2 * np.eye(3), "not a rotation"),
        (np.full((4, 4), np.nan), "NaN"),
        (np.diag([1.0, 1, 1, 2]), "last row"),
        (np.diag([1.0, -1, -1]), "turns by 180°: expected less than 90°"),
        (rigid_motion((0, 0, 0, 0, 0, np.pi / 2))[0], "turns by 90°"),
    ],
)
def test_poses_that_are_none(pose, words, small):
    with pytest.raises(ValueError, match=words):
        interpreted(small, pose=pose)


@pytest.mark.parametrize("pose", ["pose.txt", np.eye(4, dtype=complex), np.eye(3, dtype=bool)])
def test_poses_that_are_not_real_numbers(pose, small):
    with pytest.raises(TypeError, match="expected a 4×4 or 3×3 array of real numbers"):
        interpreted(small, pose=pose)


def test_the_field_takes_no_pose(small):
    with pytest.raises(ValueError, match='motion="field" leaves the motion free'):
        interpreted(small, tisfm.Settings(), pose=np.eye(4))


def with_turn(axis, degrees):
    twist = np.zeros(6)
    twist[3 + axis] = np.radians(degrees)
    return pose_matrix(twist)


@pytest.fixture(scope="module")
def posed():
    scene = static_scene("sideways+rotation", 180, 240, seed=5)
    return scene, pose_matrix(scene.motions[0])


WRONG = {
    "backwards": lambda pose: np.block([[pose[:3, :3], -pose[:3, 3:]], [pose[3:]]]),
    "inverse": np.linalg.inv,
    "forward": lambda pose: np.block(
        [[pose[:3, :3], np.array([[0], [0], [-1.0]])], [np.array([0, 0, 0, 1.0])]]
    ),
    "axes": lambda pose: np.diag([1, -1, -1, 1]) @ pose @ np.diag([1, -1, -1, 1]),
    **{f"turned about {'xyz'[axis]}": lambda pose, axis=axis: with_turn(axis, 3) @ pose
       for axis in range(3)},
}  # fmt: skip


@pytest.mark.parametrize("kind", nightly_except("backwards", "inverse", of=WRONG))
def test_a_wrong_pose_is_reported_and_its_depth_kept(posed, kind):
    scene, pose = posed
    result = interpreted(scene, FAST, pose=WRONG[kind](pose))
    assert result.status == "pose_mismatch"
    assert result.inverse_depth.any() and np.isfinite(result.inverse_depth).all()
    assert "the given pose contradicts the images" in result.status.message
    assert ("np.linalg.inv(pose)" in result.status.message) == (kind == "inverse")


@pytest.mark.parametrize("axis", nightly_except(2, of=[0, 1, 2]))
def test_a_wrong_rotation_is_reported(posed, axis):
    scene, pose = posed
    result = interpreted(scene, FAST, pose=(with_turn(axis, 3) @ pose)[:3, :3])
    assert result.status == "pose_mismatch"


@pairwise(noise=[0, 15, 40], known=[3, 4], short=True)
def test_a_right_pose_is_not_doubted(posed, noise, known):
    scene, pose = posed
    rng = np.random.default_rng(0)
    frames = [
        np.clip(frame + rng.normal(scale=noise, size=frame.shape), 0, 255).astype(np.uint8)
        for frame in (scene.frame0, scene.frame1)
    ]
    result = tisfm.interpret(*frames, camera=scene.camera, settings=FAST, pose=pose[:known, :known])
    assert result.status == "converged"


@pairwise(
    kind=STATIC_KINDS, focal=[225.0, 240.0, 450.0, 900.0], preset=["fast", "balanced"], short=True
)
def test_right_poses_of_all_scenes_and_focal_lengths(kind, focal, preset):
    scene = static_scene(kind, 180, 240, seed=1, focal=focal)
    settings = tisfm.Settings.preset(preset, motion="camera")
    result = interpreted(scene, settings, pose=pose_matrix(scene.motions[0]))
    assert result.status == "converged"


def test_moving_objects_are_no_reason_to_doubt_a_pose():
    pair = two_blocks(240, 320, seed=1)
    result = interpreted(pair, FAST, pose=pose_matrix(pair.motions[0]))
    assert result.status == "converged"


def test_a_pose_of_noise_without_parallax_puts_all_far_away(posed):
    """Points that move less than the noise get inverse depth 0, within the deviation."""
    scene, _ = posed
    rng = np.random.default_rng(1)
    frames = (scene.frame0 + rng.normal(scale=3, size=(2, 180, 240))).astype(np.float32)
    pose = np.eye(4)
    pose[0, 3] = 1
    result = tisfm.interpret(*frames, camera=scene.camera, settings=FAST, pose=pose)
    assert result.status == "uncertain"
    seen = ~result.occlusion
    assert np.isfinite(result.inverse_depth_std[seen]).all()
    near = np.abs(result.inverse_depth) < 3 * result.inverse_depth_std
    assert near[seen].mean() > 0.9
