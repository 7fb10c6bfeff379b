"""The NumPy reference itself: stencils, model and minimisation, against independent facts."""

import numpy as np
import pytest

import tisfm
from bench import reference


def smooth_image(height, width, *, step=1.0, time=0.0, motion=(0.0, 0.0)):
    """Sample an analytic image moving at a constant velocity, and its derivatives."""
    rows, columns = np.mgrid[:height, :width] * step
    x, y = columns - motion[0] * time, rows - motion[1] * time
    value = np.sin(0.9 * x + 0.4 * y) + np.cos(0.5 * x - 0.8 * y)
    ix = 0.9 * np.cos(0.9 * x + 0.4 * y) - 0.5 * np.sin(0.5 * x - 0.8 * y)
    iy = 0.4 * np.cos(0.9 * x + 0.4 * y) + 0.8 * np.sin(0.5 * x - 0.8 * y)
    return value, ix, iy


@pytest.mark.parametrize(("scheme", "order"), [("cube", 2), ("five_tap", 4)])
def test_derivatives_have_their_order_of_convergence(scheme, order):
    errors = []
    for halving in (1, 2, 4):
        step = 0.4 / halving
        height, width = 16 * halving, 20 * halving
        still, _, _ = smooth_image(height, width, step=step)
        ix, iy, it = reference.derivatives(still, still, scheme)
        assert not it.any()
        # The cube estimates half a pixel to the south-east.
        shift = 0.5 if scheme == "cube" else 0.0
        rows, columns = (np.mgrid[:height, :width] + shift) * step
        expected_x = 0.9 * np.cos(0.9 * columns + 0.4 * rows)
        expected_x -= 0.5 * np.sin(0.5 * columns - 0.8 * rows)
        expected_y = 0.4 * np.cos(0.9 * columns + 0.4 * rows)
        expected_y += 0.8 * np.sin(0.5 * columns - 0.8 * rows)
        inner = (slice(3, -3), slice(3, -3))
        error_x = np.abs(ix / step - expected_x)[inner].max()
        error_y = np.abs(iy / step - expected_y)[inner].max()
        errors.append(max(error_x, error_y))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, order, atol=0.25)


@pytest.mark.parametrize("scheme", ["cube", "five_tap"])
def test_derivatives_of_a_ramp_by_hand(scheme):
    rows, columns = np.mgrid[:8, :9]
    frame0 = 3.0 * columns + 5.0 * rows
    ix, iy, it = reference.derivatives(frame0, frame0 + 7.0, scheme)
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(ix[inner], 3.0)
    np.testing.assert_allclose(iy[inner], 5.0)
    np.testing.assert_allclose(it, 7.0)


def test_warp_is_exact_at_pixels_and_fourth_order_between():
    image = np.random.default_rng(0).uniform(0, 255, (9, 11))
    flow = np.zeros((2, 9, 11))
    flow[0], flow[1] = 2, -1
    warped, mask = reference.warp(image, flow)
    np.testing.assert_allclose(warped[1:, :-2], image[:-1, 2:], rtol=1e-12)
    assert mask[1:, :-2].all()
    assert not mask[0].any()
    assert not mask[:, -2:].any()

    errors = []
    for halving in (1, 2, 4):
        step = 0.4 / halving
        size = 32 * halving
        value, _, _ = smooth_image(size, size, step=step)
        warped, _ = reference.warp(value, np.full((2, size, size), 0.3))
        rows, columns = (np.mgrid[:size, :size] + 0.3) * step
        expected = np.sin(0.9 * columns + 0.4 * rows) + np.cos(0.5 * columns - 0.8 * rows)
        margin = 12 * halving  # the spline is mirrored at the border, the function is not
        inner = (slice(margin, -margin),) * 2
        errors.append(np.abs(warped - expected)[inner].max())
    assert np.log2(errors[0] / errors[1]) > 3.7
    assert np.log2(errors[1] / errors[2]) > 3.7


def test_motion_matrix_is_equation_2():
    """(u, v) of eq. 2, in the paper's own units, pixel by pixel."""
    f, (cx, cy) = 50.0, (4.0, 2.5)
    t1, t2, t3, o1, o2, o3 = 0.3, -0.2, 0.5, 0.02, -0.01, 0.03
    depth = 4.0
    camera = tisfm.Camera(focal=f, center=(cx, cy))
    motion = reference.motion_matrix(camera, 6, 9, 6)
    rho = f * np.array([t1 / depth, t2 / depth, t3 / depth, o1, o2, o3])
    flow = reference.flow(motion, np.broadcast_to(rho[:, None, None], (6, 6, 9)))
    for row in range(6):
        for column in range(9):
            x, y = column - cx, row - cy
            u = (f * t1 - x * t3) / depth - x * y / f * o1 + (f * f + x * x) / f * o2 - y * o3
            v = (f * t2 - y * t3) / depth - (f * f + y * y) / f * o1 + x * y / f * o2 + x * o3
            np.testing.assert_allclose(flow[:, row, column], (u, v), rtol=1e-12)


