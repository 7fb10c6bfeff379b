"""Windows of two frames, and how alike they are: what searches by correlation share.

A window of frame 0 costs 1 − c, c being its correlation with what frame 1 shows at other places,
normalised, weighted by how much a pixel looks like the window's centre, and with the variance of
the noise added to both variances, so that noise alone correlates with nothing.

References
----------
Schönberger, Zheng, Frahm, Pollefeys, "Pixelwise view selection for unstructured multi-view stereo",
ECCV 2016, doi 10.1007/978-3-319-46487-9_31 (weights).
"""

import numpy as np
import taichi as ti

RADIUS = 5  # px: the window has 11×11, of which every second one in both directions is compared
SIDE = range(-RADIUS, RADIUS + 1, 2)
# Without its corners it fills two vectors.
WINDOW = [(j, i) for j in SIDE for i in SIDE if abs(i) < RADIUS or abs(j) < RADIUS]
VECTOR = 16
UNSEEN = 4.0  # a cost that no hypothesis has: nothing to be compared
NOWHERE = 1.0  # of a hypothesis that takes the pixel out of frame 1: that of noise
SIMILAR = 20.0  # levels: pixels that differ by so much from the centre weigh 1/e, about
MOST_PIXELS = 2**24  # float32 counts no further
LEVELS = 255  # of frame 1, in bytes

_PADDED = [[float(offset[axis]) for offset in WINDOW] for axis in (1, 0)]
ACROSS, DOWN = ([values[:VECTOR], values[VECTOR:]] for values in _PADDED)


def packed(levels: np.ndarray) -> np.ndarray:
    """Return each pixel with its eastern, southern and south-eastern neighbour, a byte each.

    So that one load brings all that an interpolation needs. Beyond its border the image repeats.

    Parameters
    ----------
    levels : (H, W) float32
        In [0, 255]; rounded.

    Returns
    -------
    (H·W,) int32
    """
    whole = np.clip(np.rint(levels), 0, LEVELS).astype(np.uint32)
    whole = np.pad(whole, ((0, 1), (0, 1)), "edge")
    here, east, south, both = whole[:-1, :-1], whole[:-1, 1:], whole[1:, :-1], whole[1:, 1:]
    return (here | east << 8 | south << 16 | both << 24).view(np.int32).ravel()


def with_margin(levels: np.ndarray) -> np.ndarray:
    """Return (H + 2·RADIUS, W + 2·RADIUS) float32: an image whose border repeats as far."""
    return np.pad(levels, RADIUS, "edge")


@ti.func
def window(levels0: ti.template(), y, x):
    """Return what a pixel's window of frame 0 is compared by.

    Weights, which add up to 1, and the grey levels less their mean, weighted, in two vectors each;
    the variance; and the level of the centre.
    """
    centre = levels0[y + RADIUS, x + RADIUS]
    grey0, grey1 = ti.Vector([0.0] * VECTOR), ti.Vector([0.0] * VECTOR)
    for n in ti.static(range(VECTOR)):
        row, column = ti.static(WINDOW[n])
        grey0[n] = levels0[y + RADIUS + row, x + RADIUS + column] - centre
        row1, column1 = ti.static(WINDOW[VECTOR + n])
        grey1[n] = levels0[y + RADIUS + row1, x + RADIUS + column1] - centre
    weight0, weight1 = _likeness(grey0), _likeness(grey1)
    inverse = 1.0 / _total(weight0 + weight1)
    weight0 *= inverse
    weight1 *= inverse
    mean = _total(weight0 * grey0 + weight1 * grey1)
    grey0 = grey0 - mean
    grey1 = grey1 - mean
    weighted0, weighted1 = weight0 * grey0, weight1 * grey1
    variance = _total(weighted0 * grey0 + weighted1 * grey1)
    return weight0, weight1, weighted0, weighted1, variance, centre


@ti.func
def _likeness(apart):
    """Return a weight for each difference from the centre: e⁻ⁿ, by four terms of eⁿ."""
    n = ti.max(apart, 0.0 - apart) * (1.0 / SIMILAR)
    return 1.0 / (1.0 + n * (1.0 + n * (0.5 + n * (1.0 / 6.0))))


@ti.func
def correlation_cost(weight0, weight1, weighted0, weighted1, variance, centre, noise, grey0, grey1):
    """Return 1 − c of a window, of `window`, and of grey levels there, in two vectors."""
    grey0 = grey0 - centre  # squares stay small
    grey1 = grey1 - centre
    mean = _total(weight0 * grey0 + weight1 * grey1)
    square = _total(weight0 * grey0 * grey0 + weight1 * grey1 * grey1) - mean * mean
    product = _total(weighted0 * grey0 + weighted1 * grey1)
    return 1.0 - product / ti.sqrt((variance + noise) * (ti.max(square, 0.0) + noise))


@ti.func
def sampled(packed1: ti.template(), view, height, width, u, v):
    """Return a frame, interpolated bilinearly, at a vector of places; its border repeats.

    It is one of several of the same size, packed one after another.
    """
    u = ti.max(0.0, ti.min(u, width - 1.0))
    v = ti.max(0.0, ti.min(v, height - 1.0))
    column, row = ti.floor(u), ti.floor(v)
    a, b = u - column, v - row
    first = view * height * width
    # Whole, and below 2²⁴: searches take no more pixels.
    place = row * ti.cast(width, ti.f32) + column
    here, east, south, both = 0.0 * u, 0.0 * u, 0.0 * u, 0.0 * u
    for n in ti.static(range(VECTOR)):  # compiled to gathering loads, where a CPU has them
        found = packed1[first + ti.cast(place[n], ti.i32)]
        here[n] = ti.cast(found & LEVELS, ti.f32)
        east[n] = ti.cast((found >> 8) & LEVELS, ti.f32)
        south[n] = ti.cast((found >> 16) & LEVELS, ti.f32)
        both[n] = ti.cast((found >> 24) & LEVELS, ti.f32)
    above, below = here + a * (east - here), south + a * (both - south)
    return above + b * (below - above)


@ti.func
def _total(vector):
    """Return the sum of the elements of a vector, folded in halves."""
    half = ti.Vector([vector[n] + vector[n + 8] for n in range(8)])
    quarter = ti.Vector([half[n] + half[n + 4] for n in range(4)])
    return (quarter[0] + quarter[2]) + (quarter[1] + quarter[3])


@ti.func
def mixed(value: ti.u32) -> ti.u32:
    """Return a well-mixed number (Jarzynski, Olano, JCGT 2020: PCG)."""
    state = value * ti.u32(747796405) + ti.u32(2891336453)
    word = ((state >> ((state >> ti.u32(28)) + ti.u32(4))) ^ state) * ti.u32(277803737)
    return (word >> ti.u32(22)) ^ word


@ti.func
def unit(number: ti.u32) -> ti.f32:
    """Return a number in [0, 1) that looks random, for each whole number."""
    return ti.cast(mixed(number) >> ti.u32(8), ti.f32) * (1.0 / 2**24)
