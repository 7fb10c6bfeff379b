"""PatchMatch with several frames: the plane of best match between a keyframe and other frames.

The cost of a hypothesis is the mean of its costs in a fixed number of frames, those where it is
least: in the other frames the surface may be hidden or outside the image. A plane may represent a
square of pixels, a cell of a grid. Then only the window around the upper left pixel of the cell is
compared. Everything else is as in `tisfm.kernels.rigid.patch_match`.

The state is an (h, w, 4) array: D at the centre of a cell, px, its change from cell to cell to the
east and to the south, and the cost.

References
----------
Galliani, Lasinger, Schindler, "Massively parallel multiview stereopsis by surface normal
diffusion", ICCV 2015, doi 10.1109/ICCV.2015.106, eq. 10 (the best of several frames).
"""

from collections.abc import Sequence

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.rigid.patch_match import (
    MAX_SLOPE,
    cheapest_neighbour,
    draw_plane,
    is_different,
    perturb_plane,
    plane_cost,
)
from tisfm.kernels.rigid.windows import (
    MAX_PIXELS,
    OUTSIDE_COST,
    UNTEXTURED,
    hash_of,
    load_window,
    pack_pixels,
    pad_border,
)

MAX_FRAMES = 4  # limit of the frames in the mean of a cost
# Cost of a frame that does not show a hypothesis, if other frames show it: about the cost of a
# match that is just reliable. So pixels near the border are matched in the frames that show them.
MISSING_FRAME_COST = 0.25

_Plane = ti.types.vector(4, ti.f32)


class ViewSearch:
    """A search for planes that map a keyframe to several other frames, on one level."""

    def __init__(
        self,
        key: np.ndarray,  # (H, W) float32: grey levels of the keyframe, in [0, 255]
        # sequence of (H, W) float32: grey levels of the M other frames
        others: Sequence[np.ndarray],
        motions: np.ndarray,  # (M, 3, 4) array: R and t from the keyframe to each other frame
        *,
        frame_count: int,  # frames in the mean of a cost; 1 to `MAX_FRAMES`, at most M
        stride: int,  # side of a cell, px; cells that extend beyond the border are left out
        center: tuple[float, float],  # principal point, px
        focal: float,  # px
        noise: float,  # standard deviation of the noise of a frame, levels; above 0
        min_variance: float,  # variance of a compared window divided by the variance of the noise
        # min_depth, max_depth: bounds of D, px
        min_depth: float,
        max_depth: float,
    ) -> None:
        check_array(key, key.shape, "key", aligned=False)
        for number, grey in enumerate(others):
            check_array(grey, key.shape, f"others[{number}]", aligned=False)
        self.count = len(others)  # M
        if key.size > MAX_PIXELS:
            raise ValueError(f"key has {key.size} pixels: expected {MAX_PIXELS} at most")
        if np.shape(motions) != (self.count, 3, 4):
            raise ValueError(f"motions is {np.shape(motions)}: expected ({self.count}, 3, 4)")
        if not 1 <= frame_count <= min(MAX_FRAMES, self.count):
            raise ValueError(
                f"frame_count is {frame_count}: expected 1 to {min(MAX_FRAMES, self.count)}"
            )
        if not 1 <= stride <= min(key.shape):
            raise ValueError(f"stride is {stride}: expected 1 to {min(key.shape)} px")
        if not noise > 0:
            raise ValueError(f"noise is {noise}: expected a positive value, in grey levels")
        if not min_depth < max_depth:
            raise ValueError(f"D is searched from {min_depth} to {max_depth}: expected from < to")
        # h and w, the numbers of rows and columns of cells
        self.shape = (key.shape[0] // stride, key.shape[1] // stride)
        height, width = key.shape
        self._images = (
            pad_border(key),
            np.concatenate([pack_pixels(grey) for grey in others]),
            np.ascontiguousarray(np.concatenate(list(motions)), np.float32),
        )
        self._view = (height, width, stride, *map(float, center), float(focal), float(noise) ** 2)
        self._frame_count, self._min_variance = frame_count, float(min_variance)
        self._bounds = float(min_depth), float(max_depth)

    def score(self, planes: np.ndarray) -> None:
        """Compute the cost of the planes (h, w, 4) float32, in place."""
        self._check(planes)
        _score(
            *self._images, *self._view, self.count, self._frame_count, self._min_variance, planes
        )

    def improve(
        self,
        planes: np.ndarray,  # (h, w, 4) float32: state with costs, from `score`
        *,
        draws: int,  # random planes near the present plane
        # spread, tilt: range of the first of these draws in D, px, and in its changes from cell to
        # cell
        spread: float,
        tilt: float,
        seed: int,  # seed of the random numbers
    ) -> None:
        """Replace planes by better planes, in place, as `PlaneSearch.improve`."""
        self._check(planes)
        for color in range(2):
            _improve(
                *self._images, *self._view, self.count, self._frame_count, *self._bounds, color,
                draws, spread, tilt, 2 * seed + color, planes,
            )  # fmt: skip

    def write_costs(self, planes: np.ndarray, out: np.ndarray) -> None:
        """Write the costs of planes (h, w, 4) float32 in every frame, (M, h, w) float32."""
        self._check(planes)
        check_array(out, (self.count, *self.shape), "out", aligned=False)
        _costs(*self._images, *self._view, planes, out)

    def _check(self, planes: np.ndarray) -> None:
        check_array(planes, (*self.shape, 4), "planes", aligned=False)


@Kernel
def _score(
    key: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    others: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (M·H·W,)
    motions: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3 M, 4)
    height: ti.i32,
    width: ti.i32,
    stride: ti.i32,
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    noise: ti.f32,
    count: ti.i32,
    frame_count: ti.i32,
    min_variance: ti.f32,
    planes: ti.types.ndarray(dtype=_Plane, ndim=2),  # (h, w), in place
):
    for row, column in ti.ndrange(planes.shape[0], planes.shape[1]):
        plane = planes[row, column]
        y, x = stride * row, stride * column
        weight0, weight1, weighted0, weighted1, variance, centre = load_window(key, y, x)
        plane[3] = UNTEXTURED
        if variance > min_variance * noise:
            plane[3] = _mean_of_least_costs(
                others, count, frame_count, height, width, motions, cx, cy, focal, noise,
                weight0, weight1, weighted0, weighted1, variance, centre, y, x,
                _at_upper_left(plane, stride),
            )  # fmt: skip
        planes[row, column] = plane


