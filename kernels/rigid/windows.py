"""Matching cost of windows in two frames, shared by the searches that use correlation.

The cost of a window of frame 0 is 1 − c, with c its normalised correlation with samples of frame 1.
A pixel has more weight if it is similar to the window's centre. The variance of the noise is added
to both variances, so that windows with noise alone have a correlation near 0.

References
----------
Schönberger, Zheng, Frahm, Pollefeys, "Pixelwise view selection for unstructured multi-view stereo",
ECCV 2016, doi 10.1007/978-3-319-46487-9_31 (weights).
"""

import numpy as np
import taichi as ti

RADIUS = 5  # px: the window has 11 × 11 px; every second pixel in both directions is compared
SIDE = range(-RADIUS, RADIUS + 1, 2)
# Without its corners the window has 32 pixels, which fill two vectors.
WINDOW = [(j, i) for j in SIDE for i in SIDE if abs(i) < RADIUS or abs(j) < RADIUS]
VECTOR = 16
UNTEXTURED = 4.0  # more than any cost: the window shows only noise
# cost of a hypothesis that moves the pixel out of frame 1: the same as for noise
OUTSIDE_COST = 1.0
# grey levels: pixels with this difference from the centre have about weight 1/e
SIMILARITY_SCALE = 20.0
MAX_PIXELS = 2**24  # float32 represents all whole numbers up to this only
MAX_GREY = 255  # largest grey level of frame 1, which is stored in bytes
_PADDED = [[float(offset[axis]) for offset in WINDOW] for axis in (1, 0)]
ACROSS, DOWN = ([values[:VECTOR], values[VECTOR:]] for values in _PADDED)


def pack_pixels(
    grey: np.ndarray,  # (H, W) float32: in [0, 255]; they are rounded
) -> np.ndarray:  # (H·W,) int32
    """Return each pixel with its eastern, southern and south-eastern neighbour, one byte each.

    One load then gives all values for an interpolation. The border of the image is repeated.
    """
    bytes_ = np.clip(np.rint(grey), 0, MAX_GREY).astype(np.uint32)
    bytes_ = np.pad(bytes_, ((0, 1), (0, 1)), "edge")
    center, east, south, south_east = (
        bytes_[:-1, :-1],
        bytes_[:-1, 1:],
        bytes_[1:, :-1],
        bytes_[1:, 1:],
    )
    return (center | east << 8 | south << 16 | south_east << 24).view(np.int32).ravel()


def pad_border(image: np.ndarray) -> np.ndarray:
    """Return an image extended by its repeated border, (H + 2·RADIUS, W + 2·RADIUS) float32."""
    return np.pad(image, RADIUS, "edge")


@ti.func
def load_window(grey_image: ti.template(), y, x):
    """Return the data of a pixel's window in frame 0 for `correlation_cost`.

    These are the weights, with the sum 1, and the weighted grey levels minus their mean, in two
    vectors each; the variance; and the grey level of the centre.
    """
    centre = grey_image[y + RADIUS, x + RADIUS]
    grey0, grey1 = ti.Vector([0.0] * VECTOR), ti.Vector([0.0] * VECTOR)
    for n in ti.static(range(VECTOR)):
        row, column = ti.static(WINDOW[n])
        grey0[n] = grey_image[y + RADIUS + row, x + RADIUS + column] - centre
        row1, column1 = ti.static(WINDOW[VECTOR + n])
        grey1[n] = grey_image[y + RADIUS + row1, x + RADIUS + column1] - centre
    weight0, weight1 = _similarity_weights(grey0), _similarity_weights(grey1)
    inverse = 1.0 / _sum(weight0 + weight1)
    weight0 *= inverse
    weight1 *= inverse
    mean = _sum(weight0 * grey0 + weight1 * grey1)
    grey0 = grey0 - mean
    grey1 = grey1 - mean
    weighted0, weighted1 = weight0 * grey0, weight1 * grey1
    variance = _sum(weighted0 * grey0 + weighted1 * grey1)
    return weight0, weight1, weighted0, weighted1, variance, centre


@ti.func
def _similarity_weights(difference):
    """Return a weight for each difference from the centre: about e⁻ⁿ, by four terms of eⁿ."""
    n = ti.max(difference, 0.0 - difference) * (1.0 / SIMILARITY_SCALE)
    return 1.0 / (1.0 + n * (1.0 + n * (0.5 + n * (1.0 / 6.0))))


@ti.func
def correlation_cost(weight0, weight1, weighted0, weighted1, variance, centre, noise, grey0, grey1):
    """Return 1 − c for the data of `load_window` and grey levels of another frame, two vectors."""
    grey0 = grey0 - centre  # keeps squares small
    grey1 = grey1 - centre
    mean = _sum(weight0 * grey0 + weight1 * grey1)
    square = _sum(weight0 * grey0 * grey0 + weight1 * grey1 * grey1) - mean * mean
    product = _sum(weighted0 * grey0 + weighted1 * grey1)
    return 1.0 - product / ti.sqrt((variance + noise) * (ti.max(square, 0.0) + noise))


@ti.func
def sample(packed1: ti.template(), view, height, width, u, v):
    """Return a frame interpolated bilinearly at a vector of positions, with repeated borders.

    The frame has the number `view` among several frames of the same size, packed one after another.
    """
    u = ti.max(0.0, ti.min(u, width - 1.0))
    v = ti.max(0.0, ti.min(v, height - 1.0))
    column, row = ti.floor(u), ti.floor(v)
    a, b = u - column, v - row
    first = view * height * width
    # Whole numbers below 2²⁴, exact in float32: searches check `MAX_PIXELS`.
    index = row * ti.cast(width, ti.f32) + column
    center, east, south, south_east = 0.0 * u, 0.0 * u, 0.0 * u, 0.0 * u
    for n in ti.static(range(VECTOR)):  # compiled to gather instructions, if the CPU has them
        packed = packed1[first + ti.cast(index[n], ti.i32)]
        center[n] = ti.cast(packed & MAX_GREY, ti.f32)
        east[n] = ti.cast((packed >> 8) & MAX_GREY, ti.f32)
        south[n] = ti.cast((packed >> 16) & MAX_GREY, ti.f32)
        south_east[n] = ti.cast((packed >> 24) & MAX_GREY, ti.f32)
    above, below = center + a * (east - center), south + a * (south_east - south)
    return above + b * (below - above)


@ti.func
def _sum(vector):
    """Return the sum of the 16 elements of a vector, by adding halves."""
    half = ti.Vector([vector[n] + vector[n + 8] for n in range(8)])
    quarter = ti.Vector([half[n] + half[n + 4] for n in range(4)])
    return (quarter[0] + quarter[2]) + (quarter[1] + quarter[3])


@ti.func
def hash_of(value: ti.u32) -> ti.u32:
    """Return a hash of a number (PCG; Jarzynski, Olano, JCGT 2020)."""
    state = value * ti.u32(747796405) + ti.u32(2891336453)
    word = ((state >> ((state >> ti.u32(28)) + ti.u32(4))) ^ state) * ti.u32(277803737)
    return (word >> ti.u32(22)) ^ word


@ti.func
def random_unit(number: ti.u32) -> ti.f32:
    """Return a pseudo-random number in [0, 1) for each whole number."""
    return ti.cast(hash_of(number) >> ti.u32(8), ti.f32) * (1.0 / 2**24)
