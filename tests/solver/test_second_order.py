"""Second-order smoothness: minima, cycles, and inverse depth carried over bare regions."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from bench import reference
from tests.draws import nightly_except
from tests.lanes import LANES
from tests.pairwise import pairwise


@pytest.fixture
def solver():
    """Import the solver once Taichi runs, as `tisfm.runtime.lane_grid` has it."""
    from tisfm import runtime

    runtime.start()
    from tisfm.solver import second_order

    return second_order


def problem(height, width, *, seed=0, image=True):
    """Return anchors on a third of the pixels of two planes, noisy, and a frame with an edge."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:height, :width]
    depth = 10 + 0.1 * column - 0.05 * row + 3.0 * (column > width // 2)
    weight = rng.uniform(0.2, 1, depth.shape) * (rng.uniform(size=depth.shape) < 0.3)
    target = depth + 0.3 * rng.normal(size=depth.shape)
    target[rng.uniform(size=depth.shape) < 0.1] += 8
    frame = rng.uniform(0, 4, depth.shape) + 40 * (column > width // 2) * image
    return np.stack([weight, target]).astype(np.float32), frame.astype(np.float32)


def minimiser_of(solver, anchors, frame, lanes, settings, *, lines=None, **options):
    """Return a minimiser, and its smoothness as the reference has it."""
    from tests.conftest import Problem
    from tisfm.kernels.layout.lanes import LaneGrid
    from tisfm.solver.smoothness import image_driven_factor

    height, width = frame.shape
    grid = LaneGrid(height, width, lanes)
    edges = image_driven_factor(grid, frame, settings.image_edges)
    layout = Problem(grid, *[None] * 7)
    if lines is not None:
        entries = np.zeros((len(lines), 3, height, width), np.float32)
        entries[:, 0], entries[:, 2] = lines[:, 0], lines[:, 1]
        options["constraints"] = layout.to_lanes(entries.reshape(-1, height, width))
    places = solver.anchors_in_lanes(grid, anchors)
    minimiser = solver.SecondOrderMinimiser(grid, places, edges, settings, **options)
    spacing = options.get("spacing", 1.0)
    contrasts = (settings.slope_contrast, settings.crease_contrast, settings.jump_contrast)
    smoothness = reference.SecondOrder(
        alpha=settings.alpha,
        beta=settings.beta,
        gamma=settings.gamma,
        contrasts=tuple(spacing * contrast for contrast in contrasts),
        spacing=spacing,
        edges=reference.image_edges(frame, settings.image_edges),
    )
    return minimiser, smoothness


@pairwise(size=[(7, 9), (8, 6), (1, 11), (10, 1)], lanes=LANES, spacing=[1.0, 2.0], short=True)
def test_the_minimum_is_that_of_exact_solutions(size, lanes, spacing, solver):
    settings = solver.SecondOrderSettings(
        alpha=3.0, beta=100.0, crease_contrast=0.05, slope_contrast=0.3
    )
    anchors, frame = problem(*size)
    minimiser, smoothness = minimiser_of(
        solver, anchors, frame, lanes, settings, spacing=spacing, cycles=5
    )
    energy = minimiser.update().energy
    iterations, _ = minimiser.minimise(40)
    rho = np.zeros((3, *size))
    exact = reference.minimise_second_order(
        anchors.astype(float), rho, smoothness, anchor_scale=settings.anchor_scale, iterations=40
    )
    assert energy == pytest.approx(exact[0], rel=1e-5)
    assert iterations[-1].energy == pytest.approx(exact[-1], rel=1e-4)
    assert exact[-1] < 0.5 * exact[0]
    assert np.abs(minimiser.images()[0] - rho[0]).max() < 0.02


@pairwise(
    lanes=LANES,
    lines=[0, 1, 3],
    image=[False, True],
    anchored=[False, True],
    settings=[
        {},
        {"gamma": 0.0},
        {"slope_contrast": 1e-3, "crease_contrast": 1e-5, "anchor_scale": 0.01},
    ],
    spacing=[1.0, 4.0],
    short=True,
)
def test_energy_never_rises(lanes, lines, image, anchored, settings, spacing, solver):
    """But by rounding, as in `tests/solver/test_energy.py`."""
    anchors, frame = problem(37, 45, image=image)
    anchors[0] *= anchored
    rng = np.random.default_rng(2)
    constraints = rng.normal(size=(lines, 2, 37, 45)).astype(np.float32)
    constraints[:, 1] -= constraints[:, 0] * anchors[1]  # met by D* but for noise
    minimiser, _ = minimiser_of(
        solver,
        anchors,
        frame,
        lanes,
        solver.SecondOrderSettings(**settings),
        spacing=spacing,
        lines=constraints if lines else None,
        scales=((), (0.5,), None, (0.5, 0.1))[lines],
    )
    before = minimiser.update().energy
    iterations, _ = minimiser.minimise(15)
    energies = np.array([before, *(iteration.energy for iteration in iterations)])
    majorants = np.array([iteration.half_quadratic for iteration in iterations])
    assert np.all(np.diff(energies) <= 3e-6 * energies[:-1])
    assert np.all(energies[1:] <= majorants * (1 + 3e-6))
    if anchored or lines:
        assert energies[-1] < 0.9 * energies[0]
    else:
        assert not energies.any()


def test_every_setting_counts(solver):
    anchors, frame = problem(33, 45)
    weight, target = anchors

    def depth(settings):
        return solver.extend_depth(target, weight, frame, settings)[0]

    default = solver.SecondOrderSettings()
    expected = depth(default)
    for name, value in (
        ("alpha", 60.0),
        ("beta", 300.0),
        ("gamma", 1.0),
        ("slope_contrast", 0.01),
        ("crease_contrast", 0.1),
        ("jump_contrast", 0.001),
        ("anchor_scale", 5.0),
        ("image_edges", 0.0),
    ):
        assert np.abs(depth(replace(default, **{name: value})) - expected).max() > 1e-3, name
    assert (
        np.abs(solver.extend_depth(target, weight, frame, iterations=30)[0] - expected).max() > 1e-3
    )


def test_bad_settings_and_arrays_are_refused(solver):
    for name, value in (
        ("alpha", 0.0),
        ("beta", np.inf),
        ("gamma", -1.0),
        ("slope_contrast", 0.0),
        ("crease_contrast", -1.0),
        ("jump_contrast", np.nan),
        ("anchor_scale", 0.0),
        ("image_edges", np.inf),
    ):
        with pytest.raises(ValueError, match=f"{name} is"):
            solver.SecondOrderSettings(**{name: value})
    good = [np.ones((5, 7), np.float32) for _ in range(3)]
    for index, name in enumerate(("target", "weight", "frame")):
        wrong = list(good)
        wrong[index] = wrong[index].astype(np.float64)
        with pytest.raises(TypeError, match=f"{name} is float64: expected .* float32"):
            solver.extend_depth(*wrong)
    with pytest.raises(ValueError, match=r"weight is \(7, 5\) but frame is \(5, 7\)"):
        solver.extend_depth(good[0], good[1].T, good[2])
    for value in (-1, np.nan, np.inf):
        with pytest.raises(ValueError, match="weight has values below 0 or not finite"):
            solver.extend_depth(good[0], np.full((5, 7), value, np.float32), good[2])
    with pytest.raises(ValueError, match="target is not finite where weight is above 0"):
        solver.extend_depth(np.full((5, 7), np.nan, np.float32), good[1], good[2])
    with pytest.raises(ValueError, match="iterations is 0"):
        solver.extend_depth(*good, iterations=0)
    with pytest.raises(ValueError, match="last_level is -1"):
        solver.extend_depth(*good, last_level=-1)
    anchors, frame = problem(5, 7)
    with pytest.raises(ValueError, match="cycles is 0"):
        minimiser_of(solver, anchors, frame, 1, solver.SecondOrderSettings(), cycles=0)


# Multigrid

MOST_TEXTURELESS = 200  # px, of 640


def bare_system(solver, lanes, known, g=None):
    """Return multigrid for D = v = 0 from known columns, from a rough start, and its energy."""
    from tests.conftest import Problem
    from tisfm.kernels.layout.lanes import LaneGrid
    from tisfm.kernels.solve.second_order.system import SecondOrderSystem
    from tisfm.solver.second_order_multigrid import SecondOrderMultigrid

    height, width = known.shape
    settings = solver.SecondOrderSettings()
    smoothness = reference.SecondOrder(
        alpha=settings.alpha, beta=settings.beta, gamma=settings.gamma, edges=g
    )
    weights = reference.second_order_weights(np.zeros((3, height, width)), smoothness)
    grid = LaneGrid(height, width, lanes)
    layout = Problem(grid, *[None] * 7)
    row, column = np.mgrid[:height, :width]
    rng = np.random.default_rng(0)
    start = 0.02 * rng.normal(size=(3, height, width))
    start[0] = np.sin(column / 37) * np.cos(row / 23) + 10 * start[0]
    system = SecondOrderSystem(
        grid=grid,
        tensor=layout.to_lanes(np.stack([known, 0 * known, 0 * known])),
        weights=layout.to_lanes(weights.reshape(6, height, width)),
        alpha=settings.alpha,
        beta=settings.beta,
        gamma=settings.gamma,
    )
    rho = layout.to_lanes(start)
    multigrid = SecondOrderMultigrid(system, rho)
    multigrid.coarsen()

    def distance():
        """Return the norm of the energy: the solution is zero."""
        found = layout.from_lanes(rho).astype(np.float64)
        smooth = (weights * reference.second_order_measures(found, 1.0) ** 2).sum()
        return np.sqrt(smooth + (known * found[0] ** 2).sum())

    return multigrid, distance


@pytest.mark.parametrize(
    "everywhere_else",
    nightly_except(False, of=[True, False]),
    ids=["around", "at its border only"],
)
def test_cycles_cross_a_bare_region(everywhere_else, solver):
    """Each brings the error to less than 0.3 of what it was."""
    column = np.broadcast_to(np.arange(640), (480, 640))
    first, last = 320 - MOST_TEXTURELESS // 2, 320 + MOST_TEXTURELESS // 2
    known = (column < first) | (column >= last)
    if not everywhere_else:
        known = (column == first - 1) | (column == last)
    multigrid, distance = bare_system(solver, LANES[0], known.astype(float))
    multigrid.descend()
    start = distance()
    for _ in range(9):
        multigrid.descend()
    assert distance() < 0.3**9 * start


def test_cycles_approach_the_solution_across_image_edges(solver):
    """Where g differs by a factor of a hundred: slower, but they do not stall."""
    g = 10 ** np.random.default_rng(1).uniform(-2, 0, (2, 90, 120))
    known = (np.random.default_rng(2).uniform(size=(90, 120)) < 0.05).astype(float)
    multigrid, distance = bare_system(solver, LANES[0], known, g)
    start = distance()
    for _ in range(20):
        multigrid.descend()
    assert distance() < 0.5**20 * start


def test_lanes_agree(solver):
    anchors, frame = problem(45, 70)
    results = []
    for lanes in LANES:
        minimiser, _ = minimiser_of(solver, anchors, frame, lanes, solver.SecondOrderSettings())
        minimiser.update()
        minimiser.minimise(6)
        results.append(minimiser.images())
    for result in results[1:]:
        np.testing.assert_allclose(result, results[0], rtol=1e-3, atol=1e-3)
    assert np.abs(results[0][0]).max() > 5


# Filling

HEIGHT, WIDTH = 240, 320
ROW, COLUMN = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
PLANE = 10 + np.float32(0.03) * COLUMN - np.float32(0.02) * ROW
CONSTANT = np.full((HEIGHT, WIDTH), 100, np.float32)
NOISY = CONSTANT + np.random.default_rng(0).normal(size=CONSTANT.shape).astype(np.float32)


def filled(solver, target, known, frame=NOISY, **options):
    """Return D where anchors of weight 1 are `known`; inputs stay as they are."""
    inputs = [np.ascontiguousarray(a, np.float32) for a in (target, known, frame)]
    copies = [array.copy() for array in inputs]
    depth, slopes = solver.extend_depth(*inputs, **options)
    for array, copy in zip(inputs, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    assert depth.dtype == slopes.dtype == np.float32
    assert depth.shape == frame.shape and slopes.shape == (2, *frame.shape)
    assert np.isfinite(depth).all() and np.isfinite(slopes).all()
    return depth, slopes


@pytest.mark.parametrize("level", [1, 2, 99])
def test_a_coarse_grid_extends_planes(solver, level):
    known = (ROW % 16 < 4) & (COLUMN % 16 < 4)
    depth, slopes = filled(solver, PLANE, known, CONSTANT, last_level=level)
    assert not np.array_equal(depth, filled(solver, PLANE, known, CONSTANT)[0])
    border = 2 ** min(level, 3)  # interpolation repeats the centres of the outermost cells
    inside = np.s_[border:-border, border:-border]
    np.testing.assert_allclose(depth[inside], PLANE[inside], atol=0.1)
    np.testing.assert_allclose(slopes[0], 0.03, atol=0.005)
    np.testing.assert_allclose(slopes[1], -0.02, atol=0.005)


@pytest.mark.parametrize("frame", [CONSTANT, NOISY], ids=["constant", "noisy"])
@pytest.mark.parametrize(
    ("known", "bound"),
    [
        (np.random.default_rng(1).uniform(size=PLANE.shape) < 0.02, 0.02),
        ((COLUMN < 60) | (COLUMN >= 60 + MOST_TEXTURELESS), 0.05),
        ((COLUMN == 59) | (COLUMN == 60 + MOST_TEXTURELESS), 0.1),
    ],
    ids=["2 %", "around a band", "at the borders of a band"],
)
def test_a_slanted_plane_is_carried_over(known, bound, frame, solver):
    """To a small part of a px, of the 9 px by which it rises: γ bends it a little."""
    depth, slopes = filled(solver, PLANE, known, frame)
    assert np.abs(depth - PLANE)[:, 59 : 61 + MOST_TEXTURELESS].max() < bound
    settings = solver.SecondOrderSettings(gamma=0.0)
    depth, slopes = filled(solver, PLANE, known, frame, settings=settings, iterations=10)
    assert np.abs(depth - PLANE).max() < 5e-3
    assert np.abs(slopes[0] - 0.03).max() < 1e-3 and np.abs(slopes[1] + 0.02).max() < 1e-3


def test_first_order_smoothness_alone_leaves_steps(solver):
    """What the plane above is carried over by: with γ alone it is not."""
    known = np.random.default_rng(1).uniform(size=PLANE.shape) < 0.02
    settings = solver.SecondOrderSettings(alpha=1e-6, beta=1e-3, gamma=6.0)
    depth, _ = filled(solver, PLANE, known, settings=settings)
    assert np.abs(depth - PLANE).mean() > 0.05


def test_a_roof_keeps_its_crease_along_an_image_edge(solver):
    roof = 20 - np.float32(0.05) * np.abs(COLUMN - 160)
    frame = NOISY + 30 * (COLUMN >= 160)
    scattered = np.random.default_rng(1).uniform(size=roof.shape) < 0.02
    depth, slopes = filled(solver, roof, scattered, frame)
    assert np.abs(depth - roof).max() < 0.1
    assert (slopes[0][:, 156] > 0.045).all() and (slopes[0][:, 164] < -0.045).all()
    # Over 200 px without anchors the image alone says where the crease is.
    outside = (COLUMN < 60) | (COLUMN >= 260)
    depth, slopes = filled(solver, roof, outside, frame, iterations=10)
    assert np.abs(depth - roof).max() < 0.5
    assert (slopes[0][:, 150] > 0.035).all() and (slopes[0][:, 170] < -0.035).all()
    without, _ = filled(solver, roof, outside, NOISY, iterations=10)
    assert np.abs(without - roof)[:, 160].min() > 2


@pytest.mark.parametrize("share", [1.0, 0.2, 0.05])
def test_outlying_anchors_count_little(share, solver):
    """One in ten is wrong by 10 px, which would be 1 px as a mean."""
    rng = np.random.default_rng(4)
    known = rng.uniform(size=PLANE.shape) < share
    wrong = rng.uniform(size=PLANE.shape) < 0.1
    depth, _ = filled(solver, PLANE + 10 * wrong, known)
    assert np.abs(depth - PLANE).mean() < 0.1
    assert np.abs(depth - PLANE).max() < 0.6
    either = PLANE + 10 * wrong * np.sign(rng.normal(size=PLANE.shape))
    depth, _ = filled(solver, either, known)
    assert np.abs(depth - PLANE).mean() < 0.05


def test_very_few_anchors(solver):
    nothing = np.zeros_like(PLANE)
    depth, slopes = filled(solver, np.full_like(PLANE, np.nan), nothing)
    assert not depth.any() and not slopes.any()
    one = nothing.copy()
    one[100, 50] = 1
    depth, slopes = filled(solver, PLANE, one)
    np.testing.assert_allclose(depth, PLANE[100, 50], rtol=1e-5)
    assert np.abs(slopes).max() < 1e-5
    # Along a row of anchors their slope is kept, and beside it D is what it is there.
    for gamma in (0.02, 0.0):
        settings = solver.SecondOrderSettings(gamma=gamma)
        depth, _ = filled(solver, PLANE, ROW == 100, CONSTANT, settings=settings)
        assert np.abs(depth - PLANE[100]).max() < 0.5


def test_extrapolation_is_bounded_by_gamma(solver):
    """From a corner of 40 px: without γ the plane goes on, with it the less the greater it is."""
    known = (COLUMN < 40) & (ROW < 40)
    reached = []
    for gamma in (0.0, 0.02, 1.0, 100.0):
        settings = solver.SecondOrderSettings(gamma=gamma)
        depth, _ = filled(solver, PLANE, known, CONSTANT, settings=settings, iterations=10)
        reached.append(np.ptp(depth[0]))
    assert reached[0] == pytest.approx(np.ptp(PLANE[0]), abs=0.05)
    assert reached[0] > reached[1] > reached[2] > reached[3]
    assert reached[3] < 0.3 * reached[0]


@pytest.mark.parametrize(
    "size", [(1, 1), (1, 50), (50, 1), (2, 3), (7, 200), (200, 7), (33, 65)], ids=str
)
def test_images_of_any_size(size, solver):
    part = np.s_[: size[0], : size[1]]
    depth, _ = filled(solver, PLANE[part], np.ones(size), NOISY[part])
    assert np.abs(depth - PLANE[part]).max() < 2e-3
    every = (ROW + COLUMN)[part] % 5 == 0
    depth, _ = filled(solver, PLANE[part], every, NOISY[part], iterations=10)
    assert np.abs(depth - PLANE[part]).max() < 0.1


def bits():
    """Return D and slopes of a filled frame as text, for `tests/test_one_thread.py`."""
    from tisfm.solver.second_order import extend_depth

    anchors, frame = problem(203, 317)
    depth, slopes = extend_depth(anchors[1], anchors[0], frame)
    return hashlib.sha256(depth.tobytes() + slopes.tobytes()).hexdigest()
