"""Warps, derivatives, constraints, image edges and forward splatting, against the reference."""

import numpy as np
import pytest

from bench import reference
from tests.kernels.compared import SIZES, close, each_lanes, each_size, padding
from tests.lanes import LANES
from tests.pairwise import pairwise


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
    inner = grid.image_mask()[0, 1:-1, 1:-1] > 0
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
    from tisfm.kernels.data.warp import WARP_BAND, warp
    from tisfm.kernels.layout.images import image_to_lanes
    from tisfm.kernels.layout.lanes import MAX_SERIAL_PIXELS
    from tisfm.solver.sampling import spline_taps

    size = (6 * WARP_BAND + 5, 131)
    assert size[0] * size[1] > MAX_SERIAL_PIXELS
    problem = make_problem(*size, 2, lanes)
    grid, rng = problem.grid, np.random.default_rng(3)
    image = rng.uniform(0, 255, size=size).astype(np.float32)
    flow = rng.normal(scale=3, size=(2, *size)).astype(np.float32)
    flow[:, 40:50, 30:90] = 0
    in_lanes, mask = grid.allocate(1, halo=halo), grid.allocate(1)
    warp(grid, image, spline_taps(image), problem.to_lanes(flow), in_lanes, mask)
    inner = (
        slice(halo - 1, in_lanes.shape[1] - halo + 1),
        slice(halo - 1, grid.strip_width + halo + 1),
    )
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


def test_warp_refuses_bad_arrays(make_problem):
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


@each_size
@each_lanes
@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_image_edges(size, lanes, strength, make_problem):
    from tisfm.solver.smoothness import image_driven_factor

    problem = make_problem(*size, 2, lanes)
    grid = problem.grid
    frame = np.random.default_rng(9).uniform(0, 255, size=size).astype(np.float32)
    edges = image_driven_factor(grid, frame, strength)
    close(problem.from_lanes(edges), reference.image_edges(frame, strength))
    np.testing.assert_array_equal(edges > 0, grid.edge_mask() > 0)  # in the padding as well
    uniform = image_driven_factor(grid, np.full(size, 7, np.float32), strength)
    np.testing.assert_array_equal(uniform, grid.edge_mask())


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


@each_size
@pytest.mark.parametrize("any_order", [False, True])
def test_splatting_and_who_loses_them(size, any_order):
    from tisfm.kernels.data.forward_splatting import hidden_pixels, splat
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
    hidden_pixels(flow, residual, sums, out, density=1.2, flow_difference=0.1)
    expected = reference.hidden_pixels(flow, residual, density=1.2, flow_difference=0.1)
    np.testing.assert_array_equal(out, expected)
    if min(size) > 4:
        assert 0 < expected.mean() < 0.5


def test_splatting_check_their_arrays():
    from tisfm.kernels.data.forward_splatting import hidden_pixels, splat
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
        lambda: hidden_pixels(flow, residual, offset, out, density=1.2, flow_difference=0.1),
    ):
        with pytest.raises(ValueError, match="sums must be aligned to 64 bytes"):
            call()
    with pytest.raises(TypeError, match="out is bool: expected a NumPy array of int32"):
        hidden_pixels(flow, residual, sums, out > 0, density=1.2, flow_difference=0.1)


@each_size
@each_lanes
@pytest.mark.parametrize("count", [1, 2, 3])
def test_constraints_of_both_neighbours(size, lanes, count, make_problem):
    from tisfm.kernels.data.three_frames import backward_flow, join_constraints

    problem = make_problem(*size, 6, lanes)
    grid, rng = problem.grid, np.random.default_rng(4)
    after, before = rng.normal(size=(2, 3 * count, *size)).astype(np.float32)
    flow, bend = rng.normal(scale=3, size=(2, 2, *size)).astype(np.float32)
    trust = rng.uniform(size=(2, *size)).astype(np.float32)
    masks = rng.integers(0, 2, size=(2, *size)).astype(np.float32)
    scales = (0.02, 0.05)[: 2 if count == 3 else 1]
    back = grid.allocate(2)
    backward_flow(grid, problem.to_lanes(flow), problem.to_lanes(bend), back)
    close(problem.from_lanes(back), bend.astype(np.float64) - flow, scale=10)

    out, tensor = problem.to_lanes(after), grid.allocate(6)
    in_lanes = [problem.to_lanes(a) for a in (before, trust, *masks[:, None], flow)]
    join_constraints(grid, *in_lanes, scales, out, tensor)
    a, b = trust.astype(np.float64) * masks
    joint = (a * after + b * before) / np.maximum(1, a + b)
    close(problem.from_lanes(out), joint, scale=5)

    lines = joint.reshape(count, 3, *size)
    terms = [lines] if count < 3 else [lines[:1], lines[1:]]
    expected = np.zeros((6, *size))
    for term, scale in zip(terms, scales, strict=True):
        p, q, c = np.moveaxis(term, 1, 0)
        squared = ((p * flow[0] + q * flow[1] + c) ** 2).sum(axis=0)
        root = np.sqrt(1 + squared / scale)
        products = np.array([p * p, p * q, q * q, p * c, q * c, c * c]).sum(axis=1) / root
        products[5] += scale * (1 / root + root - 2)
        expected += products
    close(problem.from_lanes(tensor), expected, scale=100)
    inner = grid.image_mask()[0, 1:-1, 1:-1] > 0
    assert not tensor[:, 1:-1, 1:-1][:, ~inner].any()


def test_constraints_of_both_neighbours_are_refused(make_problem):
    from tisfm.kernels.data.three_frames import backward_flow, join_constraints

    grid = make_problem(6, 9, 6, 8).grid
    one, two, three, six = (grid.allocate(n) for n in (1, 2, 3, 6))
    with pytest.raises(ValueError, match="flow_sum"):
        backward_flow(grid, two, one, two)
    with pytest.raises(ValueError, match="previous"):
        join_constraints(grid, two, two, one, one, two, (1.0,), three, six)
    with pytest.raises(ValueError, match="trust"):
        join_constraints(grid, three, one, one, one, two, (1.0,), three, six)
