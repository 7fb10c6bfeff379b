"""The linear system, its sweeps, the update of its weights, precision, against the reference."""

import numpy as np
import pytest

from bench import reference
from tests.kernels.compared import (
    KINDS,
    MODELS,
    SIZES,
    close,
    each_lanes,
    each_model,
    each_size,
    kernel_weights,
    padding,
    smoothness_of,
)
from tests.lanes import LANES
from tests.pairwise import pairwise


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"scales": (0.0,)}, "scales"),
        ({"scales": (1.0, 1.0, 1.0)}, "scales"),
        ({"contrast": 0.0}, "contrast is 0"),
    ],
)
def test_a_weight_update_refuses_bad_values(change, match, make_problem):
    problem = make_problem(5, 7, 3, 1)
    system, unknowns = problem.system(np.ones((6, 5, 7))), problem.unknowns
    constraints = problem.to_lanes(problem.constraints[0])
    options = {"contrast": 1.0, "scales": (1.0,)} | change
    with pytest.raises(ValueError, match=match):
        system.bind_weight_update(
            unknowns.rho, problem.grid.allocate(3), constraints, unknowns.edges, **options
        )


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"stiffness": (1.0, 1.0, 0.0)}, "stiffness is .*: expected 3 positive numbers"),
        ({"stiffness": (1.0, 1.0, np.inf)}, "expected 3 positive numbers"),
        ({"stiffness": np.zeros(3, np.float32)}, "expected 3 positive numbers"),
        ({"stiffness": (1.0, 1.0)}, "weights has 6 components: expected 2, or 2 for each of 2"),
        ({"alpha": -1.0}, "alpha is .*: expected 3 positive numbers"),
        ({"alpha": np.nan}, "alpha is .*: expected 3 positive numbers"),
        (
            {"tensor": np.zeros((5, 7, 9), np.float32)},
            r"tensor is \(5, 7, 9\): expected \(6, 7, 10\)",
        ),
        ({"tensor": None}, "tensor is NoneType: expected a NumPy array"),
        ({"x_hat": np.zeros(9, np.float32)}, "x_hat is"),
        ({"y_hat": np.zeros(9, np.float32)}, "y_hat is"),
    ],
)
def test_a_linear_system_is_checked_at_construction(change, match, make_problem):
    from dataclasses import replace

    system = make_problem(5, 7, 3, 1).system(np.ones((6, 5, 7)))
    with pytest.raises((TypeError, ValueError), match=match):
        replace(system, **change)


def test_tensor_and_weights_cannot_be_swapped(make_problem):
    """Of equal shapes they would, by position: they are named."""
    from tisfm.kernels.solve.linear_system import LinearSystem

    problem = make_problem(5, 7, 3, 1)
    system = problem.system(np.ones((6, 5, 7)))
    arrays = (system.tensor, system.weights, system.x_hat, system.y_hat)
    with pytest.raises(TypeError, match="positional"):
        LinearSystem(problem.grid, *arrays, 1.0, (1.0, 1.0, 1.0))


@pairwise(
    ways=3,
    size=[*SIZES, (64, 9), (131, 20)],
    components=MODELS,
    lanes=LANES,
    kind=KINDS,
    solver=["cholesky", "closed_form"],
    relaxation=[1.0, 1.9],
    short=True,
)
def test_one_sweep_is_the_reference_sweep(
    size, components, lanes, solver, kind, relaxation, make_problem
):
    """On one band of rows, and on several (from 64 rows on)."""
    problem = make_problem(*size, components, lanes, channels=2)
    # Condition numbers of B up to about 100, whatever the least g and s_k.
    rho, alpha = problem.unknowns.rho, 40.0 if kind == "paper" else 1000.0
    smoothness, stiffness, _ = smoothness_of(problem, 1.0, kind)
    weights = reference.edge_weights(problem.rho, smoothness)
    system = problem.system(
        kernel_weights(problem, problem.rho, smoothness), alpha=alpha, stiffness=stiffness
    )
    system.sweep(rho, relaxation=relaxation, solver=solver)
    expected = problem.rho.copy()
    reference.sweep_red_black(
        problem.tensor, problem.motion, weights, expected, alpha=alpha, relaxation=relaxation
    )
    np.testing.assert_allclose(problem.from_lanes(rho), expected, rtol=1e-4, atol=1e-4)
    assert np.abs(expected - problem.rho).max() > 0.1
    np.testing.assert_array_equal(rho, problem.to_lanes(problem.from_lanes(rho)))


