"""Rigid motions without image motion: the solver against the reference."""

import tracemalloc

import numpy as np
import pytest

import tisfm
from bench import reference
from bench.reference.minimisation import flowless_fields, minimise_over_flowless
from tests.lanes import LANES

ALPHA = 40.0
STIFFNESS = (3.0, 0.5, 1.0, 10.0, 3.0, 0.5)


@pytest.mark.parametrize("components", [6, 3])
def test_they_move_no_pixel(components):
    motion = reference.motion_matrix(tisfm.Camera(focal=30.0), 13, 21, components)
    fields = flowless_fields(motion)
    assert len(fields) == (4 if components == 6 else 1)
    for field in fields:
        assert np.abs(field).max() >= 1
        np.testing.assert_allclose(reference.flow(motion, field), 0, atol=1e-12)


@pytest.mark.parametrize("stiff", [False, True], ids=["even", "stiff"])
@pytest.mark.parametrize("joint", [False, True], ids=["separate", "joint"])
@pytest.mark.parametrize("components", [6, 3])
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("size", [(13, 37), (6, 64)])
def test_the_least_energy_is_that_of_the_reference(
    components, lanes, size, joint, stiff, make_problem
):
    from tisfm.solver.flowless import FlowlessFields

    problem = make_problem(*size, components, lanes)
    stiffness = np.array(STIFFNESS[:components]) if stiff else np.ones(components)
    smoothness = reference.Smoothness(contrast=1.0, stiffness=stiffness, joint=joint)
    weights = reference.edge_weights(problem.rho, smoothness)
    expected = problem.rho.astype(np.float64).copy()
    minimise_over_flowless(problem.motion, weights, expected, ALPHA)
    assert np.abs(expected - problem.rho).max() > 0.1
    # The kernels keep the stiffness apart from b, and one b for all components if edges are joint.
    b = weights.reshape(2, components, *size) / smoothness.stiffnesses(components)
    b = (b[:, :1] if joint else b).reshape(-1, *size)
    FlowlessFields(problem.unknowns).minimise(problem.system(b, alpha=ALPHA, stiffness=stiffness))
    found = problem.from_lanes(problem.unknowns.rho)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_it_takes_little_memory(make_problem):
    """Arrays of float64 cover a band of rows, not the image."""
    from tisfm.solver.flowless import FlowlessFields

    height, width = size = 512, 256
    problem = make_problem(*size, 6, 8)
    fields = FlowlessFields(problem.unknowns)
    system = problem.system(np.ones((12, *size)))
    tracemalloc.start()
    fields.minimise(system)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak <= 8 * 4 * height * width  # 8 float32 a pixel


def test_no_share_of_a_field_lowers_the_energy_further():
    rng = np.random.default_rng(0)
    motion = reference.motion_matrix(tisfm.Camera(focal=30.0), 9, 14, 6)
    rho, weights = rng.normal(size=(6, 9, 14)), rng.uniform(0.1, 1, (12, 9, 14))

    def energy(rho):
        steps = np.stack(reference.differences(rho)).reshape(weights.shape)
        return float((weights * steps**2).sum())

    minimise_over_flowless(motion, weights, rho, ALPHA)
    least = energy(rho)
    for field in flowless_fields(motion):
        assert min(energy(rho + 0.1 * field), energy(rho - 0.1 * field)) > least
