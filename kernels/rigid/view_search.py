"""PatchMatch with several frames: the plane of best match between a keyframe and other frames.

The cost of a hypothesis is the mean of its costs in a fixed number of frames, those of least cost:
in the others the surface may be hidden or outside the image. A plane may represent a square of
pixels, a cell of a grid; then only the window around one pixel of the cell is compared. All else is
as in `tisfm.kernels.rigid.patch_match`.

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
    STEEPEST,
    apart_from,
    cost_in,
    drawn,
    drawn_near,
    neighbour,
)
from tisfm.kernels.rigid.windows import (
    MOST_PIXELS,
    NOWHERE,
    UNSEEN,
    mixed,
    packed,
    window,
    with_margin,
)

MOST_BEST = 4  # most frames in the mean of a cost
# Cost of a frame that does not show a hypothesis, if other frames do: about that of a just reliable
# match. So pixels near the border are matched in the frames that show them.
ABSENT = 0.25

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
        best: int,  # number of frames in the mean of a cost; 1 to `MOST_BEST`, and at most M
        stride: int,  # side of a cell, px; cells that extend beyond the border are left out
        center: tuple[float, float],  # principal point, px
        focal: float,  # px
        noise: float,  # standard deviation of the noise of a frame, levels; above 0
        seen: float,  # least variance of a window that is compared, over the variance of the noise
        # least, largest: bounds of D, px
        least: float,
        largest: float,
    ) -> None:
        check_array(key, key.shape, "key", aligned=False)
        for number, levels in enumerate(others):
            check_array(levels, key.shape, f"others[{number}]", aligned=False)
        self.count = len(others)  # M
        if key.size > MOST_PIXELS:
            raise ValueError(f"key has {key.size} pixels: expected {MOST_PIXELS} at most")
        if np.shape(motions) != (self.count, 3, 4):
            raise ValueError(f"motions is {np.shape(motions)}: expected ({self.count}, 3, 4)")
        if not 1 <= best <= min(MOST_BEST, self.count):
            raise ValueError(f"best is {best}: expected 1 to {min(MOST_BEST, self.count)}")
        if not 1 <= stride <= min(key.shape):
            raise ValueError(f"stride is {stride}: expected 1 to {min(key.shape)} px")
        if not noise > 0:
            raise ValueError(f"noise is {noise}: expected a positive value, in grey levels")
        if not least < largest:
            raise ValueError(f"D is sought from {least} to {largest}: expected from < to")
        # h and w, the numbers of rows and columns of cells
        self.shape = (key.shape[0] // stride, key.shape[1] // stride)
        height, width = key.shape
        self._images = (
            with_margin(key),
            np.concatenate([packed(levels) for levels in others]),
            np.ascontiguousarray(np.concatenate(list(motions)), np.float32),
        )
        self._view = (height, width, stride, *map(float, center), float(focal), float(noise) ** 2)
        self._best, self._seen = best, float(seen)
        self._bounds = float(least), float(largest)

    def score(self, planes: np.ndarray) -> None:
        """Compute the cost of the planes (h, w, 4) float32, in place."""
        self._check(planes)
        _score(*self._images, *self._view, self.count, self._best, self._seen, planes)

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
                *self._images,
                *self._view,
                self.count,
                self._best,
                *self._bounds,
                color,
                draws,
                spread,
                tilt,
                2 * seed + color,
                planes,
            )

    def costs(self, planes: np.ndarray, out: np.ndarray) -> None:
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
    best: ti.i32,
    seen: ti.f32,
    planes: ti.types.ndarray(dtype=_Plane, ndim=2),  # (h, w), in place
):
    for row, column in ti.ndrange(planes.shape[0], planes.shape[1]):
        plane = planes[row, column]
        y, x = stride * row, stride * column
        weight0, weight1, weighted0, weighted1, variance, centre = window(key, y, x)
        plane[3] = UNSEEN
        if variance > seen * noise:
            plane[3] = _cost_of_best(
                others, count, best, height, width, motions, cx, cy, focal, noise,
                weight0, weight1, weighted0, weighted1, variance, centre, y, x,
                _at_first(plane, stride),
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
        plane = _at_first(planes[row, column], stride)
        y, x = stride * row, stride * column
        weight0, weight1, weighted0, weighted1, variance, centre = window(key, y, x)
        for j in range(out.shape[0]):
            out[j, row, column] = cost_in(
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
    best_frames: ti.i32,
    least: ti.f32,
    largest: ti.f32,
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
            if best[3] < UNSEEN:
                y, x = stride * row, stride * column
                weight0, weight1, weighted0, weighted1, variance, centre = window(key, y, x)
                random = ti.cast(4 * (row * columns + column), ti.u32) * ti.cast(draws + 1, ti.u32)
                random = mixed(random + mixed(ti.cast(seed, ti.u32)))
                span = 1.0
                for n in range(5 + draws):  # 4 neighbours, 1 draw from the whole range, near draws
                    plane = best
                    if n < 4:
                        plane = neighbour(planes, row, column, n, best)
                    elif n == 4:
                        plane = drawn(random, least, largest, stride * (STEEPEST / focal))
                    else:
                        plane = drawn_near(best, random, span * spread, span * tilt)
                        span *= 0.5
                    if n >= 4:
                        random += ti.u32(4)
                    if plane[0] > least and plane[0] < largest and apart_from(plane, best):
                        plane[3] = _cost_of_best(
                            others, count, best_frames, height, width, motions, cx, cy, focal,
                            noise, weight0, weight1, weighted0, weighted1, variance, centre, y, x,
                            _at_first(plane, stride),
                        )  # fmt: skip
                        if plane[3] < best[3]:
                            best = plane
                planes[row, column] = best


@ti.func
def _at_first(plane, stride):
    """Return the plane of a cell at its upper left pixel, with slopes per px."""
    first, side = plane, ti.cast(stride, ti.f32)
    first[1] = plane[1] / side
    first[2] = plane[2] / side
    first[0] = plane[0] - 0.5 * (side - 1.0) * (first[1] + first[2])
    return first


@ti.func
def _cost_of_best(
    others: ti.template(),
    count,
    best,
    height,
    width,
    motions: ti.template(),
    cx,
    cy,
    focal,
    noise,
    weight0,
    weight1,
    weighted0,
    weighted1,
    variance,
    centre,
    y,
    x,
    plane,
):
    """Return the mean of 1 − c over the frames where it is least."""
    lowest = ti.Vector([UNSEEN] * MOST_BEST)  # in increasing order
    showing = 0
    for j in range(count):
        cost = cost_in(
            others, j, height, width, motions, cx, cy, focal, noise,
            weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
        )  # fmt: skip
        if cost == NOWHERE:
            cost = UNSEEN
        else:
            showing += 1
        for n in ti.static(range(MOST_BEST)):
            lower = ti.min(lowest[n], cost)
            cost = ti.max(lowest[n], cost)
            lowest[n] = lower
    # If fewer than `best` frames show the hypothesis, ABSENT replaces the missing costs.
    total = 0.0
    for n in ti.static(range(MOST_BEST)):
        cost = ti.select(n < showing, lowest[n], ti.select(showing > 0, ABSENT, NOWHERE))
        total += ti.select(n < best, cost, 0.0)
    return total / ti.cast(best, ti.f32)
