"""Inverse depth maps: rendered in another view, merged by votes, aligned with edges of the frame.

`render_depth`: each pixel is projected into the other view and splatted to the four pixels around;
the nearest surface wins. This determines the surface of a pixel, on the grid of pixels. The exact
value is then looked up: the pixel is projected back to the first view along its ray, and the
inverse depth there is projected into the other view again. If more than half of the weight there
belongs to another surface, the pixel lies beside an edge. Then the nearest surface among the points
that round to the pixel itself is looked up instead.

`merge_depths`: each source has a vote for every pixel, with the weight (d/σ)². The depth that most
votes agree with determines the surface of the pixel. The result is the weighted mean of the votes
that agree.

`align_depth_edges`: each pixel in a window votes for the surface that it shows. The vote has more
weight if the pixel is nearer and if its grey level is more similar.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

# All constants of this module were set by hand.
# largest relative difference of inverse depth between pixels of one surface
MAX_SURFACE_DIFFERENCE = 0.05
PROJECTIONS = 2  # projections back and forth of each pixel
# share of the weights of the four pixels around, from which the nearest surface there is used
MIN_NEAREST_SHARE = 0.5
MIN_CENTRAL_SHARE = 1e-3  # the same share, for the surface of the points that round to the pixel
MIN_Z = 1e-12  # bound of Z, which is a divisor


def render_depth(
    inverse_depth: np.ndarray,  # (H, W) float32: 1/Z; 0 where unknown
    deviation: np.ndarray,  # (H, W) float32: its standard deviation; finite
    motion: np.ndarray,  # (3, 4) array: R and t from the first view's axes to the other's
    # out, out_deviation: (H, W) float32, inverse depth and deviation in the other view; 0 where no
    # pixel arrives
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    center: tuple[float, float],  # principal point of both views, px
    focal: float,  # focal length of both views, px
) -> None:
    """Render the inverse depth of a view, and its deviation, in another view.

    Raises TypeError, ValueError if an array is not of these types and sizes.

    Notes
    -----
    Values must be finite: with fast math, comparisons with NaN are unreliable.
    """
    shape = inverse_depth.shape
    for name, array in (
        ("inverse_depth", inverse_depth),
        ("deviation", deviation),
        ("out", out),
        ("out_deviation", out_deviation),
    ):
        check_array(array, shape, name, aligned=False)
    if np.shape(motion) != (3, 4):
        raise ValueError(f"motion is {np.shape(motion)}: expected (3, 4)")
    motion = np.ascontiguousarray(motion, np.float32)
    nearest, central = (np.zeros(shape, np.float32) for _ in range(2))
    view = motion, float(center[0]), float(center[1]), float(focal)
    _nearest_surfaces(inverse_depth, *view, nearest, central)
    _look_up(inverse_depth, deviation, nearest, central, *view, out, out_deviation)


@Kernel
def _nearest_surfaces(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    nearest: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    central: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    """Keep the largest inverse depth that arrives at each pixel, which is independent of order."""
    height, width = inverse_depth.shape[0], inverse_depth.shape[1]
    for y, x in ti.ndrange(height, width):
        depth = inverse_depth[y, x]
        if depth > 0.0:
            ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
            point = _move(motion, ray, depth)
            if point[2] > MIN_Z:
                target_x = point[0] / point[2] * focal + cx
                target_y = point[1] / point[2] * focal + cy
                is_inside = target_x > -1.0 and target_x < width
                if is_inside and target_y > -1.0 and target_y < height:
                    target_depth = depth / point[2]
                    column = ti.cast(ti.floor(target_x), ti.i32)
                    row = ti.cast(ti.floor(target_y), ti.i32)
                    for j, i in ti.static(ti.ndrange(2, 2)):
                        _keep_largest(nearest, row + j, column + i, target_depth)
                    column = ti.cast(ti.floor(target_x + 0.5), ti.i32)
                    row = ti.cast(ti.floor(target_y + 0.5), ti.i32)
                    _keep_largest(central, row, column, target_depth)


@ti.func
def _keep_largest(image: ti.template(), row, column, value):
    if row >= 0 and row < image.shape[0] and column >= 0 and column < image.shape[1]:
        ti.atomic_max(image[row, column], value)


@Kernel
def _look_up(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    nearest: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    central: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(inverse_depth.shape[0], inverse_depth.shape[1]):
        ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
        depth_and_deviation = _look_along_ray(
            inverse_depth, deviation, motion, cx, cy, focal, ray, nearest[y, x], MIN_NEAREST_SHARE
        )
        if depth_and_deviation[0] <= 0.0:
            depth_and_deviation = _look_along_ray(
                inverse_depth, deviation, motion, cx, cy, focal, ray, central[y, x],
                MIN_CENTRAL_SHARE,
            )  # fmt: skip
        out[y, x] = depth_and_deviation[0]
        out_deviation[y, x] = depth_and_deviation[1]


@ti.func
def _look_along_ray(
    inverse_depth: ti.template(), deviation: ti.template(), motion: ti.template(), cx, cy, focal,
    ray, value, min_share,
):  # fmt: skip
    """Return inverse depth and deviation along a ray, near inverse depth `value`; 0 if none."""
    spread = 0.0
    for _ in ti.static(range(PROJECTIONS)):
        source = _move_back(motion, ray, value)
        new_value, new_spread = 0.0, 0.0
        if value > 0.0 and source[2] > MIN_Z:
            column = source[0] / source[2] * focal + cx
            row = source[1] / source[2] * focal + cy
            sums = _sum_surface(inverse_depth, deviation, row, column, value / source[2])
            if sums[0] > min_share:
                depth = sums[1] / sums[0]
                source_ray = ti.Vector([(column - cx) / focal, (row - cy) / focal, 1.0])
                point = _move(motion, source_ray, depth)
                if point[2] > MIN_Z:
                    new_value = depth / point[2]
                    rotated_z = point[2] - depth * motion[2, 3]
                    scale_change = rotated_z / (point[2] * point[2])
                    new_spread = sums[2] / sums[0] * ti.max(scale_change, 0.0 - scale_change)
        value, spread = new_value, new_spread
    return ti.Vector([value, spread])


@ti.func
def _sum_surface(
    inverse_depth: ti.template(), deviation: ti.template(), row, column, surface_depth
):
    """Return Σw, Σw·d and Σw·σ of the pixels that show the surface, among the four around."""
    sums = ti.Vector([0.0, 0.0, 0.0])
    left, top = ti.cast(ti.floor(column), ti.i32), ti.cast(ti.floor(row), ti.i32)
    for j, i in ti.static(ti.ndrange(2, 2)):
        down, right = top + j, left + i
        is_inside = right >= 0 and right < inverse_depth.shape[1]
        if is_inside and down >= 0 and down < inverse_depth.shape[0]:
            depth = inverse_depth[down, right]
            difference = ti.max(depth - surface_depth, surface_depth - depth)
            if depth > 0.0 and difference < MAX_SURFACE_DIFFERENCE * surface_depth:
                dx, dy = column - right, row - down
                weight = (1.0 - ti.max(dx, 0.0 - dx)) * (1.0 - ti.max(dy, 0.0 - dy))
                sums = sums + weight * ti.Vector([1.0, depth, deviation[down, right]])
    return sums


@ti.func
def _move(motion: ti.template(), ray, depth):
    """Return R x̂ + d t: the moved point, multiplied by its inverse depth d before the motion."""
    point = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        rotated = motion[k, 0] * ray[0] + motion[k, 1] * ray[1] + motion[k, 2] * ray[2]
        point[k] = rotated + depth * motion[k, 3]
    return point


@ti.func
def _move_back(motion: ti.template(), ray, depth):
    """Return Rᵀ(x̂ − d t): `_move` for the inverse motion."""
    shifted = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        shifted[k] = ray[k] - depth * motion[k, 3]
    point = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        point[k] = motion[0, k] * shifted[0] + motion[1, k] * shifted[1] + motion[2, k] * shifted[2]
    return point


MIN_RELATIVE_DEVIATION = 1e-3  # share of the inverse depth: smaller deviations count as this value


def merge_depths(
    # (N, H, W) float32: 0 where a source has no depth. If two sources have equal votes, the first
    # is used.
    inverse_depths: np.ndarray,
    deviations: np.ndarray,  # (N, H, W) float32: their standard deviations; finite
    # out, out_deviation: (H, W) float32, means of the sources that agree, with the weights (d/σ)²;
    # 0 where there is no depth. The deviation is the mean of the deviations of the sources: it does
    # not shrink, since sources share images.
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    # largest relative difference, as a share of the larger value, for two sources to agree
    max_difference: float,
) -> None:
    """Merge the inverse depth of several sources, pixel by pixel.

    Raises TypeError, ValueError if an array is not of these types and sizes.

    Notes
    -----
    Values must be finite: with fast math, comparisons with NaN are unreliable.
    """
    shape = np.shape(inverse_depths)
    if len(shape) != 3:
        raise ValueError(f"inverse_depths is {shape}: expected (N, H, W)")
    check_array(inverse_depths, shape, "inverse_depths", aligned=False)
    check_array(deviations, shape, "deviations", aligned=False)
    check_array(out, shape[1:], "out", aligned=False)
    check_array(out_deviation, shape[1:], "out_deviation", aligned=False)
    _merge_depths(inverse_depths, deviations, float(max_difference), out, out_deviation)


@Kernel
def _merge_depths(
    inverse_depths: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    deviations: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    max_difference: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        max_votes, best_depth, best_deviation = 0.0, 0.0, 0.0
        for i in range(inverse_depths.shape[0]):
            candidate = inverse_depths[i, y, x]
            if candidate > 0.0:
                votes, sum_depth, sum_deviation = 0.0, 0.0, 0.0
                for j in range(inverse_depths.shape[0]):
                    other, spread = inverse_depths[j, y, x], deviations[j, y, x]
                    difference = ti.max(candidate - other, other - candidate)
                    if other > 0.0 and difference < max_difference * ti.max(candidate, other):
                        vote = other / ti.max(spread, MIN_RELATIVE_DEVIATION * other)
                        vote *= vote
                        votes += vote
                        sum_depth += vote * other
                        sum_deviation += vote * spread
                if votes > max_votes:
                    max_votes = votes
                    best_depth = sum_depth / votes
                    best_deviation = sum_deviation / votes
        out[y, x] = best_depth
        out_deviation[y, x] = best_deviation


VOTING_RADIUS = 3  # px: half side of the window whose pixels vote
DISTANCE_DECAY = 0.1  # 1/px²: a pixel at distance r px has the weight 1/(1 + 0.1 r²)


def align_depth_edges(
    # inverse_depth, deviation: (H, W) float32, positive; finite
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    # (H, W) float32: inverse depth that separates two surfaces nearby; 0 where there is only one
    # surface
    threshold: np.ndarray,
    frame: np.ndarray,  # (H, W) float32: grey levels
    # out, out_deviation: (H, W) float32: the same values; where most votes are for the other
    # surface, the weighted mean over the pixels of that surface
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    grey_decay: float,  # grey levels: a difference that reduces the weight of a pixel to 1/e
) -> None:
    """Move depth edges to edges of the frame.

    Raises TypeError, ValueError if an array is not of these types and sizes.
    """
    shape = inverse_depth.shape
    for name, array in (
        ("inverse_depth", inverse_depth),
        ("deviation", deviation),
        ("threshold", threshold),
        ("frame", frame),
        ("out", out),
        ("out_deviation", out_deviation),
    ):
        check_array(array, shape, name, aligned=False)
    _align_depth_edges(
        inverse_depth, deviation, threshold, frame, float(grey_decay), out, out_deviation
    )


@Kernel
def _align_depth_edges(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    threshold: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    frame: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    grey_decay: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    height, width = frame.shape[0], frame.shape[1]
    for y, x in ti.ndrange(height, width):
        depth, spread, pixel_threshold = inverse_depth[y, x], deviation[y, x], threshold[y, x]
        if pixel_threshold > 0.0:
            is_near, grey = depth > pixel_threshold, frame[y, x]
            votes, other_votes, sum_depth, sum_spread = 0.0, 0.0, 0.0, 0.0
            for row in range(ti.max(0, y - VOTING_RADIUS), ti.min(height, y + VOTING_RADIUS + 1)):
                for column in range(
                    ti.max(0, x - VOTING_RADIUS), ti.min(width, x + VOTING_RADIUS + 1)
                ):
                    difference = ti.max(frame[row, column] - grey, grey - frame[row, column])
                    square = ti.cast((row - y) * (row - y) + (column - x) * (column - x), ti.f32)
                    vote = ti.exp(0.0 - difference / grey_decay) / (1.0 + DISTANCE_DECAY * square)
                    if (inverse_depth[row, column] > pixel_threshold) == is_near:
                        votes += vote
                    else:
                        other_votes += vote
                        sum_depth += vote * inverse_depth[row, column]
                        sum_spread += vote * deviation[row, column]
            if other_votes > votes:
                depth, spread = sum_depth / other_votes, sum_spread / other_votes
        out[y, x] = depth
        out_deviation[y, x] = spread
