"""Red–black Gauss–Seidel sweeps with over-relaxation (eq. 16, 22–23 of the paper, docs/method.md).

At each pixel, B = GᵀJG + α·diag(b̄), and the update is ρ̂ ← ρ̂ + ω_r·B⁻¹(c − Bρ̂). A solution of
Bρ̂ = c would give the same iteration. But this update computes differences of neighbours instead of
differences of large numbers, and its limit stays right where a pivot floor is active.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable
from typing import Any

import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    CHUNK,
    INDEX_MASK,
    LaneArray,
    LaneData,
    LaneGrid,
    component_starts,
    element,
    first_row,
    lane_kernel,
    refresh_halo,
    store,
)
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.kernels.model.rigid_motion import flow_of, motion_columns
from tisfm.kernels.model.robust import repeat_shared
from tisfm.kernels.model.small_spd import DATA_FLOOR, cholesky_solve, woodbury_solve

SOLVERS = ("cholesky", "closed_form")
RELAXATION_BAND = 32  # smallest number of rows of a band, so that there are few borders
MAX_SWEEPS = 64  # limit of the sweeps in one launch, for a grid with a single band


def bind_sweeps(
    grid: LaneGrid,
    # arrays of a `tisfm.kernels.solve.linear_system.LinearSystem`, which has checked them
    arrays: tuple[LaneData, ...],
    rho: LaneData,  # lane array, n components: ρ̂, px/frame; modified in place, halo included
    # lane array, n components, or None: right-hand side c in place of −Gᵀj
    source: LaneData | None,
    *,
    relaxation: float,  # in (0, 2); 1 is Gauss–Seidel
    solver: str,
    sweeps: int,
) -> Callable[[], None]:
    """Return a function that runs full red–black sweeps."""
    if not 0 < relaxation < 2:
        raise ValueError(f"relaxation is {relaxation}: expected a value in (0, 2)")
    if solver not in SOLVERS:
        raise ValueError(f"solver is {solver!r}: expected one of {SOLVERS}")
    weights = arrays[1]
    components, weight_count = rho.shape[0], weights.shape[0] // 2
    closed_form, has_source = solver == "closed_form", source is not None
    system = (*arrays, rho if source is None else source, relaxation)
    options = (components, weight_count, closed_form, has_source)
    if grid.lanes == 1:
        return repeat_launches((_sweep_sites[1].bind(*system, *options, rho), sweeps))
    return sweeps_in_bands(_sweep[grid.lanes], (*system, *options), rho, grid.height, sweeps)


def sweeps_in_bands(
    kernel: Kernel,  # its last arguments are is_single, bands, repeats and rho
    arguments: tuple,
    rho: LaneData,
    height: int,  # rows of the grid
    sweeps: int,
) -> Callable[[], None]:
    """Return a function that runs sweeps, a band of rows in each thread."""
    # The bands must not depend on the number of threads: rows beside borders between bands are
    # computed in a separate loop, which may round differently.
    bands = max(1, 2 * (height // (2 * RELAXATION_BAND)))

    def launch(repeats: int) -> Callable[[], None]:
        return kernel.bind(*arguments, bands == 1, bands, repeats, rho)

    if bands > 1:
        return repeat_launches((launch(1), sweeps))
    # One thread computes a single band, so it can run several sweeps per launch. Their number is
    # limited, because a launch cannot be interrupted.
    full_launches, remaining_sweeps = divmod(sweeps, MAX_SWEEPS)
    return repeat_launches(
        (launch(MAX_SWEEPS), full_launches), (launch(remaining_sweeps), min(remaining_sweeps, 1))
    )


def repeat_launches(*parts: tuple[Callable[[], None], int]) -> Callable[[], None]:
    """Return a function that runs each launch the given number of times."""

    def run() -> None:
        for launch, times in parts:
            for _ in range(times):
                launch()

    return run


@lane_kernel
def _sweep(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    alpha: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    source: LaneArray(3),  # (n, H+2, S+2), read if `has_source`
    relaxation: ti.f32,
    n: ti.template(),
    weight_count: ti.template(),  # weights of an edge: n, or 1
    closed_form: ti.template(),
    has_source: ti.template(),
    is_single: ti.template(),
    bands: ti.i32,
    repeats: ti.i32,
    rho: LaneArray(3),  # (n, H+2, S+2), in place
):
    """Sweep in one pass over memory: black sites follow one row behind red sites.

    A thread processes a band of rows at a time. Black rows that touch another band wait until all
    red sites are done. So the result equals, up to rounding, a sweep of all red and then of all
    black sites. `repeats` is the number of sweeps; it is 1 unless there is a single band
    (`is_single`), which needs no other thread.
    """
    height = rho.shape[1] - 2
    pairs = (rho.shape[2] - 2) // 2
    chunk = ti.static(1 if is_single else CHUNK)
    ti.loop_config(serialize=is_single)
    for task in range(chunk * bands):
        if task % chunk == 0:
            alphas = ti.static([bind(alpha[k]) for k in range(n)])
            stride = rho.shape[2] & INDEX_MASK
            starts = ti.static(component_starts(rho, max(6, 2 * weight_count)))
            band = task // chunk
            first, last = first_row(band, height, bands), first_row(band + 1, height, bands)
            first_black = ti.select(band > 0, first + 1, first)
            last_black = ti.select(band < bands - 1, last - 1, last)
            for tick in range(repeats * (2 * (last - first) + 2)):
                step = tick % (2 * (last - first) + 2)
                color = step % 2
                row = first + step // 2 - color
                is_red = color == 0 and row < last
                is_black = color == 1 and row >= first_black and row < last_black
                if is_red or is_black:
                    for pair in range(pairs):
                        s = 2 * pair + (row + color) % 2 + 1
                        relax_at(
                            tensor, weights, x_hat, y_hat, source, alphas, stride, starts,
                            relaxation, n, weight_count, closed_form, has_source, rho, row + 1, s,
                        )  # fmt: skip
                    for k in range(n):
                        refresh_halo(rho, k, row + 1)
    # Now the black rows on both sides of every border between bands.
    if ti.static(not is_single):
        for task in range(CHUNK * 2 * (bands - 1)):
            if task % CHUNK == 0:
                alphas = ti.static([bind(alpha[k]) for k in range(n)])
                stride = rho.shape[2] & INDEX_MASK
                starts = ti.static(component_starts(rho, max(6, 2 * weight_count)))
                border = task // CHUNK
                row = first_row(border // 2 + 1, height, bands) - 1 + border % 2
                for pair in range(pairs):
                    s = 2 * pair + (row + 1) % 2 + 1
                    relax_at(
                        tensor, weights, x_hat, y_hat, source, alphas, stride, starts,
                        relaxation, n, weight_count, closed_form, has_source, rho, row + 1, s,
                    )  # fmt: skip
                for k in range(n):
                    refresh_halo(rho, k, row + 1)


@lane_kernel
def _sweep_sites(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    weights: LaneArray(3),  # (2n or 2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    alpha: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (n,)
    source: LaneArray(3),  # (n, H+2, S+2), read if `has_source`
    relaxation: ti.f32,
    n: ti.template(),
    weight_count: ti.template(),  # weights of an edge: n, or 1
    closed_form: ti.template(),
    has_source: ti.template(),
    rho: LaneArray(3),  # (n, H+2, S+2), in place
):
    """Sweep all red and then all black sites, each site in its own thread; for one lane only."""
    height = rho.shape[1] - 2
    pairs = (rho.shape[2] - 2) // 2
    for color in ti.static(range(2)):
        for row, pair in ti.ndrange(height, pairs):
            s = 2 * pair + (row + color) % 2 + 1
            alphas = ti.static([bind(alpha[k]) for k in range(n)])
            stride = rho.shape[2] & INDEX_MASK
            starts = ti.static(component_starts(rho, max(6, 2 * weight_count)))
            relax_at(
                tensor, weights, x_hat, y_hat, source, alphas, stride, starts,
                relaxation, n, weight_count, closed_form, has_source, rho, row + 1, s,
            )  # fmt: skip


@ti.func
def relax_at(
    tensor: ti.template(), weights: ti.template(), x_hat: ti.template(), y_hat: ti.template(),
    source: ti.template(), alphas: ti.template(), stride, starts: ti.template(), relaxation,
    n: ti.template(), weight_count: ti.template(), closed_form: ti.template(),
    has_source: ti.template(), rho: ti.template(), y, s,
):  # fmt: skip
    """Solve one pixel (one vector of lanes) with over-relaxation."""
    i = (y * stride + s) & INDEX_MASK
    columns = ti.static(motion_columns(n, x_hat[s], y_hat[y]))
    center = ti.static([bind(element(rho, i + starts[k])) for k in range(n)])
    edges = ti.static(edges_at(weights, starts, stride, weight_count, i))
    j = ti.static([bind(element(tensor, i + starts[k])) for k in range(3)])
    residual = ti.static(
        residual_at(
            tensor, edges, columns, source if has_source else None, alphas, starts, stride, rho,
            center, i,
        )
    )  # fmt: skip
    step = ti.static(_solve(closed_form, alphas, edges, columns, j, residual))
    for k in ti.static(range(n)):
        store(rho, i + starts[k], center[k] + relaxation * step[k])


def edges_at(weights: Any, starts: list, stride: Any, weight_count: int, i: Any) -> list:
    """Return the weights of a pixel's E, W, S and N edges, lists of `weight_count` values."""
    return [
        [bind(element(weights, index + starts[first + k])) for k in range(weight_count)]
        for first, index in ((0, i), (0, i - 1), (weight_count, i), (weight_count, i - stride))
    ]


