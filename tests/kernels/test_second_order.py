"""Second-order smoothness: sweeps, weights, coarse grids and line search, against the reference."""

from dataclasses import dataclass

import numpy as np
import pytest

from bench import reference
from tests.kernels.compared import SIZES, close
from tests.lanes import LANES
from tests.pairwise import pairwise

ALPHA, BETA, GAMMA = 2.0, 30.0, 0.1
CONTRASTS = (0.5, 0.2, 0.7)
SCALE = 0.4
SPACINGS = [1.0, 4.0]


@dataclass
class Field:
    """D with its slopes, anchors and weights of another field, as the reference takes them."""

    lanes: object  # a problem of the same size, which lays images into lanes and reads them back
    smoothness: reference.SecondOrder
    before: np.ndarray
    rho: np.ndarray
    anchors: np.ndarray
    tensor: np.ndarray
    weights: np.ndarray

    @property
    def grid(self):
        return self.lanes.grid

    def to_lanes(self, images):
        return self.lanes.to_lanes(images)

    def from_lanes(self, array):
        return self.lanes.from_lanes(array)

    def system(self, **changes):
        from tisfm.kernels.solve.second_order.system import SecondOrderSystem

        values = {
            "grid": self.grid,
            "tensor": self.to_lanes(self.tensor),
            "weights": self.to_lanes(self.weights.reshape(6, *self.rho.shape[1:])),
            "alpha": ALPHA,
            "beta": BETA,
            "gamma": GAMMA,
            "spacing": self.smoothness.spacing,
        }
        return SecondOrderSystem(**values | changes)

    def residual(self, source=None):
        """Return the right-hand side less the left one, by the matrix, (3, H, W)."""
        matrix, right = reference.second_order_system(
            self.tensor, self.weights, self.smoothness.spacing
        )
        right = right if source is None else source.ravel()
        return (right - matrix @ self.rho.ravel()).reshape(self.rho.shape)

    def energy(self, rho):
        """Return the quadratic energy of fixed weights, but for its constant."""
        matrix, right = reference.second_order_system(
            self.tensor, self.weights, self.smoothness.spacing
        )
        return rho.ravel() @ matrix @ rho.ravel() - 2 * right @ rho.ravel()


@pytest.fixture
def make(make_problem):
    def made(height, width, lanes, *, spacing=1.0, contrasts=CONTRASTS, scale=SCALE):
        rng = np.random.default_rng(3)
        size = (height, width)

        def normal(*shape):
            return rng.normal(size=shape).astype(np.float32).astype(np.float64)

        g = rng.uniform(0.1, 2, (2, *size)).astype(np.float32).astype(np.float64)
        smoothness = reference.SecondOrder(
            alpha=ALPHA, beta=BETA, gamma=GAMMA, contrasts=contrasts, spacing=spacing, edges=g
        )
        before, rho = normal(3, *size), normal(3, *size)
        known = rng.uniform(size=size) < 0.5
        anchors = np.array([known * rng.uniform(0.1, 1, size), normal(*size)])
        anchors = anchors.astype(np.float32).astype(np.float64)
        tensor = reference.anchor_tensor(before[0], *anchors, scale)
        weights = reference.second_order_weights(before, smoothness)
        problem = make_problem(height, width, 3, lanes)
        return Field(problem, smoothness, before, rho, anchors, tensor, weights)

    return made


@pairwise(size=SIZES, spacing=SPACINGS, sourced=[False, True], short=True)
def test_the_reference_without_its_matrix(size, spacing, sourced, make):
    """What its sweep is made of, against the matrix of all pixels."""
    field = make(*size, 1, spacing=spacing)
    source = np.random.default_rng(1).normal(size=field.rho.shape) if sourced else None
    found = reference.second_order_residual(
        field.tensor, field.weights, field.rho, spacing=spacing, source=source
    )
    expected = field.residual(source)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    matrix, _ = reference.second_order_system(field.tensor, field.weights, spacing)
    count = size[0] * size[1]
    own = matrix.reshape(3, count, 3, count)[:, range(count), :, range(count)]
    found = reference.second_order_matrices(field.tensor, field.weights, spacing)
    found = np.moveaxis(found.reshape(3, 3, count), 2, 0)
    np.testing.assert_allclose(found, own, rtol=1e-12, atol=1e-12 * np.abs(own).max())


