"""Equations of several frames compared with one keyframe; its pixels have one inverse depth each.

A small change (δt, δω) of a frame's motion adds d δt + δω × (R x̂ + d t) to R x̂ + d t, and
B (δt, δω) to the flow; a change δD adds a δD to the flow. With e = J u + j, a frame adds BᵀJB and
Bᵀe to the equations of its motion, and aᵀJa and aᵀe to the equation of every pixel's depth;
aᵀJB couples the two. Depth can be eliminated only after all frames are added.

With fixed motions, the data term of a frame along its epipolar line is A D² + 2 B D + C. These
three numbers of each pixel are added up over the frames.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import (
    LaneArray,
    LaneData,
    LaneGrid,
    SumArray,
    check_array,
    lane_count,
    lane_kernel,
)
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.layout.reductions import BLOCK, add_blocks, block_sums, store_sum
from tisfm.kernels.model import MIN_DEPTH_RATIO, MIN_DIVISOR
from tisfm.kernels.rigid.motion_system import (
    coordinate,
    depth_couplings,
    motion_columns,
    tensor_columns,
)

FRAME_SUMS = 27  # sums of a frame: the upper triangle of BᵀJB, row by row, then Bᵀe
PAIR_SUMS = 42  # sums of a pair of frames: a 6 × 6 block, and a vector of 6 for a frame with itself
TASK_ROWS = 8  # image rows that one thread sums in a fixed order


@operation
def squared_residual(
    grid: LaneGrid,
    tensor: LaneData,  # lane array, 6 components: J11, J12, J22, j1, j2 and J_tt
    flow: LaneData,  # lane array, 2 components
    # lane array, 1 component: uᵀJu + 2 jᵀu + J_tt, or 0 if rounding makes this negative
    out: LaneData,
) -> Launch:
    """Compute the squared residual of a frame's constraints at a flow."""
    grid.check(tensor, 6, "tensor")
    grid.check(flow, 2, "flow")
    grid.check(out, 1, "out")
    return _squared_residual[grid.lanes].bind(tensor, flow, out)


def add_frame(
    grid: LaneGrid,
    # lane array, 6 components: J11, J12, J22, j1, j2 and J_tt, at the flow of `motion`
    tensor: LaneData,
    inverse_depth: LaneData,  # lane array, 1 component: D = f·d
    # lane array, 1 component: weight of each pixel of the keyframe; 0 outside the image
    weight: LaneData,
    # x_hat, y_hat: normalised coordinates of columns, as from `LaneGrid.columns`, and of rows,
    # (H + 2,) float32
    x_hat: LaneData,
    y_hat: LaneData,
    # lane array, 6 components for each frame: aᵀJB of all frames; the 6 components of this frame
    # are overwritten
    slopes: LaneData,
    sums: LaneData,  # lane array, 2 components: aᵀJa and aᵀe, added for this frame
    *,
    number: int,  # index of the frame
    motion: np.ndarray,  # (3, 4) float32: R and t
    focal: float,  # px
    # squared residual at which the weight of the data is a quarter (Geman–McClure)
    quarter_weight_residual: float,
) -> tuple[np.ndarray, np.ndarray]:  # matrix, vector, (6, 6) and (6,) float64: BᵀJB and Bᵀe
    """Sum the equations of a frame's motion, and add its part to the equations of depth."""
    grid.check(tensor, 6, "tensor")
    grid.check(inverse_depth, 1, "inverse_depth")
    grid.check(weight, 1, "weight")
    grid.check_columns(x_hat, "x_hat")
    grid.check_rows(y_hat, "y_hat")
    grid.check(slopes, 6 * _frames_of(slopes, number), "slopes")
    grid.check(sums, 2, "sums")
    check_array(motion, (3, 4), "motion", aligned=False)
    partial = block_sums(grid, FRAME_SUMS)
    _add_frame[grid.lanes](
        tensor, inverse_depth, weight, x_hat, y_hat, motion, focal, 1 / quarter_weight_residual,
        6 * number, slopes, sums, partial,
    )  # fmt: skip
    total = add_blocks(partial)
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = total[:21]
    return matrix + np.triu(matrix, 1).T, total[21:]


