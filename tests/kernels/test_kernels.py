"""Every kernel against the NumPy reference: odd sizes, padding, lanes 1 and 8, all models."""

import numpy as np
import pytest

from tests.lanes import LANES
from tests.pairwise import pairwise
from tisfm import reference

# One pixel per lane, one lane wide, odd, non-square, exactly full strips, wider than high.
SIZES = [(5, 1), (4, 8), (7, 9), (13, 37), (6, 64), (21, 5)]
MODELS = [6, 3, 2, 1]

each_size = pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
each_model = pytest.mark.parametrize("components", MODELS)
each_lanes = pytest.mark.parametrize("lanes", LANES)
of_each = pairwise(size=SIZES, components=MODELS, lanes=LANES)
KINDS = ["paper", "separate", "joint"]  # of weights: without g and s_k, of each component, one


def close(actual, expected, scale=1.0):
    """Equal up to a few dozen float32 roundings of the values' own magnitude."""
    magnitude = max(float(np.abs(expected).max(initial=0.0)), scale)
    np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=4e-6 * magnitude)


def padding(problem, array):
    """Return everything of a lane array that is not a pixel or a copy of one."""
    kept = problem.to_lanes(np.ones((1, problem.grid.height, problem.grid.width)))[0] == 0
    return array[:, kept]


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
            lane * grid.strip + np.arange(-IMAGE_HALO, grid.strip + IMAGE_HALO), 0, size[1] - 1
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


@each_size
@each_lanes
@pytest.mark.parametrize("scheme", ["cube", "five_tap"])
def test_derivatives(size, lanes, scheme, make_problem):
    from tisfm.kernels.data.derivatives import DERIVATIVE_HALO, derivatives
    from tisfm.kernels.layout.images import IMAGE_HALO, image_to_lanes

    problem = make_problem(*size, 6, lanes)
    grid = problem.grid
    frames = np.random.default_rng(2).uniform(0, 255, size=(2, *size)).astype(np.float32)
    in_lanes = [grid.allocate(1, halo=IMAGE_HALO) for _ in frames]
    for frame, array in zip(frames, in_lanes, strict=True):
        image_to_lanes(grid, frame, array)
    out = grid.allocate(3, halo=DERIVATIVE_HALO)
    derivatives(grid, *in_lanes, out, scheme=scheme)
    inner = problem.from_lanes(out[:, 1:-1, 1:-1])
    close(inner, np.array(reference.derivatives(*frames, scheme)), scale=255)


@of_each
def test_flow(size, components, lanes, make_problem):
    problem = make_problem(*size, components, lanes)
    out = problem.grid.allocate(2)
    problem.unknowns.bind_flow(out)()
    close(problem.from_lanes(out), reference.flow(problem.motion, problem.rho))


@each_size
@each_lanes
def test_warp(size, lanes, make_problem):
    from tisfm.kernels.data.warp import warp
    from tisfm.kernels.layout.images import IMAGE_HALO, image_to_lanes
    from tisfm.solver.sampling import spline_taps

    problem = make_problem(*size, 6, lanes)
    grid, rng = problem.grid, np.random.default_rng(3)
    image = rng.uniform(0, 255, size=size).astype(np.float32)
    flow = rng.normal(scale=3, size=(2, *size)).astype(np.float32)
    flow.reshape(2, -1)[:, 0] = 1e9, -1e9  # far outside
    flow.reshape(2, -1)[:, -1] = 0
    in_lanes, mask = grid.allocate(1, halo=IMAGE_HALO), grid.allocate(1)
    mask[...] = 7
    warp(grid, image, spline_taps(image), problem.to_lanes(flow), in_lanes, mask)
    out = problem.from_lanes(in_lanes[:, 3:-3, 3:-3])[0]
    expected, expected_mask = reference.warp(image, flow.astype(np.float64))
    np.testing.assert_array_equal(problem.from_lanes(mask)[0], expected_mask)
    inner = grid.inside()[0, 1:-1, 1:-1] > 0
    assert not mask[0, 1:-1, 1:-1][~inner].any()
    # A float32 position is off by up to 2⁻²³ of the width, times the steepest slope of a spline
    # through noise, 3 · 255 a pixel.
    np.testing.assert_allclose(out, expected, atol=3 * 255 * 64 * 2.0**-23)
    assert out.flat[-1] == image.flat[-1]  # no motion, to the last bit
    # Halo and padding, which the derivatives look at, repeat the border.
    laid = grid.allocate(1, halo=IMAGE_HALO)
    image_to_lanes(grid, np.ascontiguousarray(out), laid)
    np.testing.assert_array_equal(in_lanes, laid)