@pairwise(
    size=[*SIZES, (64, 9)],
    lanes=LANES,
    spacing=SPACINGS,
    relaxation=[1.0, 1.9],
    sourced=[False, True],
    short=True,
)
def test_one_sweep_is_the_reference_sweep(size, lanes, spacing, relaxation, sourced, make):
    """On one band of rows, and on two (64 rows)."""
    field = make(*size, lanes, spacing=spacing)
    if size[1] == 1:
        field.tensor[0] += 0.1  # of a column, nothing else holds D
    rho, expected = field.to_lanes(field.rho), field.rho.copy()
    source = np.random.default_rng(1).normal(size=field.rho.shape) if sourced else None
    field.system().bind_sweep(
        rho, relaxation=relaxation, source=None if source is None else field.to_lanes(source)
    )()
    reference.second_order_sweep(
        field.tensor, field.weights, expected, spacing=spacing, relaxation=relaxation, source=source
    )
    # Floors of the pivots are a millionth of α and β, of which the least weights are 1/200.
    magnitude = np.abs(expected).max()
    np.testing.assert_allclose(field.from_lanes(rho), expected, rtol=1e-4, atol=1e-4 * magnitude)
    assert np.abs(expected - field.rho).max() > 0.1
    np.testing.assert_array_equal(rho, field.to_lanes(field.from_lanes(rho)))


@pairwise(lanes=LANES, data=[False, True], spacing=SPACINGS)
def test_pixels_without_an_open_edge_stay_finite(lanes, data, spacing, make):
    field = make(6, 16, lanes, spacing=spacing)
    field.weights[...] = 0
    field.tensor *= data
    rho = field.to_lanes(field.rho)
    field.system(spread=4.0).bind_sweep(rho, relaxation=1.0, sweeps=3)()
    found = field.from_lanes(rho)
    seen = field.tensor[0] > 0
    close(found[0][seen], -field.tensor[1][seen] / field.tensor[0][seen])
    close(found[:, ~seen], field.rho[:, ~seen])
    assert np.isfinite(found).all()


@pairwise(
    ways=3,
    size=SIZES,
    lanes=LANES,
    spacing=SPACINGS,
    contrasts=[CONTRASTS, (np.inf, 0.01, np.inf)],
    scale=[SCALE, np.inf],
    count=[0, 1, 2, 3],
    short=True,
)
def test_weight_update(size, lanes, spacing, contrasts, scale, count, make):
    field = make(*size, lanes, spacing=spacing, contrasts=contrasts, scale=scale)
    rng = np.random.default_rng(7)
    lines = rng.normal(size=(count, 2, *size)).astype(np.float32).astype(np.float64)
    terms = [lines] if count in (1, 2) else [lines[:1], lines[1:]][: count and 2]
    scales = (3.0, np.inf)[: len(terms)]
    constraints = None
    if count:
        entries = np.zeros((count, 3, *size))
        entries[:, 0], entries[:, 2] = lines[:, 0], lines[:, 1]
        constraints = field.to_lanes(entries.reshape(-1, *size))
    system, previous = field.system(), field.to_lanes(field.before[:1])
    sums = system.bind_weight_update(
        field.to_lanes(field.rho),
        previous,
        field.to_lanes(field.anchors),
        field.to_lanes(field.smoothness.open(*size)),
        constraints,
        contrasts=contrasts,
        anchor_scale=scale,
        scales=scales,
    )()
    depth, smoothness = field.rho[0], field.smoothness
    energy, tensor = reference.line_tensor(terms, depth, scales)
    energy += reference.anchor_energy(depth, *field.anchors, scale)
    energy += reference.second_order_energy(field.rho, smoothness)
    tensor = tensor + reference.anchor_tensor(depth, *field.anchors, scale)
    close(field.from_lanes(system.tensor), tensor, scale=np.abs(tensor).max())
    weights = reference.second_order_weights(field.rho, smoothness).reshape(6, *size)
    close(field.from_lanes(system.weights), weights)
    # In the halo columns, too, the eastern ones: they are the western weights of every strip.
    close(system.weights[::2], field.to_lanes(weights)[::2])
    half = (field.tensor[0] * depth + 2 * field.tensor[1]) * depth + field.tensor[2]
    half = half.sum() + reference.second_order_half_quadratic(field.rho, field.weights, smoothness)
    assert sums.energy == pytest.approx(energy, rel=5e-6)
    assert sums.half_quadratic == pytest.approx(half, rel=5e-6)
    assert sums.change == pytest.approx(np.linalg.norm(depth - field.before[0]), rel=1e-6)
    assert sums.size == pytest.approx(np.linalg.norm(depth), rel=1e-6)
    np.testing.assert_array_equal(field.from_lanes(previous)[0], depth)


