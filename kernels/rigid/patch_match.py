"""PatchMatch for planes: the plane at every pixel with which frame 1 matches frame 0 best.

A hypothesis is an inverse depth and its slopes. The surface is a plane within the window, so its
inverse depth is linear in the image. The cost is that of `tisfm.kernels.rigid.windows` for the
window in frame 0 and its projection into frame 1. Good hypotheses propagate from pixel to pixel as
planes, and random hypotheses are drawn.

The state is an (H, W, 4) array: D in px/frame, ∂D/∂x and ∂D/∂y, and the cost, `UNSEEN` where the
window shows only noise.

References
----------
Bleyer, Rhemann, Rother, "PatchMatch stereo: stereo matching with slanted support windows", BMVC
2011, doi 10.5244/C.25.14. Galliani, Lasinger, Schindler, "Massively parallel multiview stereopsis
by surface normal diffusion", ICCV 2015, doi 10.1109/ICCV.2015.106 (red and black). Xu and Tao,
"Multi-scale geometric consistency guided multi-view stereo", CVPR 2019,
doi 10.1109/CVPR.2019.00563 (the cheapest neighbours of each direction).
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model.constants import NEAREST
from tisfm.kernels.rigid.windows import (
    ACROSS,
    DOWN,
    MOST_PIXELS,
    NOWHERE,
    RADIUS,
    UNSEEN,
    correlation_cost,
    mixed,
    packed,
    sampled,
    unit,
    window,
    with_margin,
)

# px: distances of neighbours; odd, so that all neighbours of red pixels are black.
DISTANCES = (1, 3, 5, 7, 13, 21)
NONE = -1e30  # value of D that means no hypothesis
ALIKE = 0.03  # px: hypotheses that differ by less within the window count as equal
STEEPEST = 3.0  # limit of random slopes, in D per focal length: a surface at 72° to the image

_Plane = ti.types.vector(4, ti.f32)


class PlaneSearch:
    """A search for planes that map frame 0 to frame 1, on one level."""

    def __init__(
        self,
        # levels0, levels1: (H, W) float32, grey levels of both frames, in [0, 255]
        levels0: np.ndarray,
        levels1: np.ndarray,
        motion: np.ndarray,  # (3, 4) array: R and t
        *,
        center: tuple[float, float],  # principal point, px
        focal: float,  # px
        noise: float,  # standard deviation of the noise of a frame, levels; above 0
        seen: float,  # least variance of a window that is compared, over the variance of the noise
        # least, largest: bounds of D, px/frame
        least: float,
        largest: float,
    ) -> None:
        self._shape = levels0.shape
        for name, levels in (("levels0", levels0), ("levels1", levels1)):
            check_array(levels, self._shape, name, aligned=False)
        if levels0.size > MOST_PIXELS:
            raise ValueError(f"levels0 has {levels0.size} pixels: expected {MOST_PIXELS} at most")
        if np.shape(motion) != (3, 4):
            raise ValueError(f"motion is {np.shape(motion)}: expected (3, 4)")
        if not noise > 0:
            raise ValueError(f"noise is {noise}: expected a positive value, in grey levels")
        if not least < largest:
            raise ValueError(f"D is sought from {least} to {largest}: expected from < to")
        self._images = with_margin(levels0), packed(levels1)
        self._motion = np.ascontiguousarray(motion, np.float32)
        self._view = *map(float, center), float(focal)
        self._noise = float(noise) ** 2
        self._seen, self._bounds = float(seen), (float(least), float(largest))

    def score(self, planes: np.ndarray) -> None:
        """Compute the cost of the planes (H, W, 4) float32, in place."""
        self._check(planes)
        _score(*self._images, self._motion, *self._view, self._noise, self._seen, planes)

    def improve(
        self,
        planes: np.ndarray,  # (H, W, 4) float32: state with costs, from `score`
        *,
        draws: int,  # random planes near the present plane
        # spread, tilt: range of the first of these draws in D, px/frame, and in the slopes of D
        spread: float,
        tilt: float,
        seed: int,  # seed of the random numbers
    ) -> None:
        """Replace planes by better planes, in place: first at red, then at black pixels.

        Each pixel compares its plane with those of four neighbours, which in each direction is the
        neighbour of least cost; with a random plane from the whole range; and with `draws` random
        planes near its own, each from half the range of the previous draw. No cost rises.
        """
        self._check(planes)
        for color in range(2):
            _improve(
                *self._images,
                self._motion,
                *self._view,
                self._noise,
                *self._bounds,
                color,
                draws,
                spread,
                tilt,
                2 * seed + color,
                planes,
            )

    def _check(self, planes: np.ndarray) -> None:
        check_array(planes, (*self._shape, 4), "planes", aligned=False)


def disagreement(
    planes0: np.ndarray,  # (H, W, 4) float32: planes of frame 0 for `motion`
    planes1: np.ndarray,  # (H, W, 4) float32: planes of frame 1 for the inverse motion
    motion: np.ndarray,  # (3, 4) array: R and t
    # (H, W) float32: for each pixel of frame 0, the difference of D in frame 1, px/frame; infinite
    # where the pixel leaves the image, or one of the planes has no cost
    out: np.ndarray,
    *,
    center: tuple[float, float],  # principal point, px
    focal: float,  # px
) -> None:
    """Compute the difference of inverse depth between the planes of both frames."""
    shape = planes0.shape[:2]
    for name, planes in (("planes0", planes0), ("planes1", planes1)):
        check_array(planes, (*shape, 4), name, aligned=False)
    check_array(out, shape, "out", aligned=False)
    motion = np.ascontiguousarray(motion, np.float32)
    check_array(motion, (3, 4), "motion", aligned=False)
    _disagreement(planes0, planes1, motion, *map(float, center), focal, out)


@Kernel
def _score(
    levels0: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    packed1: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (H·W,)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    noise: ti.f32,
    seen: ti.f32,
    planes: ti.types.ndarray(dtype=_Plane, ndim=2),  # (H, W), in place
):
    height, width = planes.shape[0], planes.shape[1]
    for y, x in ti.ndrange(height, width):
        plane = planes[y, x]
        weight0, weight1, weighted0, weighted1, variance, centre = window(levels0, y, x)
        plane[3] = UNSEEN
        if variance > seen * noise:
            plane[3] = cost_in(
                packed1, 0, height, width, motion, cx, cy, focal, noise,
                weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
            )  # fmt: skip
        planes[y, x] = plane


@Kernel
def _improve(
    levels0: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    packed1: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (H·W,)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    noise: ti.f32,
    least: ti.f32,
    largest: ti.f32,
    color: ti.i32,
    draws: ti.i32,
    spread: ti.f32,
    tilt: ti.f32,
    seed: ti.i32,
    planes: ti.types.ndarray(dtype=_Plane, ndim=2),  # (H, W), in place
):
    height, width = planes.shape[0], planes.shape[1]
    for y, pair in ti.ndrange(height, (width + 1) // 2):
        x = 2 * pair + (y + color) % 2
        if x < width:
            best = planes[y, x]
            if best[3] < UNSEEN:
                weight0, weight1, weighted0, weighted1, variance, centre = window(levels0, y, x)
                random = ti.cast(4 * (y * width + x), ti.u32) * ti.cast(draws + 1, ti.u32)
                random = mixed(random + mixed(ti.cast(seed, ti.u32)))
                span = 1.0
                for n in range(5 + draws):  # 4 neighbours, 1 draw from the whole range, near draws
                    plane = best
                    if n < 4:
                        plane = neighbour(planes, y, x, n, best)
                    elif n == 4:
                        plane = drawn(random, least, largest, STEEPEST / focal)
                    else:
                        plane = drawn_near(best, random, span * spread, span * tilt)
                        span *= 0.5
                    if n >= 4:
                        random += ti.u32(4)
                    if plane[0] > least and plane[0] < largest and apart_from(plane, best):
                        plane[3] = cost_in(
                            packed1, 0, height, width, motion, cx, cy, focal, noise,
                            weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
                        )  # fmt: skip
                        if plane[3] < best[3]:
                            best = plane
                planes[y, x] = best


@ti.func
def neighbour(planes: ti.template(), y, x, way, best):
    """Return the plane of the neighbour of least cost in one direction, extrapolated to (y, x).

    D is `NONE` if there is no such neighbour.
    """
    cheapest, away = UNSEEN, 0
    down = ti.select(way == 0, 1, ti.select(way == 1, 0 - 1, 0))
    across = ti.select(way == 2, 1, ti.select(way == 3, 0 - 1, 0))
    for n in ti.static(range(len(DISTANCES))):
        row, column = y + ti.static(DISTANCES[n]) * down, x + ti.static(DISTANCES[n]) * across
        within = row >= 0 and row < planes.shape[0] and column >= 0 and column < planes.shape[1]
        cost = planes[ti.select(within, row, y), ti.select(within, column, x)][3]
        cheaper = within and cost < cheapest
        cheapest = ti.select(cheaper, cost, cheapest)
        away = ti.select(cheaper, ti.static(DISTANCES[n]), away)
    plane = ti.Vector([NONE, 0.0, 0.0, UNSEEN])
    if away > 0:
        other = planes[y + away * down, x + away * across]
        plane = other
        plane[0] = other[0] - other[1] * (away * across) - other[2] * (away * down)
    return plane


@ti.func
def drawn(random, least, largest, steepest):
    """Return a random plane with slopes of at most `steepest` times D."""
    d = least + (largest - least) * unit(random)
    slope = steepest * ti.max(d, 0.0)
    east, south = 2.0 * unit(random + ti.u32(1)) - 1.0, 2.0 * unit(random + ti.u32(2)) - 1.0
    return ti.Vector([d, slope * east, slope * south, UNSEEN])


@ti.func
def drawn_near(plane, random, spread, tilt):
    """Return a random plane near a plane: within `spread` in D and within `tilt` in its slopes."""
    near = plane
    near[0] += spread * (2.0 * unit(random) - 1.0)
    near[1] += tilt * (2.0 * unit(random + ti.u32(1)) - 1.0)
    near[2] += tilt * (2.0 * unit(random + ti.u32(2)) - 1.0)
    return near


@ti.func
def apart_from(plane, other):
    """Return whether two planes differ by more than `ALIKE` within the window."""
    apart = ti.abs(plane[0] - other[0])
    apart += RADIUS * (ti.abs(plane[1] - other[1]) + ti.abs(plane[2] - other[2]))
    return apart > ALIKE


@ti.func
def cost_in(
    packed1: ti.template(),
    view,
    height,
    width,
    motion: ti.template(),
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
    """Return 1 − c of a hypothesis in frame `view` of several frames in concatenated arrays."""
    i, j, k = 3 * view, 3 * view + 1, 3 * view + 2
    x_hat, y_hat, d = (x - cx) / focal, (y - cy) / focal, plane[0] / focal
    p1 = motion[i, 0] * x_hat + motion[i, 1] * y_hat + motion[i, 2] + motion[i, 3] * d
    p2 = motion[j, 0] * x_hat + motion[j, 1] * y_hat + motion[j, 2] + motion[j, 3] * d
    p3 = motion[k, 0] * x_hat + motion[k, 1] * y_hat + motion[k, 2] + motion[k, 3] * d
    nearness = 1.0 / ti.max(p3, NEAREST)
    x_there, y_there = p1 * nearness, p2 * nearness
    # The plane's homography, linearised within the window.
    away_x = motion[k, 0] + motion[k, 3] * plane[1]
    away_y = motion[k, 1] + motion[k, 3] * plane[2]
    ux = nearness * (motion[i, 0] + motion[i, 3] * plane[1] - x_there * away_x)
    uy = nearness * (motion[i, 1] + motion[i, 3] * plane[2] - x_there * away_y)
    vx = nearness * (motion[j, 0] + motion[j, 3] * plane[1] - y_there * away_x)
    vy = nearness * (motion[j, 1] + motion[j, 3] * plane[2] - y_there * away_y)
    u, v = cx + focal * x_there, cy + focal * y_there
    cost = NOWHERE
    if p3 > NEAREST and u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5:
        across0, down0 = ti.Vector(ACROSS[0]), ti.Vector(DOWN[0])
        across1, down1 = ti.Vector(ACROSS[1]), ti.Vector(DOWN[1])
        grey0 = sampled(
            packed1,
            view,
            height,
            width,
            u + ux * across0 + uy * down0,
            v + vx * across0 + vy * down0,
        )
        grey1 = sampled(
            packed1,
            view,
            height,
            width,
            u + ux * across1 + uy * down1,
            v + vx * across1 + vy * down1,
        )
        cost = correlation_cost(
            weight0, weight1, weighted0, weighted1, variance, centre, noise, grey0, grey1
        )
    return cost


@Kernel
def _disagreement(
    planes0: ti.types.ndarray(dtype=_Plane, ndim=2),  # (H, W)
    planes1: ti.types.ndarray(dtype=_Plane, ndim=2),  # (H, W)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    height, width = out.shape[0], out.shape[1]
    for y, x in ti.ndrange(height, width):
        plane = planes0[y, x]
        x_hat, y_hat, d = (x - cx) / focal, (y - cy) / focal, plane[0] / focal
        p1 = motion[0, 0] * x_hat + motion[0, 1] * y_hat + motion[0, 2] + motion[0, 3] * d
        p2 = motion[1, 0] * x_hat + motion[1, 1] * y_hat + motion[1, 2] + motion[1, 3] * d
        p3 = motion[2, 0] * x_hat + motion[2, 1] * y_hat + motion[2, 2] + motion[2, 3] * d
        nearness = 1.0 / ti.max(p3, NEAREST)
        u, v = cx + focal * p1 * nearness, cy + focal * p2 * nearness
        apart = ti.math.inf
        if plane[3] < UNSEEN and u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5:
            column, row = ti.cast(u + 0.5, ti.i32), ti.cast(v + 0.5, ti.i32)
            other = planes1[row, column]
            if other[3] < UNSEEN:
                back = other[0] + other[1] * (u - column) + other[2] * (v - row)
                apart = ti.abs(back - plane[0] * nearness)
        out[y, x] = apart
