"""Normal equations of a rigid motion, with every pixel's inverse depth eliminated.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import LaneArray, LaneData, SumArray, lane_count, lane_kernel
from tisfm.kernels.layout.reductions import BLOCK, add_blocks, block_sums, store_sum
from tisfm.kernels.model import MIN_DEPTH_RATIO, MIN_DIVISOR
from tisfm.kernels.model.robust import (
    check_constraints,
    motion_tensor,
    scale_pairs,
    sum_of_squares,
    terms_of,
)
from tisfm.kernels.rigid.epipolar import check_geometry
from tisfm.kernels.solve.linear_system import LinearSystem


def motion_system(
    # the system of D, with one unknown per pixel; its edge weights and coordinates are read
    system: LinearSystem,
    # lane array, 3 components for each of 1 to 3 constraints: (p, q, c)
    # (`tisfm.kernels.data.constraints`), not restricted to epipolar lines
    constraints: LaneData,
    inverse_depth: LaneData,  # lane array, 1 component: D
    labels: LaneData,  # lane array, 1 component
    *,
    motions: np.ndarray,  # (K, 3, 4) float32
    label: int,  # the motion whose pixels are summed
    focal: float,  # px
    scales: Sequence[float],  # m_i ε² of each term (`tisfm.kernels.model.robust`)
    depth_stiffness: float,  # α, weight of D's regularisation here; with infinity, D is fixed
    # Squared residual at which the weight of the data is a quarter (Geman–McClure). Independently
    # moving objects have larger residuals, and so hardly any weight. Infinity for equal weights.
    quarter_weight_residual: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Sum the normal equations of a small change of one motion, with inverse depth eliminated.

    A change (δt, δω) of the motion adds d δt + δω × (R x̂ + d t) to R x̂ + d t, and B (δt, δω) to the
    flow. Every pixel's D may change with the motion, against the smoothness term with fixed
    neighbours. Elimination of D gives the Schur complement BᵀJB − BᵀJa (aᵀJa + α b̄)⁻¹ aᵀJB, with b̄
    the sum of the edge weights of the pixel.

    Returns a matrix and a vector, (6, 6) and (6,) float64: the energy changes by xᵀ matrix x + 2 xᵀ
    vector, with x = (δt, δω).
    """
    grid = system.grid
    if system.components != 1:
        raise ValueError(f"system has {system.components} unknowns at a pixel: expected 1, D")
    count = check_constraints(grid, constraints, scales)
    check_geometry(grid, inverse_depth, labels, system.x_hat, system.y_hat, motions)
    partial = block_sums(grid, 27)
    _motion_system[grid.lanes](
        constraints, inverse_depth, labels, system.weights, system.x_hat, system.y_hat,
        np.ascontiguousarray(motions[label]), label, focal, *scale_pairs(scales)[::2],
        min(depth_stiffness, 1e12), 1 / quarter_weight_residual, count, partial,
    )  # fmt: skip
    sums = add_blocks(partial)
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = sums[:21]
    return matrix + np.triu(matrix, 1).T, sums[21:]


