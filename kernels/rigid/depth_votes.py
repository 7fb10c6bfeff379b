"""Inverse depth of a frame, merged from several keyframes by votes that know visibility.

Each keyframe gives a candidate at a pixel of the frame: its depth, rendered in the frame. A
keyframe votes for a candidate that agrees with its own, and against a candidate that it looks
through: the candidate's point lies in front of the surface that the keyframe shows at the point's
position.

A keyframe has no vote on a candidate that it does not show: it is behind another surface there, or
outside its image. The weight of a vote is (d/σ)², multiplied by the similarity of the grey levels
of the keyframe and of the frame. Of the candidates with more votes for them than against them, the
nearest wins. The result is the weighted mean of the candidates that agree with it; in this mean,
weights decrease towards the border of a keyframe, so that no step shows where it ends.

References: the sum of support, occlusions and violations of free space is the confidence-based
fusion of Merrell et al. 2007 (doi:10.1109/ICCV.2007.4408984).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.rigid.depth_maps import MIN_Z

# All constants of this module were set by hand.
MIN_RELATIVE_DEVIATION = 1e-3  # share of the inverse depth: smaller deviations count as this value
MIN_LIKENESS = 0.05  # least factor of a vote whose grey levels differ
MIN_BORDER_SHARE = 0.05  # least factor of a weight in means, at the border of a keyframe


def merge_depths(
    # inverse_depths, deviations: (N, H, W) float32, the candidates of N keyframes in the frame; 0
    # where a keyframe has none. Of candidates with equal votes, the first is used.
    inverse_depths: np.ndarray,
    deviations: np.ndarray,
    frame: np.ndarray,  # (H, W) float32: grey levels
    # key_depths, key_deviations, key_frames: (N, H, W) float32, inverse depth, deviation and grey
    # levels of the keyframes themselves
    key_depths: np.ndarray,
    key_deviations: np.ndarray,
    key_frames: np.ndarray,
    motions: np.ndarray,  # (N, 3, 4) float32: R and t from the frame to each keyframe
    # out, out_deviation: (H, W) float32, means of the candidates that agree; 0 where there is no
    # depth. The deviation is the mean of their deviations: it does not shrink, since keyframes
    # share images.
    out: np.ndarray,
    out_deviation: np.ndarray,
    *,
    center: tuple[float, float],  # principal point of all views, px
    focal: float,  # focal length of all views, px
    # largest relative difference, as a share of the larger value, for two depths to agree
    max_difference: float,
    grey_decay: float,  # grey levels: a difference that reduces a vote to 1/e
    border: float,  # px: width of the border of a keyframe in which its weight in means grows
) -> None:
    """Merge the inverse depth of several keyframes, pixel by pixel.

    Raises TypeError, ValueError if an array is not of these types and sizes.

    Notes
    -----
    Values must be finite: with fast math, comparisons with NaN are unreliable.
    """
    shape = np.shape(inverse_depths)
    if len(shape) != 3:
        raise ValueError(f"inverse_depths is {shape}: expected (N, H, W)")
    for name, array in (
        ("inverse_depths", inverse_depths),
        ("deviations", deviations),
        ("key_depths", key_depths),
        ("key_deviations", key_deviations),
        ("key_frames", key_frames),
    ):
        check_array(array, shape, name, aligned=False)
    for name, array in (("frame", frame), ("out", out), ("out_deviation", out_deviation)):
        check_array(array, shape[1:], name, aligned=False)
    check_array(motions, (shape[0], 3, 4), "motions", aligned=False)
    weights, shares, votes = (np.empty(shape, np.float32) for _ in range(3))
    view = motions, float(center[0]), float(center[1]), float(focal)
    _weigh_votes(
        inverse_depths, deviations, frame, key_frames, *view, float(grey_decay), float(border),
        weights, shares,
    )  # fmt: skip
    _count_votes(
        inverse_depths, weights, key_depths, key_deviations, *view, float(max_difference), votes
    )
    _merge_depths(
        inverse_depths,
        deviations,
        weights,
        shares,
        votes,
        float(max_difference),
        out,
        out_deviation,
    )


@Kernel
def _weigh_votes(
    inverse_depths: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    deviations: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    frame: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    key_frames: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    motions: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, 3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    grey_decay: ti.f32,
    border: ti.f32,
    weights: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W): of votes
    shares: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W): factors of the weights in means
):
    height, width = frame.shape[0], frame.shape[1]
    for n, y, x in ti.ndrange(inverse_depths.shape[0], height, width):
        depth, weight, share = inverse_depths[n, y, x], 0.0, 0.0
        if depth > 0.0:
            weight = _precision(depth, deviations[n, y, x])
            ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
            position = _position(motions, n, ray, depth, cx, cy, focal)
            column = ti.min(ti.max(position[0], 0.0), width - 1.0)
            row = ti.min(ti.max(position[1], 0.0), height - 1.0)
            grey = _interpolate(key_frames, n, row, column)
            weight *= ti.max(ti.exp(0.0 - ti.abs(grey - frame[y, x]) / grey_decay), MIN_LIKENESS)
            distance = ti.min(row, column, height - 1.0 - row, width - 1.0 - column)
            share = ti.min(ti.max(distance / border, MIN_BORDER_SHARE), 1.0)
        weights[n, y, x] = weight
        shares[n, y, x] = share


@Kernel
def _count_votes(
    inverse_depths: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    weights: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    key_depths: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    key_deviations: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    motions: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, 3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    max_difference: ti.f32,
    votes: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
):
    """Sum the votes of agreeing keyframes, less the votes of keyframes with free space there."""
    for n, y, x in ti.ndrange(inverse_depths.shape[0], votes.shape[1], votes.shape[2]):
        candidate, total = inverse_depths[n, y, x], 0.0
        if candidate > 0.0:
            ray = ti.Vector([(x - cx) / focal, (y - cy) / focal, 1.0])
            for j in range(inverse_depths.shape[0]):
                other, weight = inverse_depths[j, y, x], weights[j, y, x]
                if other > 0.0 and _agree(candidate, other, max_difference):
                    total += weight
                else:
                    free_space = _free_space(
                        key_depths, key_deviations, motions, j, ray, candidate, cx, cy, focal,
                        max_difference,
                    )  # fmt: skip
                    if free_space > 0.0 and other > 0.0 and other < candidate:
                        free_space = ti.min(weight, free_space)
                    total -= free_space
        votes[n, y, x] = total


@Kernel
def _merge_depths(
    inverse_depths: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    deviations: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    weights: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    shares: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    votes: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (N, H, W)
    max_difference: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out_deviation: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        # The nearest candidate with a positive sum wins; without one, the largest sum.
        best, max_votes, surface = -1, 0.0, 0.0
        for i in range(inverse_depths.shape[0]):
            candidate, total = inverse_depths[i, y, x], votes[i, y, x]
            if candidate > 0.0:
                is_other = best < 0 or not _agree(candidate, surface, max_difference)
                is_better = total > max_votes
                if is_other and total > 0.0 and max_votes > 0.0:
                    is_better = candidate > surface
                if best < 0 or is_better:
                    best, max_votes, surface = i, total, candidate
        support, sum_depth, sum_deviation = 0.0, 0.0, 0.0
        for j in range(inverse_depths.shape[0]):
            other, weight = inverse_depths[j, y, x], weights[j, y, x] * shares[j, y, x]
            if best >= 0 and other > 0.0 and _agree(surface, other, max_difference):
                support += weight
                sum_depth += weight * other
                sum_deviation += weight * deviations[j, y, x]
        if best >= 0:
            sum_depth /= support
            sum_deviation /= support
        out[y, x] = sum_depth
        out_deviation[y, x] = sum_deviation


@ti.func
def _agree(depth, other, max_difference):
    return ti.abs(depth - other) < max_difference * ti.max(depth, other)


@ti.func
def _precision(depth, deviation):
    """Return (d/σ)²."""
    ratio = depth / ti.max(deviation, MIN_RELATIVE_DEVIATION * depth)
    return ratio * ratio


@ti.func
def _free_space(
    key_depths: ti.template(), key_deviations: ti.template(), motions: ti.template(), n, ray, depth,
    cx, cy, focal, max_difference,
):  # fmt: skip
    """Return the weight with which a keyframe looks through a point of the frame; else 0."""
    height, width = key_depths.shape[1], key_depths.shape[2]
    position = _position(motions, n, ray, depth, cx, cy, focal)
    column = ti.cast(ti.floor(position[0]), ti.i32)
    row = ti.cast(ti.floor(position[1]), ti.i32)
    weight = 0.0
    is_inside = position[0] > -0.5 and position[0] < width - 0.5
    if is_inside and position[1] > -0.5 and position[1] < height - 0.5:
        # the nearest of the four pixels around
        surface, spread = 0.0, 0.0
        for j, i in ti.static(ti.ndrange(2, 2)):
            down = ti.min(ti.max(row + j, 0), height - 1)
            right = ti.min(ti.max(column + i, 0), width - 1)
            if key_depths[n, down, right] > surface:
                surface = key_depths[n, down, right]
                spread = key_deviations[n, down, right]
        if surface > 0.0 and surface < (1.0 - max_difference) * position[2]:
            weight = _precision(surface, spread)
    return weight


@ti.func
def _position(motions: ti.template(), n, ray, depth, cx, cy, focal):
    """Return x and y, px, and the inverse depth of a point in keyframe n; 0 behind it."""
    point = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        rotated = motions[n, k, 0] * ray[0] + motions[n, k, 1] * ray[1] + motions[n, k, 2] * ray[2]
        point[k] = rotated + depth * motions[n, k, 3]
    position = ti.Vector([-1e6, -1e6, 0.0])  # outside
    if point[2] > MIN_Z:
        position = ti.Vector(
            [point[0] / point[2] * focal + cx, point[1] / point[2] * focal + cy, depth / point[2]]
        )
    return position


@ti.func
def _interpolate(images: ti.template(), n, row, column):
    """Return the value of image n at a position inside."""
    top = ti.min(ti.cast(ti.floor(row), ti.i32), images.shape[1] - 1)
    left = ti.min(ti.cast(ti.floor(column), ti.i32), images.shape[2] - 1)
    bottom, right = ti.min(top + 1, images.shape[1] - 1), ti.min(left + 1, images.shape[2] - 1)
    down, across = row - top, column - left
    upper = (1.0 - across) * images[n, top, left] + across * images[n, top, right]
    lower = (1.0 - across) * images[n, bottom, left] + across * images[n, bottom, right]
    return (1.0 - down) * upper + down * lower
