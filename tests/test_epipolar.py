"""Flow along epipolar lines, and motion tensors restricted to them."""

import numpy as np
import pytest

from tisfm import reference
from tisfm.scenes import static_scene
from tisfm.scenes.ready import STATIC_KINDS
from tisfm.scenes.rigid import rigid_motion

SIZES = [(5, 1), (7, 9), (13, 37), (6, 64)]
TWIST = (0.4, -0.3, 0.8, 0.02, -0.05, 0.03)

each_size = pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
each_lanes = pytest.mark.parametrize("lanes", [8, 1])


@pytest.mark.parametrize("kind", STATIC_KINDS)
def test_reference_displacement_is_the_flow_of_a_scene(kind):
    scene = static_scene(kind, 40, 60)
    rotation, translation = rigid_motion(scene.motions[0])
    inverse_depth = scene.camera.focal / scene.depth
    flow = reference.displacement(inverse_depth, scene.camera, rotation, translation)
    np.testing.assert_allclose(flow, np.moveaxis(scene.flow, -1, 0), atol=1e-9)


@each_size
@each_lanes
def test_displacement_and_direction(size, lanes, make_problem):
    from tisfm.kernels.epipolar import displacement

    problem = make_problem(*size, 1, lanes)
    field = problem.field
    inverse_depth = np.abs(problem.rho) + 1
    field.rho[...] = problem.to_lanes(inverse_depth)
    rotation, translation = rigid_motion(TWIST)
    flow, direction = problem.grid.allocate(2), problem.grid.allocate(2)
    displacement(
        problem.grid, field.rho, field.x_hat, field.y_hat, flow, direction,
        motion=np.column_stack([rotation, translation]), focal=problem.camera.focal,
    )  # fmt: skip

    def exact(values):
        return reference.displacement(values[0], problem.camera, rotation, translation)

    expected = exact(inverse_depth)
    # f·(π(…) − x̂) is a difference of numbers of up to f·x̂.
    np.testing.assert_allclose(problem.from_lanes(flow), expected, atol=1e-4, rtol=1e-5)
    step = 1e-4
    slope = (exact(inverse_depth + step) - exact(inverse_depth - step)) / (2 * step)
    np.testing.assert_allclose(problem.from_lanes(direction), slope, atol=2e-6, rtol=1e-5)


@each_size
@each_lanes
@pytest.mark.parametrize("count", [1, 2])
def test_along(size, lanes, count, make_problem):
    from tisfm.kernels.epipolar import along

    problem = make_problem(*size, 1, lanes)
    terms = [make_problem(*size, 1, lanes, seed=k).tensor for k in range(count)]
    rng = np.random.default_rng(3)
    flow, direction = rng.normal(size=(2, 2, *size)).astype(np.float32).astype(np.float64)
    out = problem.grid.allocate(6 * count)
    along(
        problem.grid, problem.to_lanes(np.concatenate(terms)), problem.to_lanes(flow),
        problem.to_lanes(direction), problem.field.rho, out,
    )  # fmt: skip
    expected = reference.along(terms, flow, direction, problem.rho[0])
    actual = problem.from_lanes(out).reshape(count, 6, *size)
    identity = reference.motion_matrix(problem.camera, *size, 2)
    moved = np.stack([problem.rho[0] + 0.7, np.zeros(size)])
    for term, found, wanted in zip(terms, actual, expected, strict=True):
        for component, values in zip(found, wanted, strict=True):
            scale = max(float(np.abs(values).max()), 1.0)
            np.testing.assert_allclose(component, values, atol=1e-5 * scale)
        # What it is for: the same quadratic form, in D alone.
        np.testing.assert_allclose(
            reference.data_energy(wanted, identity, moved),
            reference.data_energy(term, identity, flow + 0.7 * direction),
            rtol=1e-9,
        )


@pytest.mark.parametrize("motion", [np.eye(3), np.full((3, 4), np.nan)])
def test_motion_is_checked(motion):
    from tisfm.kernels.epipolar import motion_table

    with pytest.raises(ValueError, match="expected a \\(3, 4\\) matrix"):
        motion_table(motion)
