"""What frames say of their motions and of the depth that they share."""

import numpy as np
import pytest

from bench import reference
from tests.lanes import LANES
from tests.pairwise import pairwise
from tisfm.camera import Camera
from tisfm.rigid import rigid_motion

SIZES = [(5, 1), (7, 9), (13, 37), (6, 64)]
TWIST = (0.4, -0.3, 0.8, 0.02, -0.05, 0.03)


@pytest.mark.parametrize("component", range(7))
def test_reference_jacobian_is_the_change_of_the_flow(component):
    camera, size, step = Camera(focal=40.0), (6, 9), 1e-5
    rotation, translation = rigid_motion(TWIST)
    inverse_depth = 40 * np.random.default_rng(0).uniform(0.3, 2, size)

    def flow(change):
        turn, shift = rigid_motion(change[:6])
        moved = turn @ rotation, turn @ translation + shift
        return reference.displacement(inverse_depth + change[6], camera, *moved)

    change = step * np.eye(7)[component]
    expected = (flow(change) - flow(-change)) / (2 * step)
    found = reference.motion_jacobian(inverse_depth, camera, rotation, translation)[:, component]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pairwise(size=SIZES, lanes=LANES, tolerated=[np.inf, 40.0])
def test_add_frame(size, lanes, tolerated, make_problem):
    from tisfm.kernels.rigid.shared_depth import add_frame

    problem = make_problem(*size, 1, lanes, channels=2)
    terms = reference.tensors_of([problem.constraints])
    tensor = terms[0]
    inverse_depth = np.abs(problem.rho) + 1
    rng = np.random.default_rng(7)
    weight = rng.uniform(0, 1, (1, *size)).astype(np.float32)
    before = rng.uniform(0, 1, (2, *size)).astype(np.float32)
    pose = rigid_motion(TWIST)
    grid = problem.grid
    slopes, sums = grid.allocate(12), problem.to_lanes(before)
    matrix, vector = add_frame(
        grid,
        problem.to_lanes(tensor),
        problem.to_lanes(inverse_depth),
        problem.to_lanes(weight),
        problem.unknowns.x_hat,
        problem.unknowns.y_hat,
        slopes,
        sums,
        number=1,
        motion=np.column_stack(pose).astype(np.float32),
        focal=problem.camera.focal,
        quarter_weight_residual=tolerated,
    )
    moved = reference.displacement(inverse_depth[0], problem.camera, *pose)
    identity = reference.motion_matrix(problem.camera, *size, 2)
    square = np.maximum(reference.residual(tensor, identity, moved), 0)
    trusted = tensor * weight[0] / (1 + square / tolerated) ** 2
    expected = reference.frame_equations(trusted, inverse_depth[0], problem.camera, *pose)
    found = matrix, vector, problem.from_lanes(slopes)[6:], problem.from_lanes(sums) - before
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-4 * np.abs(wanted).max())


@pairwise(size=SIZES, lanes=LANES, frames=[1, 3])
def test_answered(size, lanes, frames, make_problem):
    from tisfm.kernels.rigid.shared_depth import eliminate_depth

    problem = make_problem(*size, 1, lanes)
    rng = np.random.default_rng(3)
    slopes = rng.normal(size=(6 * frames, *size)).astype(np.float32)
    sums = rng.uniform(0.1, 2, (2, *size)).astype(np.float32)
    matrix, vector = eliminate_depth(
        problem.grid, problem.to_lanes(slopes), problem.to_lanes(sums), depth_stiffness=0.5
    )
    rows = slopes.reshape(6 * frames, -1).astype(float)
    curvature, gradient = sums.reshape(2, -1).astype(float)
    expected = (rows / (curvature + 0.5)) @ rows.T
    np.testing.assert_allclose(matrix, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    pull = rows @ (gradient / (curvature + 0.5))
    np.testing.assert_allclose(vector, pull, rtol=1e-4, atol=1e-4 * np.abs(pull).max())


@pairwise(size=SIZES, lanes=LANES)
def test_squared_residual(size, lanes, make_problem):
    from tisfm.kernels.rigid.shared_depth import squared_residual

    problem = make_problem(*size, 2, lanes, channels=2)
    (tensor,) = reference.tensors_of([problem.constraints])
    out = problem.grid.allocate(1)
    squared_residual(problem.grid, problem.to_lanes(tensor), problem.to_lanes(problem.rho), out)
    identity = reference.motion_matrix(problem.camera, *size, 2)
    expected = reference.residual(tensor, identity, problem.rho)
    scale = np.abs(tensor[5]).max()
    np.testing.assert_allclose(problem.from_lanes(out)[0], expected, rtol=1e-3, atol=1e-5 * scale)