@lane_kernel
def _motion_system(
    terms: LaneArray(3),  # (3 count, H+2, S+2)
    inverse_depth: LaneArray(3),  # (1, H+2, S+2)
    labels: LaneArray(3),  # (1, H+2, S+2)
    weights: LaneArray(3),  # (2, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    label: ti.f32,
    focal: ti.f32,
    inverse_scale0: ti.f32,
    inverse_scale1: ti.f32,
    alpha: ti.f32,
    residual_scale: ti.f32,
    count: ti.template(),
    partial: SumArray(3),  # (H, blocks, 27)
):
    height, strip = labels.shape[1] - 2, labels.shape[2] - 2
    blocks = partial.shape[1]
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        y = row + 1
        sums = ti.static([bind(0.0 * x_hat[1]) for _ in range(27)])
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            s = position + 1
            difference = labels[0, y, s] - label
            is_label = ti.max(1.0 - ti.max(difference, 0.0 - difference), 0.0)
            d = inverse_depth[0, y, s] / focal
            # (x, yy): normalised coordinates of the point after the motion.
            nearness = 1.0 / ti.max(coordinate(motion, 2, x_hat[s], y_hat[y], d), MIN_DEPTH_RATIO)
            x = nearness * coordinate(motion, 0, x_hat[s], y_hat[y], d)
            yy = nearness * coordinate(motion, 1, x_hat[s], y_hat[y], d)
            u, v = focal * (x - x_hat[s]), focal * (yy - y_hat[y])
            a = nearness * (motion[0, 3] - x * motion[2, 3])
            b = nearness * (motion[1, 3] - yy * motion[2, 3])
            constraints = ti.static(
                [[bind(terms[3 * i + k, y, s]) for k in range(3)] for i in range(count)]
            )
            data_terms = ti.static(terms_of(constraints))
            squares = ti.static([bind(sum_of_squares(term, u, v)) for term in data_terms])
            residual = 0.0 * u
            for term in ti.static(range(len(data_terms))):
                residual += squares[term]
            weight = 1.0 / (1.0 + residual_scale * residual)
            weight = is_label * weight * weight
            j11, j12, j22, j1, j2 = ti.static(
                _weighted_tensor(data_terms, squares, (inverse_scale0, inverse_scale1), weight)
            )
            g1, g2 = j11 * u + j12 * v + j1, j12 * u + j22 * v + j2
            neighbours = weights[0, y, s] + weights[0, y, s - 1]
            neighbours += weights[1, y, s] + weights[1, y - 1, s]
            translation_factor = focal * d * nearness
            columns = ti.static(motion_columns(x, yy, translation_factor, focal))
            curvature = a * (j11 * a + 2.0 * j12 * b) + j22 * b * b
            inverse = 1.0 / (curvature + alpha * neighbours + MIN_DIVISOR)
            slope = a * g1 + b * g2
            weighted_columns = ti.static(tensor_columns(columns, j11, j12, j22))
            couplings = ti.static(depth_couplings(weighted_columns, a, b))
            for i in ti.static(range(6)):
                for j in ti.static(range(i, 6)):
                    k = ti.static(6 * i - i * (i - 1) // 2 + j - i)
                    sums[k] += (
                        columns[i][0] * weighted_columns[j][0]
                        + columns[i][1] * weighted_columns[j][1]
                        - inverse * couplings[i] * couplings[j]
                    )
                sums[21 + i] += (
                    columns[i][0] * g1 + columns[i][1] * g2 - inverse * couplings[i] * slope
                )
        for k in ti.static(range(27)):
            store_sum(partial, row, block, k, sums[k], ti.static(lane_count(labels)))


@ti.func
def coordinate(motion: ti.template(), row: ti.template(), x, y, d):
    """Return one coordinate of R x̂ + d t."""
    rotated = motion[row, 0] * x + motion[row, 1] * y + motion[row, 2]
    return rotated + d * motion[row, 3]


def _weighted_tensor(data_terms: list, squares: list, inverses: tuple, pixel_weight: Any) -> list:
    """Return the weighted sums of J11, J12, J22, j1 and j2 over all terms."""
    total: list[Any] = [0.0] * 5
    for constraints, q, inverse in zip(data_terms, squares, inverses, strict=False):
        weight = bind(pixel_weight / ti.sqrt(1.0 + inverse * q))
        entries = motion_tensor(constraints)[:5]
        total = [
            entry_sum + weight * entry for entry_sum, entry in zip(total, entries, strict=True)
        ]
    return [bind(entry) for entry in total]


def motion_columns(x: Any, y: Any, translation_factor: Any, focal: Any) -> list[tuple[Any, Any]]:
    """Return the columns of B at a point (x, y, 1) after the motion.

    `translation_factor` is f·d over the depth ratio.
    """
    zero = bind(0.0 * x)
    xy = bind(focal * x * y)
    return [
        (translation_factor, zero),
        (zero, translation_factor),
        (bind(0.0 - translation_factor * x), bind(0.0 - translation_factor * y)),
        (bind(0.0 - xy), bind(0.0 - focal * (1.0 + y * y))),
        (bind(focal * (1.0 + x * x)), xy),
        (bind(0.0 - focal * y), bind(focal * x)),
    ]


def tensor_columns(columns: list, j11: Any, j12: Any, j22: Any) -> list[tuple[Any, Any]]:
    """Return the columns of J B."""
    return [(bind(j11 * a + j12 * b), bind(j12 * a + j22 * b)) for a, b in columns]


def depth_couplings(weighted_columns: list, a: Any, b: Any) -> list:
    """Return aᵀ J B."""
    return [bind(a * p + b * q) for p, q in weighted_columns]