def eliminate_depth(
    grid: LaneGrid,
    slopes: LaneData,  # lane array, 6 components for each of M frames: s = aᵀJB
    sums: LaneData,  # lane array, 2 components: c = aᵀJa and g = aᵀe of all frames
    *,
    depth_stiffness: float,  # keeps depth near its value, in the unit of c; positive
) -> tuple[np.ndarray, np.ndarray]:
    """Sum the Schur complement terms that eliminate depth from the equations of all motions.

    The caller subtracts them from the equations of the motions.

    Returns a matrix and a vector, (6 M, 6 M) and (6 M,) float64: Σ s sᵀ / (c + σ) and Σ s g / (c
    + σ) over the pixels, with σ the depth stiffness.
    """
    count = _frames_of(slopes, 0)
    grid.check(slopes, 6 * count, "slopes")
    grid.check(sums, 2, "sums")
    if not depth_stiffness > 0:
        raise ValueError(f"depth_stiffness is {depth_stiffness}: expected a positive number")
    pairs = np.stack(np.triu_indices(count), axis=1).astype(np.int32)
    bands = -(-grid.height // TASK_ROWS)
    partial = np.zeros(
        (bands, len(pairs), PAIR_SUMS), np.float32 if grid.lanes == 1 else np.float64
    )
    _eliminate_depth[grid.lanes](slopes, sums, depth_stiffness, pairs, partial)
    total = partial.sum(axis=0, dtype=np.float64)
    matrix, vector = np.zeros((count, 6, count, 6)), np.zeros((count, 6))
    for (first, second), pair_sums in zip(pairs, total, strict=True):
        block = pair_sums[:36].reshape(6, 6)
        matrix[first, :, second], matrix[second, :, first] = block, block.T
        if first == second:
            vector[first] = pair_sums[36:]
    return matrix.reshape(6 * count, 6 * count), vector.ravel()


def _frames_of(slopes: LaneData, number: int) -> int:
    """Return the number of frames, with 6 components each; raise if `number` is not below it."""
    count = slopes.shape[0] // 6
    if not 0 <= number < count:
        raise ValueError(f"slopes has components of {count} frames: expected more than {number}")
    return int(count)


@lane_kernel
def _squared_residual(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    flow: LaneArray(3),  # (2, H+2, S+2)
    out: LaneArray(3),  # (1, H+2, S+2)
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        u, v = flow[0, y, s], flow[1, y, s]
        along_u = tensor[0, y, s] * u + tensor[1, y, s] * v + 2.0 * tensor[3, y, s]
        along_v = tensor[1, y, s] * u + tensor[2, y, s] * v + 2.0 * tensor[4, y, s]
        out[0, y, s] = ti.max(along_u * u + along_v * v + tensor[5, y, s], 0.0)


@lane_kernel
def _add_frame(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    inverse_depth: LaneArray(3),  # (1, H+2, S+2)
    weight: LaneArray(3),  # (1, H+2, S+2)
    x_hat: LaneArray(1),  # (S+2,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H+2,)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    focal: ti.f32,
    residual_scale: ti.f32,
    first: ti.i32,
    slopes: LaneArray(3),  # (6 frames, H+2, S+2)
    depth_sums: LaneArray(3),  # (2, H+2, S+2), in place
    partial: SumArray(3),  # (H, blocks, 27)
):
    height, strip = weight.shape[1] - 2, weight.shape[2] - 2
    blocks = partial.shape[1]
    for index in range(height * blocks):
        row, block = index // blocks, index % blocks
        y = row + 1
        sums = ti.static([bind(0.0 * x_hat[1]) for _ in range(FRAME_SUMS)])
        for position in range(block * BLOCK, ti.min((block + 1) * BLOCK, strip)):
            s = position + 1
            d = inverse_depth[0, y, s] / focal
            # (x, yy): normalised coordinates of the point after the motion.
            nearness = 1.0 / ti.max(coordinate(motion, 2, x_hat[s], y_hat[y], d), MIN_DEPTH_RATIO)
            x = nearness * coordinate(motion, 0, x_hat[s], y_hat[y], d)
            yy = nearness * coordinate(motion, 1, x_hat[s], y_hat[y], d)
            u, v = focal * (x - x_hat[s]), focal * (yy - y_hat[y])
            a = nearness * (motion[0, 3] - x * motion[2, 3])
            b = nearness * (motion[1, 3] - yy * motion[2, 3])
            j11, j12, j22 = tensor[0, y, s], tensor[1, y, s], tensor[2, y, s]
            g1, g2 = j11 * u + j12 * v + tensor[3, y, s], j12 * u + j22 * v + tensor[4, y, s]
            residual = (g1 + tensor[3, y, s]) * u + (g2 + tensor[4, y, s]) * v + tensor[5, y, s]
            trust = 1.0 / (1.0 + residual_scale * ti.max(residual, 0.0))
            trust = weight[0, y, s] * trust * trust
            j11, j12, j22, g1, g2 = trust * j11, trust * j12, trust * j22, trust * g1, trust * g2
            columns = ti.static(motion_columns(x, yy, focal * d * nearness, focal))
            weighted_columns = ti.static(tensor_columns(columns, j11, j12, j22))
            couplings = ti.static(depth_couplings(weighted_columns, a, b))
            depth_sums[0, y, s] = depth_sums[0, y, s] + a * (j11 * a + 2.0 * j12 * b) + j22 * b * b
            depth_sums[1, y, s] = depth_sums[1, y, s] + a * g1 + b * g2
            for i in ti.static(range(6)):
                slopes[first + i, y, s] = couplings[i]
                for j in ti.static(range(i, 6)):
                    k = ti.static(6 * i - i * (i - 1) // 2 + j - i)
                    sums[k] += (
                        columns[i][0] * weighted_columns[j][0]
                        + columns[i][1] * weighted_columns[j][1]
                    )
                sums[21 + i] += columns[i][0] * g1 + columns[i][1] * g2
        for k in ti.static(range(FRAME_SUMS)):
            store_sum(partial, row, block, k, sums[k], ti.static(lane_count(weight)))


@lane_kernel
def _eliminate_depth(
    slopes: LaneArray(3),  # (6 frames, H+2, S+2)
    depth_sums: LaneArray(3),  # (2, H+2, S+2)
    depth_stiffness: ti.f32,
    pairs: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (pairs, 2)
    partial: SumArray(3),  # (bands, pairs, 42)
):
    height, strip = slopes.shape[1] - 2, slopes.shape[2] - 2
    count = pairs.shape[0]
    for index in range(partial.shape[0] * count):
        band, pair = index // count, index % count
        first, second = 6 * pairs[pair, 0], 6 * pairs[pair, 1]
        sums = ti.static([bind(0.0 * depth_sums[0, 1, 1]) for _ in range(PAIR_SUMS)])
        for y in range(band * TASK_ROWS + 1, ti.min((band + 1) * TASK_ROWS, height) + 1):
            for s in range(1, strip + 1):
                inverse = 1.0 / (depth_sums[0, y, s] + depth_stiffness)
                second_slopes = ti.static([bind(slopes[second + k, y, s]) for k in range(6)])
                step = inverse * depth_sums[1, y, s]
                for i in ti.static(range(6)):
                    first_slope = slopes[first + i, y, s]
                    sums[36 + i] += first_slope * step
                    scaled_slope = inverse * first_slope
                    for j in ti.static(range(6)):
                        sums[6 * i + j] += scaled_slope * second_slopes[j]
        for i in ti.static(range(7)):  # two loops, as Taichi warns about long unrolled loops
            for j in ti.static(range(6)):
                k = ti.static(6 * i + j)
                store_sum(partial, band, pair, k, sums[k], ti.static(lane_count(slopes)))


@operation
def add_depth_terms(
    grid: LaneGrid,
    tensor: LaneData,  # lane array, 6 components: J11, J12, J22, j1, j2 and J_tt, at `flow`
    # flow, direction: lane arrays, 2 components: (u₀, v₀) and a = ∂(u, v)/∂D, at `inverse_depth`
    flow: LaneData,
    direction: LaneData,
    inverse_depth: LaneData,  # lane array, 1 component: D₀
    weight: LaneData,  # lane array, 1 component: weight of this frame at each pixel
    # lane array, 3 components: A, B and C. The values aᵀJa, aᵀ(J u + j) and uᵀJu + 2 jᵀu + J_tt,
    # times the weight, are added, with u = (u₀, v₀) − D₀ a.
    out: LaneData,
) -> Launch:
    """Restrict the motion tensor of a frame to its epipolar line, and add it to A, B and C."""
    grid.check(tensor, 6, "tensor")
    grid.check(flow, 2, "flow")
    grid.check(direction, 2, "direction")
    grid.check(inverse_depth, 1, "inverse_depth")
    grid.check(weight, 1, "weight")
    grid.check(out, 3, "out")
    return _add_depth_terms[grid.lanes].bind(tensor, flow, direction, inverse_depth, weight, out)


@operation
def depth_constraint(
    grid: LaneGrid,
    sums: LaneData,  # lane array, 3 components: A, B and C of `add_depth_terms`
    out: LaneData,  # lane array, 3 components: (p, 0, c) = (√A, 0, B/√A). The zero is not written.
) -> Launch:
    """Write the constraint p D + c = 0 whose square is A D² + 2 B D up to a constant."""
    grid.check(sums, 3, "sums")
    grid.check(out, 3, "out")
    return _depth_constraint[grid.lanes].bind(sums, out)


@lane_kernel
def _add_depth_terms(
    tensor: LaneArray(3),  # (6, H+2, S+2)
    flow: LaneArray(3),  # (2, H+2, S+2)
    direction: LaneArray(3),  # (2, H+2, S+2)
    inverse_depth: LaneArray(3),  # (1, H+2, S+2)
    weight: LaneArray(3),  # (1, H+2, S+2)
    out: LaneArray(3),  # (3, H+2, S+2), in place
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        a, b = direction[0, y, s], direction[1, y, s]
        d, frame_weight = inverse_depth[0, y, s], weight[0, y, s]
        u, v = flow[0, y, s] - d * a, flow[1, y, s] - d * b
        j11, j12, j22 = tensor[0, y, s], tensor[1, y, s], tensor[2, y, s]
        j1, j2 = tensor[3, y, s], tensor[4, y, s]
        along_u, along_v = j11 * u + j12 * v, j12 * u + j22 * v
        square = (j11 * a + 2.0 * j12 * b) * a + j22 * b * b
        product = (along_u + j1) * a + (along_v + j2) * b
        constant = (along_u + 2.0 * j1) * u + (along_v + 2.0 * j2) * v + tensor[5, y, s]
        out[0, y, s] = out[0, y, s] + frame_weight * square
        out[1, y, s] = out[1, y, s] + frame_weight * product
        out[2, y, s] = out[2, y, s] + frame_weight * constant


@lane_kernel
def _depth_constraint(
    sums: LaneArray(3),  # (3, H+2, S+2)
    out: LaneArray(3),  # (3, H+2, S+2)
):
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        square = ti.max(sums[0, y, s], 0.0)
        out[0, y, s] = ti.sqrt(square)
        out[2, y, s] = sums[1, y, s] / ti.sqrt(ti.max(square, MIN_DIVISOR))
