"""The effect of a rolling shutter on points and frames, and its correction."""

import cv2
import numpy as np
import pytest

from tisfm.camera import Camera
from tisfm.rigid import pose_matrix
from tisfm.shutter import (
    GlobalShutterFrameMap,
    RollingShutterMotion,
    frame_instants,
    motion_rates,
    move_by_twist,
    points_at_middle_row,
)

CAMERA, SHAPE = Camera(focal=120.0, center=(83.0, 55.0)), (121, 160)
TWIST = np.array([0.1, -0.04, 0.16, 0.08, -0.12, 0.1])


def moved(points, twist):
    matrix = pose_matrix(twist)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize("twist", [TWIST, TWIST * (1, 1, 1, 0, 0, 0), TWIST * (0, 0, 0, 1, 1, 1)])
def test_points_are_moved_as_rigid_motions_move_them(twist):
    points = np.random.default_rng(0).normal(size=(7, 3))
    times = np.linspace(-1.5, 2, 7)
    for point, time, found in zip(points, times, move_by_twist(points, twist, times), strict=True):
        np.testing.assert_allclose(found, moved(point, time * twist), atol=1e-12)


def test_times_of_every_second_frame_are_in_intervals_of_the_source():
    numbers = [0, 2, 4, 6]
    instants = frame_instants(numbers, [1.0, 1.08, 1.16, 1.28])  # the last frame is late
    np.testing.assert_allclose(instants, [0, 2, 4, 7])
    for times in ([1.0, None, 1.16, 1.28], [1.0, 1.08, 1.08, 1.28]):
        np.testing.assert_array_equal(frame_instants(numbers, times), numbers)


def test_rates_of_a_steady_motion_are_its_twist():
    instants = np.array([0, 1, 2.5, 3, 7])
    poses = {k: np.linalg.inv(pose_matrix(at * TWIST)) for k, at in enumerate(instants)}
    del poses[1]  # a frame without a pose
    rates = motion_rates(poses, instants)
    assert sorted(rates) == [0, 2, 3, 4]
    for rate in rates.values():
        np.testing.assert_allclose(rate, TWIST, atol=1e-9)


def test_rates_beside_a_long_gap_are_those_of_the_near_side():
    """The camera turns to and fro, and its motion in the gap is unknown."""
    poses = {k: pose_matrix((0, 0, 0, 0, 0.1 * (-1) ** k, 0)) for k in [*range(8), *range(27, 35)]}
    rates = motion_rates(poses, np.arange(40))
    np.testing.assert_allclose(rates[7][4], 0.2, atol=1e-9)
    np.testing.assert_allclose(rates[27][4], -0.2, atol=1e-9)


def test_points_that_would_be_behind_stay():
    rate = np.array([0, 0, -5.0, 0, 0, 0])  # it comes nearer by more than both depths
    points = np.array([[80.0, 0.0], [80.0, 120.0]])
    moved = points_at_middle_row(points, np.array([2.0, 2.0]), -rate, 0.9, CAMERA, SHAPE)
    np.testing.assert_array_equal(moved[1], points[1])
    assert np.isfinite(moved).all() and moved[0, 1] > 0


def test_frame_alone_has_no_rate():
    assert motion_rates({4: np.eye(4)}, np.arange(5)) == {}


@pytest.mark.parametrize("readout", [0.9, -0.5])
def test_points_go_to_where_the_middle_row_would_have_them(readout):
    random = np.random.default_rng(1)
    world = random.uniform((-1, -1, 3), (1, 1, 6), (40, 3))  # as seen at the middle row
    cx, cy = CAMERA.center
    # The row that reads a point, by fixed-point iteration.
    row = np.full(40, SHAPE[0] / 2)
    for _ in range(60):
        late = readout * (row - (SHAPE[0] - 1) / 2) / SHAPE[0]
        there = np.array([moved(p, t * TWIST) for p, t in zip(world, late, strict=True)])
        row = 120 * there[:, 1] / there[:, 2] + cy
    seen = np.column_stack([120 * there[:, 0] / there[:, 2] + cx, row])
    middle = 120 * world[:, :2] / world[:, 2:] + (cx, cy)
    assert np.abs(seen - middle).max() > 1
    found = points_at_middle_row(seen, there[:, 2], TWIST, readout, CAMERA, SHAPE)
    np.testing.assert_allclose(found, middle, atol=1e-8)


def test_corrected_frame_is_the_view_of_its_middle_row():
    """The scene is a plane with a smooth pattern, in front of the camera."""
    depth, readout = 4.0, 0.8
    rolling = RollingShutterMotion(
        camera=CAMERA, readout=readout, rates={3: TWIST}, inverse_depth={3: 1 / depth}
    )
    height, width = SHAPE
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))

    def pattern(x, y):
        return 120 + 50 * np.sin(x / 9) * np.cos(y / 7)

    taken = np.column_stack([x.ravel(), y.ravel()])
    # Pixels of the frame are points of a surface that is a plane at the middle row.
    middle = points_at_middle_row(taken, np.full(len(taken), depth), TWIST, readout, CAMERA, SHAPE)
    frame = pattern(*middle.T).reshape(SHAPE).astype(np.float32)
    made = GlobalShutterFrameMap(rolling, 3, SHAPE)
    found = made.apply(frame)
    off = np.abs(found - pattern(x, y))[made.valid]
    assert np.abs(frame - pattern(x, y)).mean() > 5
    # Depth of the frame differs a little from that of the plane.
    assert off.mean() < 0.25 and off.max() < 3
    assert 0.8 < made.valid.mean() < 1


def test_frame_with_a_global_shutter_stays():
    rolling = RollingShutterMotion(
        camera=CAMERA, readout=0.0, rates={0: TWIST}, inverse_depth={0: 0.3}
    )
    made = GlobalShutterFrameMap(rolling, 0, SHAPE)
    frame = cv2.randu(np.zeros(SHAPE, np.uint8), 0, 255)
    assert made.valid.all()
    np.testing.assert_array_equal(made.apply(frame), frame)