def test_bad_values_are_refused(make):
    field = make(5, 7, 1)
    for change, match in (
        ({"alpha": 0.0}, "alpha is .*expected 1 positive"),
        ({"gamma": -1.0}, "gamma is -1.0: expected a number of at least 0"),
        ({"spread": np.inf}, "spread is inf"),
        ({"tensor": field.grid.allocate(6)}, r"tensor is \(6, 7, 10\): expected \(3, 7, 10\)"),
    ):
        with pytest.raises(ValueError, match=match):
            field.system(**change)
    system, rho = field.system(), field.to_lanes(field.rho)
    with pytest.raises(ValueError, match="relaxation is 2"):
        system.bind_sweep(rho, relaxation=2.0)
    arrays = (rho, field.grid.allocate(1), field.grid.allocate(2), field.grid.allocate(2))
    good = {"contrasts": CONTRASTS, "anchor_scale": SCALE}
    for change, match in (
        ({"contrasts": (1.0, 1.0)}, "contrasts is .*expected 3 positive values"),
        ({"contrasts": (1.0, 0.0, 1.0)}, "expected 3 positive values"),
        ({"anchor_scale": 0.0}, "anchor_scale is 0.0"),
        ({"scales": (1.0,)}, "expected none without constraints"),
    ):
        with pytest.raises(ValueError, match=match):
            system.bind_weight_update(*arrays, **good | change)


# Coarse grids