@each_lanes
@pytest.mark.parametrize("halo", [1, 2])
def test_warp_in_parallel_and_to_any_halo(lanes, halo, make_problem):
    from tisfm.kernels.data.warp import BAND, warp
    from tisfm.kernels.layout.images import image_to_lanes
    from tisfm.kernels.layout.lanes import SERIAL
    from tisfm.solver.sampling import spline_taps

    size = (6 * BAND + 5, 131)
    assert size[0] * size[1] > SERIAL
    problem = make_problem(*size, 2, lanes)
    grid, rng = problem.grid, np.random.default_rng(3)
    image = rng.uniform(0, 255, size=size).astype(np.float32)
    flow = rng.normal(scale=3, size=(2, *size)).astype(np.float32)
    flow[:, 40:50, 30:90] = 0
    in_lanes, mask = grid.allocate(1, halo=halo), grid.allocate(1)
    warp(grid, image, spline_taps(image), problem.to_lanes(flow), in_lanes, mask)
    inner = slice(halo - 1, in_lanes.shape[1] - halo + 1), slice(halo - 1, grid.strip + halo + 1)
    out = problem.from_lanes(in_lanes[:, inner[0], inner[1]])[0]
    expected, expected_mask = reference.warp(image, flow.astype(np.float64))
    np.testing.assert_allclose(out, expected, atol=3 * 255 * 256 * 2.0**-23)
    np.testing.assert_array_equal(out[40:50, 30:90], image[40:50, 30:90])
    np.testing.assert_array_equal(problem.from_lanes(mask)[0], expected_mask)
    laid = grid.allocate(1, halo=halo)
    image_to_lanes(grid, np.ascontiguousarray(out), laid)
    np.testing.assert_array_equal(in_lanes, laid)


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (3, 5), (2, 3), (9, 4)])
def test_spline_taps(size):
    from tisfm.solver.sampling import spline_coefficients, spline_taps

    image = np.random.default_rng(5).uniform(0, 255, size=size).astype(np.float32)
    coefficients = spline_coefficients(image)
    height, width = size

    def mirrored(index, size):
        period = max(2 * (size - 1), 1)
        return min(index % period, -index % period)

    taps = spline_taps(image)
    assert taps.dtype == np.float32 and taps.shape == ((height + 3) * width, 4)
    for r, x, k in np.ndindex(height + 3, width, 4):
        expected = coefficients[mirrored(r - 1, height), mirrored(x + k - 1, width)]
        assert taps[r * width + x, k] == expected


def test_warp_refuses_what_it_cannot_read(make_problem):
    from tisfm.kernels.data.warp import warp
    from tisfm.solver.sampling import spline_coefficients, spline_taps

    grid = make_problem(5, 7, 2, 1).grid
    image, flow = np.ones((5, 7), np.float32), grid.allocate(2)
    out, mask = grid.allocate(1, halo=4), grid.allocate(1)
    with pytest.raises(ValueError, match=r"taps is \(5, 7\): expected \(56, 4\)"):
        warp(grid, image, spline_coefficients(image), flow, out, mask)
    with pytest.raises(ValueError, match=r"out is \(1, 13, 15\): expected \(1, 13, 16\)"):
        warp(grid, image, spline_taps(image), flow, np.zeros((1, 13, 15), np.float32), mask)
    taps = spline_taps(np.ones((6, 7), np.float32))[1:57].ravel()
    with pytest.raises(ValueError, match="taps must be aligned"):
        warp(grid, image, taps.reshape(56, 4), flow, out, mask)


