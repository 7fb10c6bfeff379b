"""Rigid motions: twists, matrices, and poses that are none."""

import numpy as np
import pytest

from tisfm.rigid import check_pose, pose_matrix, rigid_motion, rigid_twist


def test_the_last_row_may_be_rounded():
    pose = pose_matrix((1, 2, 3, 0.1, 0.2, 0.3))
    pose[3] += 1e-7
    np.testing.assert_array_equal(check_pose(pose).translation, pose[:3, 3])
    pose[3, 0] = 0.01
    with pytest.raises(ValueError, match="last row"):
        check_pose(pose)


def test_a_turn_below_the_bound_is_a_pose():
    turn = rigid_motion((0, 0, 0, *np.radians((0, 0, 89))))[0]
    np.testing.assert_allclose(check_pose(turn).rotation, turn, atol=1e-12)


def test_a_rounded_rotation_becomes_exact():
    rotation, _ = rigid_motion((0, 0, 0, 0.1, -0.2, 0.3))
    known = check_pose(np.round(rotation, 4))
    np.testing.assert_allclose(known.rotation @ known.rotation.T, np.eye(3), atol=1e-12)
    assert known.translation is None
    assert check_pose(None) is None


@pytest.mark.parametrize("spin", [(0, 0, 0), (1e-9, 0, 0), (0.1, -0.2, 0.3), (0, 3.1, 0)])
def test_twists_and_motions_are_each_others_inverse(spin):
    twist = np.array([0.5, -1, 2, *spin])
    np.testing.assert_allclose(rigid_twist(*rigid_motion(twist)), twist, atol=1e-9)
