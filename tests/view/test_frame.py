"""A frame as it is looked at: flow from depth and motion, and what is known of a pixel."""

import numpy as np
import pytest

from tests.view.results import DEVIATION, film, write_reconstruction, write_run
from tisfm.camera import Camera
from tisfm.results.frame import ResultFrame
from tisfm.results.opening import open_result
from tisfm.rigid import pose_matrix
from tisfm.status import Status


@pytest.fixture
def reconstruction(tmp_path):
    write_reconstruction(tmp_path / "r", things=True)
    return open_result(tmp_path / "r")


def true_flow(shot, k, row, column):
    """Move a pixel by its true depth and the true poses."""
    cx, cy = shot.camera.center_for(*shot.depth[k].shape)
    focal = shot.camera.focal
    point = shot.depth[k][row, column] * np.array([(column - cx) / focal, (row - cy) / focal, 1])
    moved = np.linalg.inv(shot.poses[k + 1]) @ shot.poses[k] @ np.append(point, 1)
    return focal * moved[:2] / moved[2] + (cx, cy) - (column, row)


@pytest.mark.parametrize("pixel", [(0, 0), (44, 60), (22, 31)])
def test_flow_of_a_reconstruction_is_that_of_its_depth_and_path(tmp_path, pixel):
    write_reconstruction(tmp_path / "r")
    frame = open_result(tmp_path / "r").read(1)
    expected = true_flow(film(), 1, *pixel)
    assert frame.flow[pixel] == pytest.approx(expected, abs=0.02)  # depth has 11 bits
    assert frame.reading(*pixel).flow == pytest.approx(expected, abs=0.02)


def test_tau_is_the_motion_over_depth(reconstruction):
    frame = reconstruction.read(0)
    reading = frame.reading(30, 40)
    poses = film().poses
    twist = frame.motions[0][0]
    assert reading.tau * reading.depth == pytest.approx(twist[:3], rel=1e-3)
    assert reading.omega == pytest.approx(twist[3:])
    step = np.linalg.inv(poses[1]) @ poses[0]
    assert frame.motions[0][1] == pytest.approx(step)
    assert reading.tau_std == pytest.approx(np.abs(reading.tau) * DEVIATION, rel=2e-3)
    assert reading.depth_std == pytest.approx(DEVIATION * reading.depth, rel=2e-3)


def test_the_deviation_of_flow_is_its_change_with_depth(reconstruction):
    frame = reconstruction.read(0)
    reading = frame.reading(30, 40)
    row, column = np.array([30]), np.array([40])
    pose, deviation = frame.motions[0][1], frame.inverse_depth_std[30, 40]
    before = frame._flow_and_slope(row, column, pose)[0][0]
    frame.inverse_depth[30, 40] += deviation
    after = frame._flow_and_slope(row, column, pose)[0][0]
    assert reading.flow_std == pytest.approx(np.abs(after - before), rel=0.1, abs=1e-3)


def test_an_object_has_its_own_motion(reconstruction):
    frame = reconstruction.read(0)
    poses = film().poses
    expected = np.linalg.inv(poses[1]) @ np.array(
        [[1, 0, 0, 0.2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    )
    assert frame.motions[2][1] == pytest.approx(expected @ poses[0])
    inside, outside = frame.reading(15, 15), frame.reading(30, 40)
    assert (inside.label, outside.label) == (2, 0)
    assert inside.tau * inside.depth == pytest.approx(frame.motions[2][0][:3], rel=1e-3)
    assert set(reconstruction.read(4).motions) == set()  # no frame follows the last one


def test_a_frame_without_a_pose_has_no_motion(tmp_path):
    poses, piece = film().poses.copy(), np.zeros(5, np.int32)
    poses[2], piece[2] = np.nan, -1
    write_reconstruction(tmp_path / "r", changes={"poses": poses, "piece": piece})
    result = open_result(tmp_path / "r")
    for number, known in ((0, True), (1, False), (2, False), (3, True)):
        frame = result.read(number)
        assert (frame.flow is not None) == known
        assert (frame.reading(5, 5).tau is not None) == known
        assert frame.reading(5, 5).depth > 0


def test_a_pair_has_the_stored_values(tmp_path):
    write_run(tmp_path / "r")
    frame = open_result(tmp_path / "r").read(0)
    reading = frame.reading(10, 20)
    assert reading.flow == pytest.approx((2, -1), abs=1e-3)
    assert reading.confidence == pytest.approx(20 / 60, abs=2e-3)
    assert reading.tau * reading.depth == pytest.approx(frame.motions[0][0][:3], abs=2e-3)
    assert not reading.hidden and frame.reading(10, 1).hidden


def test_a_field_has_no_deviations(tmp_path):
    write_run(tmp_path / "r", motion="field")
    result = open_result(tmp_path / "r")
    reading = result.read(0).reading(10, 20)
    assert reading.tau is not None and reading.omega is not None
    assert reading.tau_std is reading.flow_std is reading.depth_std is reading.label is None
    assert result.quantities == ("confidence",)


@pytest.mark.parametrize("pixel", [(-1, 0), (0, -1), (45, 0), (0, 61)])
def test_a_pixel_outside_is_refused(tmp_path, pixel):
    write_run(tmp_path / "r", 1)
    with pytest.raises(IndexError, match="column below 61 and a row below 45"):
        open_result(tmp_path / "r").read(0).reading(*pixel)


def test_flow_is_that_of_a_point_seen_from_two_poses():
    random = np.random.default_rng(1)
    inverse = random.uniform(0.3, 1, (17, 23)).astype(np.float32)
    inverse[3, 4] = np.nan
    first, second = (pose_matrix(random.normal(scale=0.05, size=6)) for _ in range(2))
    frame = ResultFrame(
        number=0,
        picture=np.zeros((17, 23, 3), np.uint8),
        camera=Camera(focal=50.0, center=(10.0, 8.0)),
        inverse_depth=inverse,
        status=Status("converged"),
        motions={0: (np.zeros(6), np.linalg.inv(second) @ first)},
    )
    assert np.isnan(frame.flow[3, 4]).all()
    for y, x in ((0, 0), (9, 20), (16, 11)):
        ray = np.array([(x - 10) / 50, (y - 8) / 50, 1, inverse[y, x]]) / inverse[y, x]
        there = np.linalg.inv(second) @ first @ ray
        seen = 50 * there[:2] / there[2] + (10, 8)
        np.testing.assert_allclose(frame.flow[y, x], seen - (x, y), atol=1e-4)
    still = frame.flow_of_motion(np.eye(4), frame.has_depth)
    np.testing.assert_allclose(still, 0, atol=1e-4)