CONSTRAINTS = [
    {"brightness": 1.0, "gradient": 0.0, "normalization": None},  # the paper's
    {"brightness": 0.0, "gradient": 2.0, "normalization": None},
    {"brightness": 0.3, "gradient": 1.0, "normalization": 0.1},
]


@pairwise(ways=3, size=SIZES, lanes=LANES, constraints=CONSTRAINTS, contrast=[0.1, np.inf])
def test_constancy_constraints(size, lanes, constraints, contrast, make_problem):
    from tisfm.kernels.data.constraints import constancy_constraints
    from tisfm.kernels.data.derivatives import DERIVATIVE_HALO, derivatives
    from tisfm.kernels.layout.images import IMAGE_HALO, image_to_lanes

    problem = make_problem(*size, 6, lanes)
    grid, rng = problem.grid, np.random.default_rng(4)
    frames = rng.uniform(0, 255, size=(2, *size)).astype(np.float32)
    flow = rng.normal(scale=2, size=(2, *size)).astype(np.float32)
    mask = rng.integers(0, 2, size=(1, *size)).astype(np.float32)
    in_lanes = [grid.allocate(1, halo=IMAGE_HALO) for _ in frames]
    for frame, array in zip(frames, in_lanes, strict=True):
        image_to_lanes(grid, frame, array)
    gradients = grid.allocate(3, halo=DERIVATIVE_HALO)
    derivatives(grid, *in_lanes, gradients, scheme="five_tap")
    weights = [constraints[name] for name in ("brightness", "gradient")]
    scales = [weight * contrast**2 for weight in weights if weight > 0]
    count = (weights[0] > 0) + 2 * (weights[1] > 0)
    out, tensor = grid.allocate(3 * count), grid.allocate(6)
    arguments = [problem.to_lanes(a) for a in (flow, mask)]
    constancy_constraints(grid, gradients, *arguments, out, tensor, scales=scales, **constraints)
    terms = reference.constancy_constraints(
        reference.derivatives(*frames, "five_tap", halo=2), flow, mask[0], **constraints
    )
    expected = np.concatenate(terms).reshape(3 * count, *size)
    # Each constraint carries roundings of 255 grey levels: relative to the largest of them.
    scale = max(np.abs(expected).max(), 1e-6)
    np.testing.assert_allclose(problem.from_lanes(out), expected, rtol=2e-4, atol=2e-6 * scale)
    identity = reference.motion_matrix(problem.camera, *size, 2)
    tensors = reference.tensors_of(terms)
    expected = reference.robust_tensor(tensors, identity, flow.astype(float), scales)
    for found, wanted in zip(problem.from_lanes(tensor), expected, strict=True):
        scale = max(np.abs(wanted).max(), 1e-6)
        np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=1e-5 * scale)
    assert not padding(problem, out).any() and not padding(problem, tensor).any()
    alone = grid.allocate(3 * count)
    constancy_constraints(grid, gradients, *arguments, alone, scales=scales, **constraints)
    np.testing.assert_array_equal(alone, out)


def test_constancy_constraints_refuse_bad_weights(make_problem):
    from tisfm.kernels.data.constraints import constancy_constraints

    nothing = (None,) * 5
    for weights in ({"brightness": 0.0, "gradient": 0.0}, {"brightness": -1.0, "gradient": 2.0}):
        with pytest.raises(ValueError, match="expected weights of at least 0"):
            constancy_constraints(*nothing, **weights, normalization=None, scales=(1.0,))


