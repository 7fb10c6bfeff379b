"""Rigid motions: twists, matrices, and invalid poses."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.scenes.small import series_exponential
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


components = st.floats(-2, 2)


@given(motion=st.tuples(*[components] * 6))
def test_rigid_motion_is_the_exponential_of_the_twist(motion):
    R, t = rigid_motion(motion)
    expected_R, expected_t = series_exponential(motion)
    # Ten squarings lose about 2^10 roundings.
    np.testing.assert_allclose(R, expected_R, atol=1e-11)
    np.testing.assert_allclose(t, expected_t, atol=1e-11)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)


@pytest.mark.parametrize("angle", [0.0, 1e-200, 1e-9, 1e-4, 0.00999, 0.01001, 1.0, math.pi, 6.0])
def test_rigid_motion_at_small_and_large_angles(angle):
    T, axis = np.array([0.3, -1.0, 0.7]), np.array([2, -1, 2]) / 3
    R, t = rigid_motion([*T, *(angle * axis)])
    along = (axis @ T) * axis
    across = T - along
    # The arc of a circle: V T rotates and shortens only the part of T across the axis.
    chord = math.sin(angle) / angle if angle > 1e-8 else 1 - angle**2 / 6
    bulge = 2 * math.sin(angle / 2) ** 2 / angle if angle > 1e-8 else angle / 2
    expected = along + chord * across + bulge * np.cross(axis, across)
    np.testing.assert_allclose(t, expected, rtol=0, atol=1e-14)
    assert np.trace(R) == pytest.approx(1 + 2 * math.cos(angle), abs=1e-14)


def test_translation_alone_is_exact():
    R, t = rigid_motion((0.1, 0.2, 0.3, 0, 0, 0))
    assert (np.eye(3) == R).all() and (t == (0.1, 0.2, 0.3)).all()