@Kernel
def _costs(
    key: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    others: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (M·H·W,)
    motions: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3 M, 4)
    height: ti.i32,
    width: ti.i32,
    stride: ti.i32,
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    noise: ti.f32,
    planes: ti.types.ndarray(dtype=_Plane, ndim=2),  # (h, w)
    out: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (M, h, w)
):
    for row, column in ti.ndrange(planes.shape[0], planes.shape[1]):
        plane = _at_upper_left(planes[row, column], stride)
        y, x = stride * row, stride * column
        weight0, weight1, weighted0, weighted1, variance, centre = load_window(key, y, x)
        for j in range(out.shape[0]):
            out[j, row, column] = plane_cost(
                others, j, height, width, motions, cx, cy, focal, noise,
                weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
            )  # fmt: skip


@Kernel
def _improve(
    key: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    others: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (M·H·W,)
    motions: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3 M, 4)
    height: ti.i32,
    width: ti.i32,
    stride: ti.i32,
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    noise: ti.f32,
    count: ti.i32,
    frame_count: ti.i32,
    min_depth: ti.f32,
    max_depth: ti.f32,
    color: ti.i32,
    draws: ti.i32,
    spread: ti.f32,
    tilt: ti.f32,
    seed: ti.i32,
    planes: ti.types.ndarray(dtype=_Plane, ndim=2),  # (h, w), in place
):
    columns = planes.shape[1]
    for row, pair in ti.ndrange(planes.shape[0], (columns + 1) // 2):
        column = 2 * pair + (row + color) % 2
        if column < columns:
            best = planes[row, column]
            if best[3] < UNTEXTURED:
                y, x = stride * row, stride * column
                weight0, weight1, weighted0, weighted1, variance, centre = load_window(key, y, x)
                random = ti.cast(4 * (row * columns + column), ti.u32) * ti.cast(draws + 1, ti.u32)
                random = hash_of(random + hash_of(ti.cast(seed, ti.u32)))
                span = 1.0
                for n in range(5 + draws):  # 4 neighbours, 1 draw from the whole range, near draws
                    plane = best
                    if n < 4:
                        plane = cheapest_neighbour(planes, row, column, n, best)
                    elif n == 4:
                        plane = draw_plane(
                            random, min_depth, max_depth, stride * (MAX_SLOPE / focal)
                        )
                    else:
                        plane = perturb_plane(best, random, span * spread, span * tilt)
                        span *= 0.5
                    if n >= 4:
                        random += ti.u32(4)
                    if plane[0] > min_depth and plane[0] < max_depth and is_different(plane, best):
                        plane[3] = _mean_of_least_costs(
                            others, count, frame_count, height, width, motions, cx, cy, focal,
                            noise, weight0, weight1, weighted0, weighted1, variance, centre, y, x,
                            _at_upper_left(plane, stride),
                        )  # fmt: skip
                        if plane[3] < best[3]:
                            best = plane
                planes[row, column] = best


@ti.func
def _at_upper_left(plane, stride):
    """Return the plane of a cell at its upper left pixel, with slopes per px."""
    result, side = plane, ti.cast(stride, ti.f32)
    result[1] = plane[1] / side
    result[2] = plane[2] / side
    result[0] = plane[0] - 0.5 * (side - 1.0) * (result[1] + result[2])
    return result


@ti.func
def _mean_of_least_costs(
    others: ti.template(), count, frame_count, height, width, motions: ti.template(), cx, cy, focal,
    noise, weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
):  # fmt: skip
    """Return the mean of 1 − c over the frames where it is least."""
    least_costs = ti.Vector([UNTEXTURED] * MAX_FRAMES)  # in increasing order
    visible_frames = 0
    for j in range(count):
        cost = plane_cost(
            others, j, height, width, motions, cx, cy, focal, noise,
            weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
        )  # fmt: skip
        if cost == OUTSIDE_COST:
            cost = UNTEXTURED
        else:
            visible_frames += 1
        for n in ti.static(range(MAX_FRAMES)):
            smaller = ti.min(least_costs[n], cost)
            cost = ti.max(least_costs[n], cost)
            least_costs[n] = smaller
    # If fewer frames show the hypothesis, MISSING_FRAME_COST replaces the missing costs.
    total = 0.0
    for n in ti.static(range(MAX_FRAMES)):
        cost = ti.select(
            n < visible_frames,
            least_costs[n],
            ti.select(visible_frames > 0, MISSING_FRAME_COST, OUTSIDE_COST),
        )
        total += ti.select(n < frame_count, cost, 0.0)
    return total / ti.cast(frame_count, ti.f32)