def smoothness_of(problem, contrast, kind):
    """Return the reference's smoothness, s_k, and g in lanes."""
    if kind == "paper":
        return reference.Smoothness(contrast=contrast), 1.0, problem.unknowns.edges
    n, height, width = problem.rho.shape
    g = np.random.default_rng(8).uniform(0.1, 2, size=(2, height, width))
    g[0, :, -1] = g[1, -1] = 0
    g = g.astype(np.float32)
    stiffness = (1.0, 0.5, 0.1, 10.0, 3.0, 0.2)[:n]
    smoothness = reference.Smoothness(
        contrast=contrast,
        edges=g.astype(float),
        stiffness=np.array(stiffness),
        joint=kind == "joint",
    )
    return smoothness, stiffness, problem.to_lanes(g)


def kernel_weights(problem, rho, smoothness):
    """Return g·b as kernels take it: without s_k, and once where it is joint."""
    n = len(rho)
    weights = reference.edge_weights(rho, smoothness).reshape(2, n, *rho.shape[1:])
    weights = weights / smoothness.stiffnesses(n)
    return weights[:, : 1 if smoothness.joint else n].reshape(-1, *rho.shape[1:])


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
def test_a_linear_system_is_checked_once_when_it_is_made(change, match, make_problem):
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


@each_size
@each_lanes
@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_image_edges(size, lanes, strength, make_problem):
    from tisfm.solver.smoothness import image_edges_in_lanes

    problem = make_problem(*size, 2, lanes)
    grid = problem.grid
    frame = np.random.default_rng(9).uniform(0, 255, size=size).astype(np.float32)
    edges = image_edges_in_lanes(grid, frame, strength)
    close(problem.from_lanes(edges), reference.image_edges(frame, strength))
    np.testing.assert_array_equal(edges > 0, grid.open_edges() > 0)  # in the padding as well
    uniform = image_edges_in_lanes(grid, np.full(size, 7, np.float32), strength)
    np.testing.assert_array_equal(uniform, grid.open_edges())


def test_image_edges_check_their_arguments():
    from tisfm.kernels.data.image_edges import image_edges
    from tisfm.kernels.layout.lanes import LaneGrid

    grid = LaneGrid(5, 6)
    frame, out = np.zeros((5, 6), np.float32), grid.allocate(2)
    with pytest.raises(ValueError, match=r"image is \(6, 5\): expected \(5, 6\)"):
        image_edges(grid, frame.reshape(6, 5), out, rate=1.0)
    with pytest.raises(ValueError, match=r"out is \(1, .*: expected \(2, "):
        image_edges(grid, frame, grid.allocate(1), rate=1.0)
    for rate in (-1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match=f"rate is {rate}: expected a number of at least 0"):
            image_edges(grid, frame, out, rate=rate)


