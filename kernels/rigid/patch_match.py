"""PatchMatch for planes: the plane at every pixel with which frame 1 matches frame 0 best.

A hypothesis is an inverse depth and its slopes. The surface is a plane within the window, so its
inverse depth is linear in the image. The cost is that of `tisfm.kernels.rigid.windows` for the
window in frame 0 and its projection into frame 1. Good hypotheses propagate from pixel to pixel as
planes, and random hypotheses are drawn.

The state is an (H, W, 4) array: D in px/frame, ∂D/∂x and ∂D/∂y, and the cost, `UNTEXTURED` where
the window shows only noise.

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
from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.kernels.rigid.windows import (
    ACROSS,
    DOWN,
    MAX_PIXELS,
    OUTSIDE_COST,
    RADIUS,
    UNTEXTURED,
    correlation_cost,
    hash_of,
    load_window,
    pack_pixels,
    pad_border,
    random_unit,
    sample,
)

# px: distances of neighbours; odd, so that all neighbours of red pixels are black.
DISTANCES = (1, 3, 5, 7, 13, 21)
NO_DEPTH = -1e30  # value of D that means no hypothesis
MIN_DIFFERENCE = 0.03  # px: hypotheses that differ by less within the window count as equal
MAX_SLOPE = 3.0  # limit of random slopes, in D per focal length: a surface at 72° to the image

_Plane = ti.types.vector(4, ti.f32)


class PlaneSearch:
    """A search for planes that map frame 0 to frame 1, on one level."""

    def __init__(
        self,
        # grey0, grey1: (H, W) float32, grey levels of both frames, in [0, 255]
        grey0: np.ndarray,
        grey1: np.ndarray,
        motion: np.ndarray,  # (3, 4) array: R and t
        *,
        center: tuple[float, float],  # principal point, px
        focal: float,  # px
        noise: float,  # standard deviation of the noise of a frame, levels; above 0
        min_variance: float,  # variance of a compared window divided by the variance of the noise
        # min_depth, max_depth: bounds of D, px/frame
        min_depth: float,
        max_depth: float,
    ) -> None:
        self._shape = grey0.shape
        for name, grey in (("grey0", grey0), ("grey1", grey1)):
            check_array(grey, self._shape, name, aligned=False)
        if grey0.size > MAX_PIXELS:
            raise ValueError(f"grey0 has {grey0.size} pixels: expected {MAX_PIXELS} at most")
        if np.shape(motion) != (3, 4):
            raise ValueError(f"motion is {np.shape(motion)}: expected (3, 4)")
        if not noise > 0:
            raise ValueError(f"noise is {noise}: expected a positive value, in grey levels")
        if not min_depth < max_depth:
            raise ValueError(f"D is searched from {min_depth} to {max_depth}: expected from < to")
        self._images = pad_border(grey0), pack_pixels(grey1)
        self._motion = np.ascontiguousarray(motion, np.float32)
        self._view = *map(float, center), float(focal)
        self._noise = float(noise) ** 2
        self._min_variance, self._bounds = float(min_variance), (float(min_depth), float(max_depth))

    def score(self, planes: np.ndarray) -> None:
        """Compute the cost of the planes (H, W, 4) float32, in place."""
        self._check(planes)
        _score(*self._images, self._motion, *self._view, self._noise, self._min_variance, planes)

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

        Each pixel compares its plane with the planes of four neighbours, in each direction the
        neighbour of least cost; with a random plane from the whole range; and with `draws` random
        planes near its own, each from half the range of the previous draw. No cost rises.
        """
        self._check(planes)
        for color in range(2):
            _improve(
                *self._images, self._motion, *self._view, self._noise, *self._bounds, color, draws,
                spread, tilt, 2 * seed + color, planes,
            )  # fmt: skip

    def _check(self, planes: np.ndarray) -> None:
        check_array(planes, (*self._shape, 4), "planes", aligned=False)