def residual_at(
    tensor: Any,
    edges: list,
    columns: list,
    source: Any,
    alphas: list,
    starts: list,
    stride: Any,
    rho: Any,
    center: list,
    i: Any,
) -> list:
    """Return c − Bρ̂ of a pixel, with ρ̂ = `center`, while compiling; without `source`, c = −Gᵀj.

    `i` is the pixel's index for `element`; `edges` are from `edges_at`.
    """
    n = len(center)
    u, v = flow_of(columns, center)
    j11, j12, j22, j1, j2 = (bind(element(tensor, i + starts[k])) for k in range(5))
    # Half the gradient of the data term by the flow, J(u, v)ᵀ + j.
    g1, g2 = j11 * u + j12 * v, j12 * u + j22 * v
    if source is None:
        g1, g2 = g1 + j1, g2 + j2
    g1, g2 = bind(g1), bind(g2)
    neighbours = (i + 1, i - 1, i + stride, i - stride)
    residual = []
    for k, (a, b) in enumerate(columns):
        smoothness: Any = 0.0
        for side, index in zip(edges, neighbours, strict=True):
            difference = element(rho, index + starts[k]) - center[k]
            smoothness = smoothness + repeat_shared(side, n)[k] * difference
        total = alphas[k] * smoothness - a * g1 - b * g2
        if source is not None:
            total = total + element(source, i + starts[k])
        residual.append(bind(total))
    return residual