@pairwise(components=MODELS, lanes=LANES, solver=["cholesky", "closed_form"], joint=[True, False])
def test_a_pixel_without_an_open_edge_goes_by_its_data(
    components, lanes, solver, joint, make_problem
):
    problem = make_problem(6, 16, components, lanes)
    closed = np.zeros((2 if joint else 2 * components, 6, 16))
    system = problem.system(closed, stiffness=np.geomspace(0.5, 10, components))
    system.sweep(problem.unknowns.rho, relaxation=1.0, solver=solver, sweeps=20)
    found = problem.from_lanes(problem.unknowns.rho).astype(float)
    motion = np.zeros((2, 1, 6, 16)) if components == 1 else problem.motion
    if components == 1:
        motion[0] = 1
    ix, iy = np.sqrt(problem.tensor[0]), np.sqrt(problem.tensor[2])
    iy *= np.sign(problem.tensor[1])
    it = np.sqrt(problem.tensor[5]) * np.sign(problem.tensor[3])
    u, v = reference.flow(motion, found)
    # A channel is one equation, of which there are solutions for every model.
    assert np.abs(ix * u + iy * v + it).max() < 0.1 * np.abs(it).max()
    assert np.abs(found).max() < 1e3


@each_lanes
@each_model
def test_both_solvers_agree_after_many_sweeps(lanes, components, make_problem):
    results = []
    for solver in ("cholesky", "closed_form"):
        problem = make_problem(19, 43, components, lanes)
        weights = reference.edge_weights(problem.rho, reference.Smoothness(contrast=0.3))
        rho = problem.unknowns.rho
        problem.system(weights, alpha=40.0).sweep(rho, relaxation=1.5, solver=solver, sweeps=50)
        results.append(problem.from_lanes(rho))
    difference = np.linalg.norm(results[0] - results[1]) / np.linalg.norm(results[0])
    assert difference < 1e-4


@pairwise(
    ways=3,
    size=SIZES,
    components=MODELS,
    contrast=[0.03, 0.3, 600.0, np.inf],
    data=["quadratic", "gradient", "one quadratic", "both"],
    lanes=LANES,
    kind=KINDS,
    short=True,
)
def test_weight_update(size, components, contrast, data, lanes, kind, make_problem):
    count, scales = {
        "quadratic": (1, (np.inf,)),
        "gradient": (2, (5.0,)),
        "one quadratic": (3, (3.0, np.inf)),
        "both": (3, (3.0, 50.0)),
    }[data]
    problem = make_problem(*size, components, lanes)
    constraints = make_problem(*size, components, lanes, seed=1, channels=count).constraints
    split = [constraints] if count < 3 else [constraints[:1], constraints[1:]]
    terms = reference.tensors_of(split)
    smoothness, stiffness, edges = smoothness_of(problem, contrast, kind)
    before = np.random.default_rng(5).normal(size=problem.rho.shape).astype(np.float32)
    old_weights = reference.edge_weights(before.astype(float), smoothness)
    problem.tensor_lanes[...] *= 0.5
    system = problem.system(
        kernel_weights(problem, before.astype(float), smoothness), alpha=40.0, stiffness=stiffness
    )
    weights, tensor, previous = system.weights, system.tensor, problem.to_lanes(before)
    update = system.bind_weight_update(
        problem.unknowns.rho,
        previous,
        problem.to_lanes(constraints.reshape(-1, *size)),
        edges,
        contrast=contrast,
        scales=scales,
    )
    sums = update()
    where = (problem.motion, problem.rho)
    expected = reference.robust_tensor(terms, *where, scales)
    close(problem.from_lanes(tensor), expected, scale=np.abs(expected).max())
    new_weights = kernel_weights(problem, problem.rho, smoothness)
    close(problem.from_lanes(weights), new_weights)
    # In the halo columns, too, the eastern ones: they are the western weights of every strip.
    eastern = len(new_weights) // 2
    close(weights[:eastern], problem.to_lanes(new_weights)[:eastern])
    assert not padding(problem, tensor).any()
    np.testing.assert_array_equal(problem.from_lanes(previous), problem.rho)
    energy = reference.robust_energy(terms, *where, scales)
    energy += 40.0 * reference.smoothness_energy(problem.rho, smoothness)
    assert sums.energy == pytest.approx(energy, rel=5e-6)
    half = reference.half_quadratic_energy(
        0.5 * problem.tensor, *where, old_weights, 40.0, smoothness
    )
    assert sums.half_quadratic == pytest.approx(half, rel=5e-6)
    assert sums.change == pytest.approx(np.linalg.norm(problem.rho - before), rel=1e-6)
    assert sums.size == pytest.approx(np.linalg.norm(problem.rho), rel=1e-6)


