"""PatchMatch for free motions: the displacement of best correlation at every pixel.

A hypothesis is a displacement (u, v) of the whole window. Its cost is 1 − c, with the correlation c
of `tisfm.kernels.rigid.windows`. Good hypotheses propagate from pixel to pixel, and random
hypotheses are drawn around them.

The state is an (H, W, 4) array: u and v in px/frame, the cost (`UNTEXTURED` where the window shows
only noise), and 1 for a pixel whose displacement is searched, else 0.

References
----------
Barnes, Shechtman, Finkelstein, Goldman, "PatchMatch: a randomized correspondence algorithm for
structural image editing", SIGGRAPH 2009, doi 10.1145/1531326.1531330.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import CHUNK, check_array
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.rigid.windows import (
    ACROSS,
    DOWN,
    MAX_PIXELS,
    OUTSIDE_COST,
    UNTEXTURED,
    correlation_cost,
    hash_of,
    load_window,
    pack_pixels,
    pad_border,
    random_unit,
    sample,
)

MIN_DIFFERENCE = 0.05  # px: displacements that differ by less count as equal; set by hand

_State = ti.types.vector(4, ti.f32)


class FlowSearch:
    """A search for displacements from frame 0 to frame 1, on one level."""

    def __init__(
        self,
        # grey0, grey1: (H, W) float32, grey levels of both frames, in [0, 255]
        grey0: np.ndarray,
        grey1: np.ndarray,
        *,
        noise: float,  # standard deviation of the noise of a frame, levels; above 0
    ) -> None:
        self._shape = grey0.shape
        for name, grey in (("grey0", grey0), ("grey1", grey1)):
            check_array(grey, self._shape, name, aligned=False)
        if grey0.size > MAX_PIXELS:
            raise ValueError(f"grey0 has {grey0.size} pixels: expected {MAX_PIXELS} at most")
        if not noise > 0:
            raise ValueError(f"noise is {noise}: expected a positive value, in grey levels")
        self._images = pad_border(grey0), pack_pixels(grey1)
        self._noise = float(noise) ** 2

    def score(
        self,
        state: np.ndarray,  # (H, W, 4) float32
        *,
        min_variance: float,  # variance of a compared window divided by the variance of the noise
    ) -> None:
        """Compute the costs of the displacements of a state, in place."""
        self._check(state)
        pixels = _searched_pixels(state)
        if pixels.size:
            _score(*self._images, self._noise, min_variance, pixels, state)

    def improve(
        self,
        state: np.ndarray,  # (H, W, 4) float32: state with costs, from `score`
        *,
        # px: distance of the far neighbours; odd, so that far neighbours of red pixels are black
        neighbour_distance: int,
        draws: int,
        # largest and smallest range of the draws in u and in v, px/frame
        spans: tuple[float, float],
        seed: int,  # seed of the random numbers
    ) -> None:
        """Improve displacements in place: first at red, then at black pixels.

        Each pixel compares its displacement with the displacements of eight neighbours, 1 and
        `neighbour_distance` px away in four directions, and with `draws` random displacements near
        its own. Each draw has half the range of the previous draw; the largest range follows the
        smallest range. No cost rises, and pixels that are not searched stay unchanged.
        """
        self._check(state)
        if neighbour_distance % 2 != 1:
            raise ValueError(
                f"neighbour_distance is {neighbour_distance}: expected an odd number of pixels"
            )
        indices, width = _searched_pixels(state), self._shape[1]
        colors = (indices // width + indices) % 2 if width % 2 == 0 else indices % 2  # 1: black
        for color in range(2):
            pixels, draw_seed = indices[colors == color], 2 * seed + color
            if pixels.size:
                _improve(
                    *self._images,
                    self._noise,
                    neighbour_distance,
                    draws,
                    *spans,
                    draw_seed,
                    pixels,
                    state,
                )

    def _check(self, state: np.ndarray) -> None:
        check_array(state, (*self._shape, 4), "state", aligned=False)


def propagate_flow(
    guide: np.ndarray,  # (H, W) float32: grey levels I
    # (H, W) float32: length of the path from the origin of a pixel's displacement; in place
    distance: np.ndarray,
    state: np.ndarray,  # (H, W, 4) float32: u and v first, px/frame; in place
    *,
    edge: float,  # grey levels: a difference that lengthens a step by 1 px; above 0
) -> None:
    """Propagate displacements along rows and columns, in both directions, if the path is shorter.

    A step from pixel to pixel has the length 1 + |ΔI| / edge. After enough calls, every pixel has
    the displacement of the pixel of distance 0 whose path to it is shortest.
    """
    check_array(guide, guide.shape, "guide", aligned=False)
    check_array(distance, guide.shape, "distance", aligned=False)
    check_array(state, (*guide.shape, 4), "state", aligned=False)
    if not edge > 0:
        raise ValueError(f"edge is {edge}: expected a positive value, in grey levels")
    for by_rows in (True, False):
        _propagate(guide, 1 / edge, by_rows, distance, state)


def _searched_pixels(state: np.ndarray) -> np.ndarray:
    """Return the indices of searched pixels, (N,) int32, counted along rows."""
    return np.flatnonzero(state[..., 3] > 0).astype(np.int32)


@Kernel
def _score(
    grey0: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    packed1: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (H·W,)
    noise: ti.f32,
    min_variance: ti.f32,
    pixels: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (N,)
    state: ti.types.ndarray(dtype=_State, ndim=2),  # (H, W), in place
):
    height, width = state.shape[0], state.shape[1]
    for n in range(pixels.shape[0]):
        y, x = pixels[n] // width, pixels[n] % width
        best = state[y, x]
        weight0, weight1, weighted0, weighted1, variance, centre = load_window(grey0, y, x)
        best[2] = UNTEXTURED
        if variance > min_variance * noise:
            best[2] = _cost(
                packed1, height, width, noise,
                weight0, weight1, weighted0, weighted1, variance, centre, y, x, best,
            )  # fmt: skip
        state[y, x] = best


@Kernel
def _improve(
    grey0: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H + 2·RADIUS, W + 2·RADIUS)
    packed1: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (H·W,)
    noise: ti.f32,
    neighbour_distance: ti.i32,
    draws: ti.i32,
    max_span: ti.f32,
    min_span: ti.f32,
    seed: ti.i32,
    pixels: ti.types.ndarray(dtype=ti.i32, ndim=1),  # (N,), all red or all black
    state: ti.types.ndarray(dtype=_State, ndim=2),  # (H, W), in place
):
    height, width = state.shape[0], state.shape[1]
    for k in range(pixels.shape[0]):
        y, x = pixels[k] // width, pixels[k] % width
        best = state[y, x]
        if best[2] < UNTEXTURED:
            weight0, weight1, weighted0, weighted1, variance, centre = load_window(grey0, y, x)
            random = ti.cast(2 * (y * width + x), ti.u32) * ti.cast(draws + 1, ti.u32)
            random = hash_of(random + hash_of(ti.cast(seed, ti.u32)))
            span = max_span
            for n in range(8 + draws):  # 8 neighbours, then random draws
                other = best
                if n < 8:
                    other = _neighbour(state, y, x, n, neighbour_distance, best)
                else:
                    other[0] += span * (2.0 * random_unit(random) - 1.0)
                    other[1] += span * (2.0 * random_unit(random + ti.u32(1)) - 1.0)
                    random += ti.u32(2)
                    span = ti.select(span > min_span, 0.5 * span, max_span)
                if ti.abs(other[0] - best[0]) + ti.abs(other[1] - best[1]) > MIN_DIFFERENCE:
                    other[2] = _cost(
                        packed1, height, width, noise,
                        weight0, weight1, weighted0, weighted1, variance, centre, y, x, other,
                    )  # fmt: skip
                    if other[2] < best[2]:
                        best = other
            state[y, x] = best


@ti.func
def _neighbour(state: ti.template(), y, x, n, neighbour_distance, best):
    """Return `best` with the displacement of one of eight neighbours, if inside the image."""
    distance = ti.select(n < 4, 1, neighbour_distance)
    direction = n % 4
    row = y + ti.select(direction == 0, distance, ti.select(direction == 1, -distance, 0))
    column = x + ti.select(direction == 2, distance, ti.select(direction == 3, -distance, 0))
    result = best
    if row >= 0 and row < state.shape[0] and column >= 0 and column < state.shape[1]:
        result[0], result[1] = state[row, column][0], state[row, column][1]
    return result


@ti.func
def _cost(
    packed1: ti.template(), height, width, noise, weight0, weight1, weighted0, weighted1, variance,
    centre, y, x, hypothesis,
):  # fmt: skip
    """Return 1 − c of a hypothesis."""
    u, v = x + hypothesis[0], y + hypothesis[1]
    cost = OUTSIDE_COST
    if u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5:
        across0, down0 = ti.Vector(ACROSS[0]), ti.Vector(DOWN[0])
        across1, down1 = ti.Vector(ACROSS[1]), ti.Vector(DOWN[1])
        grey0 = sample(packed1, 0, height, width, u + across0, v + down0)
        grey1 = sample(packed1, 0, height, width, u + across1, v + down1)
        cost = correlation_cost(
            weight0, weight1, weighted0, weighted1, variance, centre, noise, grey0, grey1
        )
    return cost


@Kernel
def _propagate(
    guide: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    inverse_edge: ti.f32,
    by_rows: ti.template(),
    distance: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W), in place
    state: ti.types.ndarray(dtype=_State, ndim=2),  # (H, W), in place
):
    lines = guide.shape[0] if ti.static(by_rows) else guide.shape[1]
    length = guide.shape[1] if ti.static(by_rows) else guide.shape[0]
    for task in range(CHUNK * lines):
        if task % CHUNK == 0:  # a line for each thread
            line = task // CHUNK
            for n in range(2 * length):
                direction = n // length  # 0 forward along the line, 1 backward
                position = n if direction == 0 else 2 * length - 1 - n
                previous = position - 1 if direction == 0 else position + 1
                if previous >= 0 and previous < length:
                    y = line if ti.static(by_rows) else position
                    x = position if ti.static(by_rows) else line
                    previous_y = line if ti.static(by_rows) else previous
                    previous_x = previous if ti.static(by_rows) else line
                    difference = ti.abs(guide[y, x] - guide[previous_y, previous_x])
                    new_distance = (
                        distance[previous_y, previous_x] + 1.0 + inverse_edge * difference
                    )
                    if new_distance < distance[y, x]:
                        distance[y, x] = new_distance
                        previous_state, new_state = state[previous_y, previous_x], state[y, x]
                        new_state[0], new_state[1] = previous_state[0], previous_state[1]
                        state[y, x] = new_state