def random_problem(components, *, seed=0, shape=(9, 12), real=False, focal=15.0):
    """Build a tensor from random gradients, or from a real-looking moving image."""
    rng = np.random.default_rng(seed)
    camera = tisfm.Camera(focal=focal)
    motion = reference.motion_matrix(camera, *shape, components)
    zero = np.zeros((2, *shape))
    if real:
        from tests.rendered import two_blocks

        pair = two_blocks(60, 80, seed=seed)
        rows, columns = (slice(20, 20 + n) for n in shape)
        frames = [f[rows, columns].astype(float) for f in (pair.frame0, pair.frame1)]
        gradients = reference.derivatives(*frames, "five_tap")
    else:
        gradients = tuple(rng.normal(scale=10, size=(3, *shape)))
    tensor = reference.brightness_tensor(gradients, zero, np.ones(shape))
    return tensor, motion, rng.normal(scale=0.3, size=(components, *shape))


@pytest.mark.parametrize("components", [6, 3, 2])
@pytest.mark.parametrize("real", [False, True], ids=["random", "image"])
@pytest.mark.parametrize("contrast", [0.02, 15.0])
@pytest.mark.parametrize("relaxation", [1.0, 1.9, 1.98])
def test_energy_never_rises(components, real, contrast, relaxation):
    tensor, motion, rho = random_problem(components, real=real)
    smoothness = reference.Smoothness(contrast=contrast)
    start = reference.energy(tensor, motion, rho, 30.0, smoothness)
    run = reference.minimise(
        [tensor],
        motion,
        rho,
        alpha=30.0,
        smoothness=smoothness,
        outer_iterations=15,
        sweeps=2,
        relaxation=relaxation,
    )
    energies = np.array([start, *run.energies])
    assert np.all(np.diff(energies) <= 1e-12 * energies[:-1])
    assert energies[-1] < 0.9 * start
    # The half-quadratic form majorises: E ≤ E* everywhere, and E* is below the E it started from.
    assert np.all(np.array(run.half_quadratic) >= energies[1:] * (1 - 1e-12))
    assert np.all(np.array(run.half_quadratic) <= energies[:-1] * (1 + 1e-12))


@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("relaxation", [1.0, 1.9])
@pytest.mark.parametrize("thorough", [False, True])
def test_energy_never_rises_with_robust_data_and_image_edges(joint, relaxation, thorough):
    tensor, motion, rho = random_problem(6, real=True)
    other, _, _ = random_problem(6, seed=1)
    rng = np.random.default_rng(2)
    smoothness = reference.Smoothness(
        contrast=0.02,
        stiffness=np.array([1, 1, 0.1, 10, 10, 0.1]),
        joint=joint,
        edges=rng.uniform(0.1, 2, size=(2, *rho.shape[1:])),
    )
    terms, scales = [tensor, other], [4.0, np.inf]
    start = reference.robust_energy(terms, motion, rho, scales)
    start += 30.0 * reference.smoothness_energy(rho, smoothness)
    run = reference.minimise(
        terms,
        motion,
        rho,
        alpha=30.0,
        smoothness=smoothness,
        scales=scales,
        outer_iterations=15,
        sweeps=2,
        relaxation=relaxation,
        thorough=thorough,
    )
    energies, half = np.array([start, *run.energies]), np.array(run.half_quadratic)
    assert np.all(np.diff(energies) <= 1e-12 * energies[:-1])
    assert energies[-1] < 0.9 * start
    assert np.all(half >= energies[1:] * (1 - 1e-12))
    assert np.all(half <= energies[:-1] * (1 + 1e-12))


def test_normalised_constraints_are_distances_in_pixels():
    """Of an image that moves by (1.5, 0), whatever its contrast."""
    _, columns = np.mgrid[:20, :24].astype(float)
    one, zero = np.ones((20, 24)), np.zeros((2, 20, 24))
    for steepness in (1.0, 5.0):
        frame0, frame1 = (steepness * (x + 0.1 * x**2) for x in (columns, columns - 1.5))
        terms = reference.constancy_tensors(
            reference.derivatives(frame0, frame1, "five_tap", halo=2),
            zero,
            one,
            brightness=1.0,
            gradient=1.0,
            normalization=0.0,
        )
        inner = np.s_[5:-5, 5:-5]  # beyond it, the images repeat
        for term in terms:
            np.testing.assert_allclose(term[5][inner], 1.5**2, rtol=1e-6)
            np.testing.assert_allclose(term[3][inner], -1.5, rtol=1e-6)