@pairwise(size=SIZES, lanes=LANES, count=[1, 3])
def test_weight_update_along_a_line(size, lanes, count, make_problem):
    problem = make_problem(*size, 1, lanes)
    constraints = make_problem(*size, 1, lanes, seed=1, channels=count).constraints
    split = [constraints] if count < 3 else [constraints[:1], constraints[1:]]
    scales = (3.0, 50.0)[: len(split)]
    problem.tensor_lanes[...] = 0
    system, unknowns = problem.system(np.zeros((2, *size)), alpha=40.0), problem.unknowns
    tensor = system.tensor
    sums = system.bind_weight_update(
        unknowns.rho,
        problem.grid.allocate(1),
        problem.to_lanes(constraints.reshape(-1, *size)),
        unknowns.edges,
        contrast=0.3,
        scales=scales,
        along_line=True,
    )()
    where = (problem.motion, problem.rho)
    terms = reference.tensors_of(split)
    expected = reference.robust_tensor(terms, *where, scales)
    expected[[1, 2, 4]] = 0  # left alone
    close(problem.from_lanes(tensor), expected, scale=np.abs(expected).max())
    smoothness = smoothness_of(problem, 0.3, "paper")[0]
    energy = reference.robust_energy(terms, *where, scales)
    energy += 40.0 * reference.smoothness_energy(problem.rho, smoothness)
    assert sums.energy == pytest.approx(energy, rel=5e-6)


@pairwise(size=SIZES, components=MODELS, lanes=LANES, kind=KINDS)
def test_data_precision(size, components, lanes, kind, make_problem):
    problem = make_problem(*size, components, lanes)
    smoothness, stiffness, _ = smoothness_of(problem, 1.0, kind)
    weights = reference.edge_weights(problem.rho, smoothness)
    out = problem.grid.allocate(7)
    system = problem.system(
        kernel_weights(problem, problem.rho, smoothness), alpha=40.0, stiffness=stiffness
    )
    system.precision(problem.unknowns.rho, out)
    actual = problem.from_lanes(out)
    np.testing.assert_array_equal(actual[:3], problem.tensor[:3])

    u, v = reference.flow(problem.motion, problem.rho)
    ix, iy = np.sqrt(problem.tensor[0]), np.sqrt(problem.tensor[2])
    iy *= np.sign(problem.tensor[1])
    residual = (ix * u + iy * v + np.sqrt(problem.tensor[5]) * np.sign(problem.tensor[3])) ** 2
    close(actual[3], residual, scale=1e3)

    without_data = np.zeros_like(problem.tensor)
    prior = reference.local_matrices(without_data, problem.motion, weights, 40.0)
    g = np.moveaxis(problem.motion, (0, 1), (-2, -1))
    covariance = g @ np.linalg.inv(prior) @ np.swapaxes(g, -1, -2)
    for k, (i, j) in enumerate([(0, 0), (0, 1), (1, 1)]):
        close(actual[4 + k], covariance[..., i, j], scale=covariance.max())


@each_size
@pytest.mark.parametrize("freedom", [1, 2])
def test_share_of_data(size, freedom):
    from tisfm.kernels.solve.data_precision import share_of_data

    rng = np.random.default_rng(4)
    roots = rng.normal(size=(2, *size, 2, 2))
    if freedom == 1:
        roots[1, ..., 1] = 0  # neighbours leave one direction
    j, m = roots @ np.swapaxes(roots, -1, -2)
    residual = rng.uniform(0, 2, size)
    entries = [matrix[..., i, k] for matrix in (j, m) for i, k in ((0, 0), (0, 1), (1, 1))]
    precision = np.array([*entries[:3], residual, *entries[3:]], np.float32)
    out = np.empty(size, np.float32)
    share_of_data(precision, out, half_share_residual=0.3, freedom=freedom)
    product = j @ m
    share = np.trace(product @ np.linalg.inv(np.eye(2) + product), axis1=-2, axis2=-1) / freedom
    close(out, share / (1 + residual / 0.3))


def test_share_of_data_checks_its_arguments():
    from tisfm.kernels.solve.data_precision import share_of_data

    precision, out = np.ones((7, 5, 6), np.float32), np.empty((5, 6), np.float32)
    with pytest.raises(ValueError, match=r"precision is \(7, 5, 6\): expected \(7, 6, 5\)"):
        share_of_data(precision, np.empty((6, 5), np.float32), half_share_residual=1.0, freedom=2)
    with pytest.raises(TypeError, match="out is float64: expected a NumPy array of float32"):
        share_of_data(precision, out.astype(float), half_share_residual=1.0, freedom=2)
    for values, match in (
        ({"freedom": 3}, "freedom is 3: expected 1 or 2"),
        ({"half_share_residual": 0.0}, "half_share_residual is 0.0: expected a positive value"),
    ):
        with pytest.raises(ValueError, match=match):
            share_of_data(precision, out, **{"half_share_residual": 1.0, "freedom": 2} | values)
