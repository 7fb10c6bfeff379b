"""Errors of the path of a moving thing."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.trajectory.paths import PATIENT, random_path, similar
from tisfm.metrics import object_path_errors, path_length
from tisfm.rigid import nearest_rotation, pose_matrix, rigid_motion
from tisfm.scenes import bodies_film, bodies_path

TURN = rigid_motion([0, 0, 0, 0.4, -1.0, 2.0])[0]
ROUND = pose_matrix([0.1, -0.05, 0.08, 0.3, 1.0, -0.5])  # found axes in those of the body


@cache
def true_paths(count=30):
    cameras = bodies_path(count)
    return bodies_film(cameras, 2, 2, bodies=1, samples=1).body_poses[0], cameras


def found_from(truth, cameras, *, scale=1.0, axes=ROUND):
    """Return what may be found of a body: other axes, and another distance, by 1 / scale."""
    found = truth @ axes
    found[:, :3, 3] = cameras[:, :3, 3] + (found[:, :3, 3] - cameras[:, :3, 3]) / scale
    return found


@PATIENT
@given(
    scale=st.floats(0.05, 20),
    world=st.floats(0.05, 20),
    gaps=st.sets(st.integers(0, 29), max_size=20),
)
def test_scale_axes_and_world_are_no_error(scale, world, gaps):
    truth, cameras = true_paths()
    found = similar(found_from(truth, cameras, scale=scale), 1 / world, TURN, [5, -2, 1])
    found[list(gaps)] = np.nan
    mine = similar(cameras, 1 / world, TURN, [5, -2, 1])
    errors = object_path_errors(found, truth, mine, cameras)
    assert errors.frames == 30 - len(gaps)
    assert errors.scale == pytest.approx(scale, rel=1e-6)
    np.testing.assert_allclose(errors.offset, ROUND[:3, 3], atol=1e-6)
    # Rounding, times the condition number of scale and offset, some hundreds.
    assert errors.position < 1e-9 and errors.share < 1e-9
    assert errors.rotation < 1e-6


def test_errors_are_the_added_ones():
    truth, cameras = true_paths()
    found = found_from(truth, cameras)
    rng = np.random.default_rng(0)
    shifts = rng.normal(0, 0.02, (30, 3))
    found[:, :3, 3] += shifts
    errors = object_path_errors(found, truth, cameras, cameras)
    # Four unknowns take up some of what 90 numbers are off by.
    made = np.sqrt(np.square(shifts).sum(axis=1).mean())
    assert 0.9 * made < errors.position < made
    assert errors.share == pytest.approx(errors.position / path_length(truth))
    assert errors.rotation < 1e-6
    # Each second frame turned by 4° one way, and the others the other way.
    for k in range(30):
        found[k, :3, :3] = (
            found[k, :3, :3] @ rigid_motion([0, 0, 0, np.radians(4 * (-1) ** k), 0, 0])[0]
        )
    assert object_path_errors(found, truth, cameras, cameras).rotation == pytest.approx(4)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_nearest_rotation_does_not_mirror(sign):
    random = np.random.default_rng(7)
    others = Rotation.random(200, random_state=8).as_matrix()
    for _ in range(20):
        matrix = random.normal(size=(3, 3))
        matrix *= sign * np.sign(np.linalg.det(matrix))
        nearest = nearest_rotation(matrix)
        assert np.linalg.det(nearest) == pytest.approx(1)
        np.testing.assert_allclose(nearest @ nearest.T, np.eye(3), atol=1e-12)
        traces = np.einsum("nij,ij->n", others, matrix)  # of Rᵀ M
        assert np.sum(nearest * matrix) >= traces.max()


def test_a_scale_that_drifts_is_an_error():
    truth, cameras = true_paths()
    found = found_from(truth, cameras, axes=np.eye(4))
    away = found[:, :3, 3] - cameras[:, :3, 3]
    found[:, :3, 3] = cameras[:, :3, 3] + away * np.linspace(0.9, 1.1, 30)[:, None]
    errors = object_path_errors(found, truth, cameras, cameras)
    assert errors.scale == pytest.approx(1, abs=0.1)
    assert 0.02 < errors.share < 0.2


def test_a_moving_object_that_is_reported_at_rest_is_wrong():
    truth, cameras = true_paths()
    found = np.tile(truth[10], (30, 1, 1))
    errors = object_path_errors(found, truth, cameras, cameras)
    assert errors.share > 0.05 and errors.rotation > 10


def test_a_camera_on_a_straight_line_does_not_turn_the_world():
    truth, _ = true_paths()
    cameras = np.tile(np.eye(4), (30, 1, 1))
    cameras[:, 0, 3] = 0.02 * np.arange(30)
    mine = cameras.copy()
    mine[:, 1:3, 3] += np.random.default_rng(1).normal(0, 1e-5, (30, 2))  # a line but for this
    errors = object_path_errors(found_from(truth, cameras), truth, mine, cameras)
    assert errors.position < 1e-4 and errors.rotation < 1e-6


def test_a_camera_or_a_body_that_rests():
    truth, cameras = true_paths()
    still = np.tile(cameras[0], (30, 1, 1))
    errors = object_path_errors(found_from(truth, still, scale=3.0), truth, still, still)
    assert errors.position < 1e-9 and errors.scale == pytest.approx(3)
    at_rest = np.tile(truth[0], (30, 1, 1))
    errors = object_path_errors(at_rest, at_rest, cameras, cameras)
    assert errors.share is None and errors.position < 1e-9
    # Scale and offset cannot be told apart: what is nearest to 1 and 0.
    errors = object_path_errors(at_rest, at_rest, still, still)
    assert errors.scale == pytest.approx(1) and np.allclose(errors.offset, 0)


def test_a_path_that_goes_backwards_has_no_negative_scale():
    truth, cameras = true_paths()
    found = found_from(truth, cameras, scale=-1.0, axes=np.eye(4))
    errors = object_path_errors(found, truth, cameras, cameras)
    assert errors.scale == 0 and errors.position > 0.05


def test_inputs_stay_and_frames_may_be_too_few():
    truth, cameras = true_paths(5)
    paths = [found_from(truth, cameras), truth, cameras, cameras.copy()]
    before = [path.copy() for path in paths]
    assert object_path_errors(*paths).frames == 5
    for path, old in zip(paths, before, strict=True):
        np.testing.assert_array_equal(path, old)
    for place in range(4):
        less = [path.copy() for path in paths]
        less[place][:3] = np.nan
        assert object_path_errors(*less) is None


def test_errors_name_the_argument():
    path = random_path(np.random.default_rng(0), 4)
    with pytest.raises(ValueError, match="are of 4, 3, 4, 4 frames: expected the same number"):
        object_path_errors(path, path[1:], path, path)
    with pytest.raises(ValueError, match=r"cameras are \(4, 3, 4\): expected \(N, 4, 4\)"):
        object_path_errors(path, path, path[:, :3], path)
    masked = np.ma.array(path, mask=np.zeros_like(path))
    masked[2] = np.ma.masked
    with pytest.raises(ValueError, match="poses has 16 of 64 values masked"):
        object_path_errors(masked, path, path, path)