@pairwise(
    ways=3,
    size=[*SIZES, (64, 9), (131, 20)],
    components=MODELS,
    lanes=LANES,
    kind=KINDS,
    solver=["cholesky", "closed_form"],
    relaxation=[1.0, 1.9],
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
    assert sums.moved == pytest.approx(np.linalg.norm(problem.rho - before), rel=1e-6)
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
    from tisfm.solver.sampling import enlarged, reduced

    for up in (0, 1):  # sizes of levels are rounded, either way
        shape = tuple(max(1, side // factor + up) for side in size)
        coarse = np.random.default_rng(6).normal(size=(3, *shape)).astype(np.float32)
        expected = reference.prolong(coarse.astype(np.float64), size, 1 / factor)
        close(enlarged(factor * coarse, factor, *size), expected, scale=10)
        # A ramp is where it was.
        ramp = np.arange(size[1], dtype=np.float32)[None].repeat(size[0], axis=0)
        within = np.arange(min(shape[1], size[1] // factor))
        means = reduced(ramp[None], factor, *shape)[0, 0, : len(within)]
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
    share_of_data(precision, out, tolerated=0.3, freedom=freedom)
    product = j @ m
    share = np.trace(product @ np.linalg.inv(np.eye(2) + product), axis1=-2, axis2=-1) / freedom
    close(out, share / (1 + residual / 0.3))


def test_share_of_data_checks_its_arguments():
    from tisfm.kernels.solve.data_precision import share_of_data

    precision, out = np.ones((7, 5, 6), np.float32), np.empty((5, 6), np.float32)
    with pytest.raises(ValueError, match=r"precision is \(7, 5, 6\): expected \(7, 6, 5\)"):
        share_of_data(precision, np.empty((6, 5), np.float32), tolerated=1.0, freedom=2)
    with pytest.raises(TypeError, match="out is float64: expected a NumPy array of float32"):
        share_of_data(precision, out.astype(float), tolerated=1.0, freedom=2)
    for values, match in (
        ({"freedom": 3}, "freedom is 3: expected 1 or 2"),
        ({"tolerated": 0.0}, "tolerated is 0.0: expected a positive value"),
    ):
        with pytest.raises(ValueError, match=match):
            share_of_data(precision, out, **{"tolerated": 1.0, "freedom": 2} | values)


@each_size
@pytest.mark.parametrize("any_order", [False, True])
def test_splatting_and_who_loses_them(size, any_order):
    from tisfm.kernels.data.forward_splatting import defeated, splat
    from tisfm.kernels.layout.lanes import aligned_zeros

    rng = np.random.default_rng(3)
    # Two surfaces that cross, and pixels that leave the image, also by far.
    flow = rng.normal(0, 0.2, (2, *size)).astype(np.float32)
    flow[0] += np.where(rng.uniform(size=size) < 0.5, 1.5, -1.5)
    flow[1, 0, 0] = 1e8
    flow[0, -1, -1] = 0.0
    flow[1, -1, -1] = 0.0  # to the last corner itself
    residual = rng.uniform(0, 5, size).astype(np.float32)
    sums = aligned_zeros((*size, 4))
    sums[...] = 7
    splat(flow, residual, sums, any_order=any_order)
    close(np.moveaxis(sums, -1, 0), reference.splat(flow, residual))

    out = np.full(size, 9, np.int32)
    defeated(flow, residual, sums, out, density=1.2, apart=0.1)
    expected = reference.defeated(flow, residual, density=1.2, apart=0.1)
    np.testing.assert_array_equal(out, expected)
    if min(size) > 4:
        assert 0 < expected.mean() < 0.5


def test_splatting_check_their_arrays():
    from tisfm.kernels.data.forward_splatting import defeated, splat
    from tisfm.kernels.layout.lanes import aligned_zeros

    flow, residual = np.zeros((2, 5, 6), np.float32), np.zeros((5, 6), np.float32)
    sums, out = aligned_zeros((5, 6, 4)), np.zeros((5, 6), np.int32)
    with pytest.raises(ValueError, match=r"flow is \(2, 6, 5\): expected \(2, 5, 6\)"):
        splat(np.zeros((2, 6, 5), np.float32), residual, sums)
    with pytest.raises(TypeError, match="residual is float64: expected a NumPy array of float32"):
        splat(flow, residual.astype(np.float64), sums)
    with pytest.raises(ValueError, match="sums must be C-contiguous"):
        splat(flow, residual, np.zeros((5, 4, 6), np.float32).transpose(0, 2, 1))
    offset = aligned_zeros((5 * 6 * 4 + 1,))[1:].reshape(5, 6, 4)
    for call in (
        lambda: splat(flow, residual, offset),
        lambda: defeated(flow, residual, offset, out, density=1.2, apart=0.1),
    ):
        with pytest.raises(ValueError, match="sums must be aligned to 64 bytes"):
            call()
    with pytest.raises(TypeError, match="out is bool: expected a NumPy array of int32"):
        defeated(flow, residual, sums, out > 0, density=1.2, apart=0.1)
