"""Images in lanes, flow, prolongation and fields of motion, against the NumPy reference."""

import numpy as np
import pytest

from bench import reference
from tests.kernels.compared import MODELS, SIZES, close, each_lanes, each_size, of_each, padding
from tests.lanes import LANES
from tests.pairwise import pairwise


@each_size
@each_lanes
def test_images_go_into_lanes_and_back(size, lanes, make_problem):
    from tisfm.kernels.layout.images import IMAGE_HALO, image_to_lanes, lanes_to_images

    problem = make_problem(*size, 6, lanes)
    grid = problem.grid
    image = np.random.default_rng(1).normal(size=size).astype(np.float32)
    array = grid.allocate(1, halo=IMAGE_HALO)
    image_to_lanes(grid, image, array)
    rows = np.clip(np.arange(-IMAGE_HALO, size[0] + IMAGE_HALO), 0, size[0] - 1)
    for lane in range(lanes):
        columns = np.clip(
            lane * grid.strip_width + np.arange(-IMAGE_HALO, grid.strip_width + IMAGE_HALO),
            0,
            size[1] - 1,
        )
        in_lane = array[0] if lanes == 1 else array[0, ..., lane]
        np.testing.assert_array_equal(in_lane, image[np.ix_(rows, columns)])

    stack = np.empty((6, *size), np.float32)
    lanes_to_images(grid, problem.unknowns.rho, stack)
    np.testing.assert_array_equal(stack, problem.rho)

    lanes_to_images(grid, problem.unknowns.rho, stack[:2], component=3)
    np.testing.assert_array_equal(stack[:2], problem.rho[3:5])
    with pytest.raises(ValueError, match="component is 5: array has 6, and out takes 2"):
        lanes_to_images(grid, problem.unknowns.rho, stack[:2], component=5)


@each_size
@each_lanes
def test_multiply(size, lanes, make_problem):
    from tisfm.kernels.layout.images import multiply

    problem = make_problem(*size, 6, lanes)
    grid, rho = problem.grid, problem.unknowns.rho
    factor = problem.to_lanes(np.random.default_rng(1).normal(size=(6, *size)))
    expected = rho * factor
    multiply(grid, factor, rho)
    np.testing.assert_array_equal(rho, expected)
    expected = rho * factor[:1]
    multiply(grid, factor[:1], rho)
    np.testing.assert_array_equal(rho, expected)
    with pytest.raises(ValueError, match="factor has 2 components: expected 1 or 6"):
        multiply(grid, grid.allocate(2), rho)


@of_each
def test_flow(size, components, lanes, make_problem):
    problem = make_problem(*size, components, lanes)
    out = problem.grid.allocate(2)
    problem.unknowns.bind_flow(out)()
    close(problem.from_lanes(out), reference.flow(problem.motion, problem.rho))


@each_size
@pytest.mark.parametrize("components", [3, 6])
@pytest.mark.parametrize("by_pixel", [False, True])
def test_motion_fields(size, components, by_pixel, make_problem):
    from tisfm.kernels.model.readout import motion_fields

    problem = make_problem(*size, components, 1)
    camera, rho = problem.camera, problem.rho.astype(np.float32)
    cx, cy = camera.center_for(*size)
    x_hat = ((np.arange(size[1]) - cx) / camera.focal).astype(np.float32)
    y_hat = ((np.arange(size[0]) - cy) / camera.focal).astype(np.float32)
    flow, inverse_depth = np.empty((2, *size), np.float32), np.empty(size, np.float32)
    options = {"focal": camera.focal, "by_pixel": by_pixel}
    motion_fields(rho, x_hat, y_hat, flow, inverse_depth, **options)
    close(flow, reference.flow(problem.motion, problem.rho))
    expected = np.linalg.norm(problem.rho[:3], axis=0) / camera.focal
    np.testing.assert_allclose(inverse_depth, expected, rtol=1e-6)
    with pytest.raises(ValueError, match="rho has 2 components: expected 3 or 6"):
        motion_fields(rho[:2], x_hat, y_hat, flow, inverse_depth, **options)


@pytest.mark.parametrize("size", [*SIZES, (24, 64), (25, 63), (27, 66)], ids=str)
@pytest.mark.parametrize("factor", [2, 4])
def test_enlarged_is_prolonged(size, factor):
    from tisfm.solver.sampling import enlarge, shrink

    for up in (0, 1):  # sizes of levels are rounded, either way
        shape = tuple(max(1, side // factor + up) for side in size)
        coarse = np.random.default_rng(6).normal(size=(3, *shape)).astype(np.float32)
        expected = reference.prolong(coarse.astype(np.float64), size, 1 / factor)
        close(enlarge(factor * coarse, factor, *size), expected, scale=10)
        # A ramp is where it was.
        ramp = np.arange(size[1], dtype=np.float32)[None].repeat(size[0], axis=0)
        within = np.arange(min(shape[1], size[1] // factor))
        means = shrink(ramp[None], factor, *shape)[0, 0, : len(within)]
        close(means, factor * (within + 0.5) - 0.5)


@pairwise(size=[*SIZES, (12, 64), (10, 32)], components=MODELS, lanes=LANES, ratio=[0.5, 0.73, 1.0])
def test_prolong(size, components, lanes, ratio, make_problem):
    from tisfm.kernels.layout.lanes import LaneGrid
    from tisfm.solver.unknowns import Unknowns

    problem = make_problem(*size, components, lanes)
    shape = tuple(max(1, round(ratio * side)) for side in size)
    coarse = np.random.default_rng(6).normal(size=(components, *shape)).astype(np.float32)
    below = Unknowns(LaneGrid(*shape, lanes), problem.camera, components)
    below.set_images(coarse)
    problem.unknowns.rho[...] = 0
    problem.unknowns.start_from(below, ratio)
    expected = reference.prolong(coarse.astype(np.float64), size, ratio)
    close(problem.from_lanes(problem.unknowns.rho), expected, scale=10)
    assert not padding(problem, problem.unknowns.rho).any()