def test_gradient_constancy_does_not_see_a_change_of_brightness():
    rng = np.random.default_rng(0)
    frame = rng.uniform(0, 200, size=(15, 17))
    constraints = {"brightness": 0.5, "gradient": 2.0, "normalization": None}
    zero, one = np.zeros((2, 15, 17)), np.ones((15, 17))
    still, brighter = (
        reference.constancy_tensors(
            reference.derivatives(frame, frame + shift, "five_tap", halo=2),
            zero,
            one,
            **constraints,
        )
        for shift in (0.0, 20.0)
    )
    np.testing.assert_allclose(brighter[1], still[1], atol=1e-9)
    assert np.abs(brighter[0] - still[0]).max() > 10
    assert np.all(brighter[0][5] == pytest.approx(0.5 * 20.0**2))


def test_image_edges_keep_the_mean_and_open_at_edges():
    frame = np.zeros((9, 12))
    frame[:, 6:] = 100.0
    edges = reference.image_edges(frame, 2.0)
    inside = np.concatenate([edges[0, :, :-1].ravel(), edges[1, :-1].ravel()])
    assert inside.mean() == pytest.approx(1.0)
    assert edges[0, 0, 5] < 0.2 * edges[0, 0, 4]
    assert not edges[0, :, -1].any() and not edges[1, -1].any()
    np.testing.assert_allclose(reference.image_edges(3 * frame, 2.0), edges)  # relative contrast


def test_energy_with_the_wrong_weight_of_the_regularisation_rises():
    """With λ̂ in place of α in the energy the iteration is no descent: the check can fail."""
    tensor, motion, rho = random_problem(6)
    alpha, beta = 30.0, 0.25
    smoothness = reference.Smoothness(contrast=0.02)
    options = {"smoothness": smoothness, "sweeps": 20, "relaxation": 1.5}
    reference.minimise([tensor], motion, rho, alpha=alpha / beta, outer_iterations=30, **options)
    before = reference.energy(tensor, motion, rho, alpha / beta, smoothness)
    reference.minimise([tensor], motion, rho, alpha=alpha, outer_iterations=1, **options)
    assert reference.energy(tensor, motion, rho, alpha / beta, smoothness) > 1.01 * before


@pytest.mark.parametrize("components", [6, 3, 2])
@pytest.mark.parametrize("sweep", [reference.sweep_lexicographic, reference.sweep_red_black])
def test_sweeps_reach_the_solution_of_the_whole_system(components, sweep):
    """Against one dense solve of all pixels at once."""
    # A wide view: over a narrow one translation and rotation are all but the same motion.
    tensor, motion, rho = random_problem(components, shape=(5, 6), focal=1.5)
    smoothness = reference.Smoothness(contrast=0.5)
    weights = reference.edge_weights(rho, smoothness)
    matrix = reference.local_matrices(tensor, motion, weights, 30.0)

    def residual(field):
        right = reference.local_right_sides(tensor, motion, weights, field, 30.0)
        return (right - np.einsum("yxkl,lyx->yxk", matrix, field)).ravel()

    constant = residual(np.zeros_like(rho))
    basis = np.eye(rho.size).reshape(-1, *rho.shape)
    system = np.stack([constant - residual(unit) for unit in basis], axis=1)
    exact = np.linalg.solve(system, constant).reshape(rho.shape)

    def energy(field):
        return reference.half_quadratic_energy(tensor, motion, field, weights, 30.0, smoothness)

    first_gap = energy(rho) - energy(exact)
    for _ in range(400):
        sweep(tensor, motion, weights, rho, alpha=30.0, relaxation=1.9)
    assert abs(energy(rho) - energy(exact)) < 1e-6 * first_gap


def test_a_lexicographic_sweep_uses_new_values_at_once():
    """By hand: one row, translation model, no data but at the first pixel."""
    tensor = np.zeros((6, 1, 3))
    tensor[[0, 2], 0, 0] = 1.0
    tensor[3, 0, 0] = -1.0  # pulls u of the first pixel to 1
    motion = reference.motion_matrix(tisfm.Camera(focal=1e9), 1, 3, 2)
    weights = np.zeros((4, 1, 3))
    weights[:2, 0, :2] = 1.0
    rho = np.zeros((2, 1, 3))
    reference.sweep_lexicographic(tensor, motion, weights, rho, alpha=1.0)
    np.testing.assert_allclose(rho[0, 0], [1 / 2, 1 / 4, 1 / 4])


def test_prolong_keeps_linear_fields():
    rows, columns = np.mgrid[:8, :10].astype(float)
    fine_rows, fine_columns = np.mgrid[:16, :20].astype(float)
    coarse = np.stack([columns, rows])
    fine = reference.prolong(coarse, (16, 20), 0.5)
    expected = np.stack([(fine_columns + 0.5) * 0.5 - 0.5, (fine_rows + 0.5) * 0.5 - 0.5]) / 0.5
    np.testing.assert_allclose(fine[:, 1:-1, 1:-1], expected[:, 1:-1, 1:-1])
