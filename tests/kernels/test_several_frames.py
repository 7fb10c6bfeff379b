"""The data of several frames added up in one inverse depth."""

import numpy as np
import pytest

from bench import reference
from tests.kernels.test_epipolar import SIZES
from tests.lanes import LANES
from tests.pairwise import pairwise


@pairwise(size=SIZES, lanes=LANES, count=[1, 3])
def test_constraints_of_frames_are_added(size, lanes, count, make_problem):
    from tisfm.kernels.rigid.shared_depth import add_depth_terms, depth_constraint

    problem = make_problem(*size, 1, lanes)
    grid, depth = problem.grid, problem.rho[0]
    sums = grid.allocate(3)
    expected = np.zeros((3, *size))
    for frame in range(count):
        rng = np.random.default_rng(frame)
        flow, direction = rng.normal(size=(2, 2, *size)).astype(np.float32).astype(float)
        lines = rng.normal(size=(2, 3, *size))
        tensor = reference.tensors_of([lines])[0].astype(np.float32)
        weight = rng.random(size).astype(np.float32)
        add_depth_terms(
            grid, problem.to_lanes(tensor), problem.to_lanes(flow), problem.to_lanes(direction),
            problem.unknowns.rho, problem.to_lanes(weight[None]), sums,
        )  # fmt: skip
        restricted = reference.restrict_to_line([tensor.astype(float)], flow, direction, depth)[0]
        expected += weight * restricted[[0, 3, 5]]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(problem.from_lanes(sums), expected, atol=1e-5 * scale)
    constraint = grid.allocate(3)
    depth_constraint(grid, sums, constraint)
    p, zero, c = problem.from_lanes(constraint).astype(float)
    assert not zero.any()
    np.testing.assert_allclose(p * p, expected[0], atol=1e-5 * scale)
    np.testing.assert_allclose(p * c, expected[1], atol=1e-5 * scale)


@pytest.mark.parametrize("lanes", LANES)
def test_pixels_without_data_have_no_constraint(lanes, make_problem):
    from tisfm.kernels.rigid.shared_depth import depth_constraint

    problem = make_problem(5, 7, 1, lanes)
    constraint = problem.grid.allocate(3)
    depth_constraint(problem.grid, problem.grid.allocate(3), constraint)
    assert not problem.from_lanes(constraint).any()