def _solve(
    closed_form: bool, alphas: list, edges: list, columns: list, tensor: list, residual: list
) -> list:
    """Return B⁻¹ residual, generated by the chosen solver."""
    weight_sums = [bind(sum(sides[1:], sides[0])) for sides in zip(*edges, strict=True)]
    totals = repeat_shared(weight_sums, len(alphas))
    j11, j12, j22 = tensor
    # A pixel whose edges all have weight 0 has only its data. The floor shortens its steps, but the
    # limit, where the residual is zero, stays the same.
    floor = bind(DATA_FLOOR * (j11 + j22) + MIN_DIVISOR)
    if closed_form and len(alphas) > 1:  # a single unknown needs no closed form
        if len(weight_sums) == 1:  # one division of vectors is enough
            min_alpha = alphas[0]
            for alpha in alphas[1:]:
                min_alpha = ti.min(min_alpha, alpha)
            shared = bind(1.0 / ti.max(totals[0], floor * bind(1.0 / min_alpha)))
            inverse = [bind(shared * bind(1.0 / alpha)) for alpha in alphas]
        else:
            inverse = [
                bind(1.0 / ti.max(alpha * total, floor))
                for alpha, total in zip(alphas, totals, strict=True)
            ]
        return woodbury_solve(inverse, columns, tensor, residual)
    tensor_columns = [(bind(j11 * a + j12 * b), bind(j12 * a + j22 * b)) for a, b in columns]
    matrix = []
    for i, (a, b) in enumerate(columns):
        row = [a * tensor_columns[j][0] + b * tensor_columns[j][1] for j in range(i)]
        diagonal = ti.max(alphas[i] * totals[i], floor)
        matrix.append([*row, diagonal + a * tensor_columns[i][0] + b * tensor_columns[i][1]])
    return cholesky_solve([[bind(entry) for entry in row] for row in matrix], residual)