def plane_disagreement(
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
    _plane_disagreement(planes0, planes1, motion, *map(float, center), focal, out)


@Kernel
def _score(
    grey0: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    packed1: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (H·W,)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    noise: ti.f32,
    min_variance: ti.f32,
    planes: ti.types.ndarray(dtype=_Plane, ndim=2),  # (H, W), in place
):
    height, width = planes.shape[0], planes.shape[1]
    for y, x in ti.ndrange(height, width):
        plane = planes[y, x]
        weight0, weight1, weighted0, weighted1, variance, centre = load_window(grey0, y, x)
        plane[3] = UNTEXTURED
        if variance > min_variance * noise:
            plane[3] = plane_cost(
                packed1, 0, height, width, motion, cx, cy, focal, noise,
                weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
            )  # fmt: skip
        planes[y, x] = plane


@Kernel
def _improve(
    grey0: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    packed1: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (H·W,)
    motion: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (3, 4)
    cx: ti.f32,
    cy: ti.f32,
    focal: ti.f32,
    noise: ti.f32,
    min_depth: ti.f32,
    max_depth: ti.f32,
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
            if best[3] < UNTEXTURED:
                weight0, weight1, weighted0, weighted1, variance, centre = load_window(grey0, y, x)
                random = ti.cast(4 * (y * width + x), ti.u32) * ti.cast(draws + 1, ti.u32)
                random = hash_of(random + hash_of(ti.cast(seed, ti.u32)))
                span = 1.0
                for n in range(5 + draws):  # 4 neighbours, 1 draw from the whole range, near draws
                    plane = best
                    if n < 4:
                        plane = cheapest_neighbour(planes, y, x, n, best)
                    elif n == 4:
                        plane = draw_plane(random, min_depth, max_depth, MAX_SLOPE / focal)
                    else:
                        plane = perturb_plane(best, random, span * spread, span * tilt)
                        span *= 0.5
                    if n >= 4:
                        random += ti.u32(4)
                    if plane[0] > min_depth and plane[0] < max_depth and is_different(plane, best):
                        plane[3] = plane_cost(
                            packed1, 0, height, width, motion, cx, cy, focal, noise,
                            weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
                        )  # fmt: skip
                        if plane[3] < best[3]:
                            best = plane
                planes[y, x] = best


@ti.func
def cheapest_neighbour(planes: ti.template(), y, x, direction, best):
    """Return the plane of the neighbour of least cost in one direction, extrapolated to (y, x).

    D is `NO_DEPTH` if there is no such neighbour.
    """
    min_cost, distance = UNTEXTURED, 0
    dy = ti.select(direction == 0, 1, ti.select(direction == 1, 0 - 1, 0))
    dx = ti.select(direction == 2, 1, ti.select(direction == 3, 0 - 1, 0))
    for n in ti.static(range(len(DISTANCES))):
        row, column = y + ti.static(DISTANCES[n]) * dy, x + ti.static(DISTANCES[n]) * dx
        is_inside = row >= 0 and row < planes.shape[0] and column >= 0 and column < planes.shape[1]
        cost = planes[ti.select(is_inside, row, y), ti.select(is_inside, column, x)][3]
        is_cheaper = is_inside and cost < min_cost
        min_cost = ti.select(is_cheaper, cost, min_cost)
        distance = ti.select(is_cheaper, ti.static(DISTANCES[n]), distance)
    plane = ti.Vector([NO_DEPTH, 0.0, 0.0, UNTEXTURED])
    if distance > 0:
        other = planes[y + distance * dy, x + distance * dx]
        plane = other
        plane[0] = other[0] - other[1] * (distance * dx) - other[2] * (distance * dy)
    return plane


@ti.func
def draw_plane(random, min_depth, max_depth, max_slope):
    """Return a random plane with slopes of at most `max_slope` times D."""
    d = min_depth + (max_depth - min_depth) * random_unit(random)
    slope = max_slope * ti.max(d, 0.0)
    east, south = (
        2.0 * random_unit(random + ti.u32(1)) - 1.0,
        2.0 * random_unit(random + ti.u32(2)) - 1.0,
    )
    return ti.Vector([d, slope * east, slope * south, UNTEXTURED])


@ti.func
def perturb_plane(plane, random, spread, tilt):
    """Return a random plane near a plane: within `spread` in D and within `tilt` in its slopes."""
    draw = plane
    draw[0] += spread * (2.0 * random_unit(random) - 1.0)
    draw[1] += tilt * (2.0 * random_unit(random + ti.u32(1)) - 1.0)
    draw[2] += tilt * (2.0 * random_unit(random + ti.u32(2)) - 1.0)
    return draw


@ti.func
def is_different(plane, other):
    """Return whether two planes differ by more than `MIN_DIFFERENCE` within the window."""
    difference = ti.abs(plane[0] - other[0])
    difference += RADIUS * (ti.abs(plane[1] - other[1]) + ti.abs(plane[2] - other[2]))
    return difference > MIN_DIFFERENCE


@ti.func
def plane_cost(
    packed1: ti.template(), view, height, width, motion: ti.template(), cx, cy, focal, noise,
    weight0, weight1, weighted0, weighted1, variance, centre, y, x, plane,
):  # fmt: skip
    """Return 1 − c of a hypothesis in frame `view` of several frames in concatenated arrays."""
    i, j, k = 3 * view, 3 * view + 1, 3 * view + 2
    x_hat, y_hat, d = (x - cx) / focal, (y - cy) / focal, plane[0] / focal
    p1 = motion[i, 0] * x_hat + motion[i, 1] * y_hat + motion[i, 2] + motion[i, 3] * d
    p2 = motion[j, 0] * x_hat + motion[j, 1] * y_hat + motion[j, 2] + motion[j, 3] * d
    p3 = motion[k, 0] * x_hat + motion[k, 1] * y_hat + motion[k, 2] + motion[k, 3] * d
    nearness = 1.0 / ti.max(p3, MIN_DEPTH_RATIO)
    x1, y1 = p1 * nearness, p2 * nearness
    # The plane's homography, linearised within the window.
    depth_slope_x = motion[k, 0] + motion[k, 3] * plane[1]
    depth_slope_y = motion[k, 1] + motion[k, 3] * plane[2]
    ux = nearness * (motion[i, 0] + motion[i, 3] * plane[1] - x1 * depth_slope_x)
    uy = nearness * (motion[i, 1] + motion[i, 3] * plane[2] - x1 * depth_slope_y)
    vx = nearness * (motion[j, 0] + motion[j, 3] * plane[1] - y1 * depth_slope_x)
    vy = nearness * (motion[j, 1] + motion[j, 3] * plane[2] - y1 * depth_slope_y)
    u, v = cx + focal * x1, cy + focal * y1
    cost = OUTSIDE_COST
    if p3 > MIN_DEPTH_RATIO and u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5:
        across0, down0 = ti.Vector(ACROSS[0]), ti.Vector(DOWN[0])
        across1, down1 = ti.Vector(ACROSS[1]), ti.Vector(DOWN[1])
        grey0 = sample(
            packed1, view, height, width, u + ux * across0 + uy * down0,
            v + vx * across0 + vy * down0,
        )  # fmt: skip
        grey1 = sample(
            packed1, view, height, width, u + ux * across1 + uy * down1,
            v + vx * across1 + vy * down1,
        )  # fmt: skip
        cost = correlation_cost(
            weight0, weight1, weighted0, weighted1, variance, centre, noise, grey0, grey1
        )
    return cost


@Kernel
def _plane_disagreement(
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
        nearness = 1.0 / ti.max(p3, MIN_DEPTH_RATIO)
        u, v = cx + focal * p1 * nearness, cy + focal * p2 * nearness
        difference = ti.math.inf
        if plane[3] < UNTEXTURED and u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5:
            column, row = ti.cast(u + 0.5, ti.i32), ti.cast(v + 0.5, ti.i32)
            other = planes1[row, column]
            if other[3] < UNTEXTURED:
                depth1 = other[0] + other[1] * (u - column) + other[2] * (v - row)
                difference = ti.abs(depth1 - plane[0] * nearness)
        out[y, x] = difference