def halved_to_images(field, array):
    """Read a halved array as (k, h, w) by plain indexing."""
    strip, width = field.grid.strip_width // 2, -(-field.grid.width // 2)
    inner = array if field.grid.lanes > 1 else array[..., None]
    return np.stack([inner[:, 1:-1, x % strip + 1, x // strip] for x in range(width)], axis=-1)


def images_to_halved(field, images):
    """Lay coarse images (k, h, w) into the halved layout of a field's grid."""
    out = allocate_halved(field, len(images))
    strip, lanes = field.grid.strip_width // 2, field.grid.lanes
    for lane in range(lanes):
        for position in range(strip + 2):
            x = lane * strip + position - 1
            if 0 <= x < images.shape[-1]:
                site = (slice(None), slice(1, -1), position)
                out[site if lanes == 1 else (*site, lane)] = images[:, :, x]
    return out


def allocate_halved(field, components):
    from tisfm.kernels.layout.lanes import aligned_zeros
    from tisfm.kernels.solve.coarsening import halved_shape

    return aligned_zeros(halved_shape(field.grid, components))


def coarsened(field):
    """Return the coarse tensor and weights, (3, h, w) and (3, 2, h, w)."""
    arrays = allocate_halved(field, 3), allocate_halved(field, 6)
    field.system().bind_coarsen(*arrays)()
    tensor, weights = (halved_to_images(field, array) for array in arrays)
    return tensor, weights.reshape(3, 2, *weights.shape[1:])


def children(array):
    """Return the four children of every coarse pixel, zero where there is none, (4, k, h, w)."""
    height, width = array.shape[-2:]
    padded = np.pad(array, [(0, 0), (0, height % 2), (0, width % 2)])
    return np.stack([padded[:, dy::2, dx::2] for dy in (0, 1) for dx in (0, 1)])


@pairwise(size=SIZES, lanes=LANES)
def test_coarse_systems(size, lanes, make):
    field = make(*size, lanes)
    tensor, weights = coarsened(field)
    close(tensor, children(field.tensor).sum(axis=0))
    _, east, south, both = children(field.weights.reshape(6, *size))
    close(weights[:, 0], 0.5 * (east + both)[::2])
    close(weights[:, 1], 0.5 * (south + both)[1::2])


def quadric(x, y):
    """Return a quadratic surface and its slopes, (3, …)."""
    return np.array(
        [
            5 + 0.3 * x - 0.2 * y + 0.01 * x * x - 0.02 * x * y + 0.015 * y * y,
            0.3 + 0.02 * x - 0.02 * y,
            -0.2 - 0.02 * x + 0.03 * y,
        ]
    )


def tilted(x, y):
    """Return a plane whose slopes are taken for 0."""
    return np.array([5 + 0.3 * x - 0.2 * y, 0 * x, 0 * x])


@pytest.mark.parametrize(("surface", "same", "none"), [(quadric, (1,), 0), (tilted, (0, 2), 1)])
@pytest.mark.parametrize("spacing", SPACINGS)
def test_the_coarse_energy_of_a_field_is_that_of_its_interpolation(
    surface, same, none, spacing, make
):
    """Of the kinds of edges whose measure is the `same` all over the image, or `none` at all."""
    height, width = 12, 20
    field = make(height, width, 1, spacing=spacing)
    field.weights[...] = np.array([ALPHA, BETA, GAMMA])[:, None, None, None]
    field.weights[:, 0, :, -1] = field.weights[:, 1, -1] = 0
    tensor, weights = coarsened(field)
    row, column = np.mgrid[:height, :width]
    fine = surface(spacing * column, spacing * row)
    row, column = np.mgrid[: height // 2, : width // 2]
    coarse = surface(spacing * (2 * column + 0.5), spacing * (2 * row + 0.5))
    energies = []
    for rho, factors, h in ((fine, field.weights, spacing), (coarse, weights, 2 * spacing)):
        squares = factors * reference.second_order_measures(rho, h) ** 2
        energies.append(squares.sum(axis=(2, 3)))
    # Between the outermost coarse pixels lie all columns, or rows, but one.
    share = np.array([(width - 2) / (width - 1), (height - 2) / (height - 1)])
    for kind in same:
        np.testing.assert_allclose(energies[1][kind], share * energies[0][kind], rtol=1e-6)
        assert energies[0][kind].min() > 1e-3
    for found in energies:
        assert found[none].max() < 1e-20
    # Data, of a field that is the same everywhere.
    fine_data, coarse_data = (
        ((a * 2.5 + 2 * b) * 2.5 + c).sum() for a, b, c in (field.tensor, tensor)
    )
    assert coarse_data == pytest.approx(fine_data, rel=1e-6)


@pairwise(size=SIZES, lanes=LANES, spacing=SPACINGS, sourced=[False, True], short=True)
def test_restricted_residuals(size, lanes, spacing, sourced, make):
    from tisfm.kernels.solve.second_order.coarsening import offset_columns

    field = make(*size, lanes, spacing=spacing)
    source = np.random.default_rng(1).normal(size=field.rho.shape) if sourced else None
    out = allocate_halved(field, 3)
    field.system().bind_restrict(
        offset_columns(field.grid)[0],
        field.to_lanes(field.rho),
        out,
        source=None if source is None else field.to_lanes(source),
    )()
    residual = field.residual(source)
    rows, columns = (offsets(side) for side in size)
    expected = children(residual).sum(axis=0)
    expected[1] += children(spacing * columns * residual[:1])[:, 0].sum(axis=0)
    expected[2] += children(spacing * rows[:, None] * residual[:1])[:, 0].sum(axis=0)
    close(halved_to_images(field, out), expected, scale=np.abs(residual).max())


def offsets(side):
    """Return where children lie beside their parents; 0 for an only child."""
    values = np.where(np.arange(side) % 2 == 0, -0.5, 0.5)
    values[-1] *= side % 2 == 0
    return values


def add(field, coarse):
    """Return ρ with a coarse correction, (3, h, w), added to it."""
    from tisfm.kernels.solve.coarsening import interpolation_columns
    from tisfm.kernels.solve.second_order.coarsening import add_correction, offset_columns

    rho = field.to_lanes(field.rho)
    across = (*interpolation_columns(field.grid), offset_columns(field.grid)[1])
    halved = images_to_halved(field, coarse)
    add_correction(field.grid, halved, across, rho, spacing=field.smoothness.spacing)
    # Halo and padding as well.
    np.testing.assert_array_equal(rho, field.to_lanes(field.from_lanes(rho)))
    return field.from_lanes(rho)


@pairwise(size=SIZES, lanes=LANES, spacing=SPACINGS, short=True)
def test_corrections_are_integrals_of_interpolated_slopes(size, lanes, spacing, make):
    field = make(*size, lanes, spacing=spacing)
    height, width = (-(-side // 2) for side in size)
    coarse = np.random.default_rng(2).normal(size=(3, height, width)).astype(np.float32)
    expected = field.rho.copy()
    rows, columns = (offsets(side) for side in size)
    for y, x in np.ndindex(*size):
        dy, dx = (1 if y % 2 else -1), (1 if x % 2 else -1)
        far_y, far_x = np.clip(y // 2 + dy, 0, height - 1), np.clip(x // 2 + dx, 0, width - 1)
        along = []
        for line in (coarse[:, y // 2], coarse[:, far_y]):
            near, far = line[:, x // 2], line[:, far_x]
            value = 0.75 * near + 0.25 * far
            # −t(1 − t) H Δv/2 with H = 2h and t = ¼; or on along the slope, beyond the last pixel.
            value[0] -= 3 / 16 * spacing * dx * (far[1] - near[1])
            value[0] += (far_x == x // 2) * columns[x] * spacing * near[1]
            along.append(value)
        value = 0.75 * along[0] + 0.25 * along[1]
        value[0] -= 3 / 16 * spacing * dy * (along[1][2] - along[0][2])
        value[0] += (far_y == y // 2) * rows[y] * spacing * along[0][2]
        expected[:, y, x] += value
    close(add(field, coarse), expected)


@pytest.mark.parametrize("lanes", LANES)
def test_quadrics_are_interpolated_exactly(lanes, make):
    """In the interior; and planes up to the border."""
    field = make(14, 40, lanes, spacing=2.0)
    field.rho[...] = 0
    rows, columns = np.mgrid[:14, :40]
    coarse_rows, coarse_columns = np.mgrid[:7, :20]
    where = 2.0 * (2 * coarse_columns + 0.5), 2.0 * (2 * coarse_rows + 0.5)
    for surface, inside in ((quadric, np.s_[:, 1:-1, 1:-1]), (plane, np.s_[:])):
        expected = surface(2.0 * columns, 2.0 * rows)
        found = add(field, surface(*where).astype(np.float32))
        close(found[inside], expected[inside], scale=np.abs(expected).max())


def plane(x, y):
    return np.array([5 + 0.3 * x - 0.2 * y, 0.3 + 0 * x, -0.2 + 0 * x])


# Line search


@pairwise(size=SIZES, lanes=LANES, spacing=SPACINGS, short=True)
def test_the_energy_in_a_plane(size, lanes, spacing, make):
    from tisfm.kernels.solve.second_order.line_search import bind_plane_energy

    field = make(*size, lanes, spacing=spacing)
    rng = np.random.default_rng(3)
    before, step = rng.normal(size=(2, *field.rho.shape)).astype(np.float32).astype(np.float64)
    in_lanes = [field.to_lanes(array) for array in (field.rho, before, step)]
    matrix, vector = bind_plane_energy(field.grid, field.system().arrays, spacing / 2, *in_lanes)()
    scale = abs(field.energy(before)) + abs(field.energy(step))
    for p, q in ((1.0, 0.0), (0.3, -0.7), (0.0, 2.0)):
        z = np.array([p, q])
        change = field.energy(before + p * field.rho + q * step) - field.energy(before)
        assert z @ matrix @ z + 2 * z @ vector == pytest.approx(change, rel=1e-4, abs=1e-5 * scale)


@pytest.mark.parametrize("lanes", LANES)
def test_a_line_search_leaves_the_least_energy_of_the_plane(lanes, make):
    field = make(13, 37, lanes)
    rng = np.random.default_rng(3)
    before, step = rng.normal(size=(2, *field.rho.shape)).astype(np.float32).astype(np.float64)
    in_lanes = [field.to_lanes(array) for array in (field.rho, before, step)]
    field.system().bind_line_search(*in_lanes)()
    found = field.from_lanes(in_lanes[0]).astype(np.float64)
    np.testing.assert_array_equal(in_lanes[1], in_lanes[0])
    close(field.from_lanes(in_lanes[2]), found - before)
    least = field.energy(found)
    for direction in (field.rho - before, step):
        for size in (1e-2, -1e-2):
            assert field.energy(found + size * direction) > least
