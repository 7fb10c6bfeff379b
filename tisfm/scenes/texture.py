"""Textures of surfaces: marbled grey levels, a sum of octaves of band-limited noise."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats, check_finite, check_whole_numbers
from tisfm.errors import InputError

# The noise tile has TILE_SIDE / SAMPLES_PER_WAVE waves along each side. Octaves are rotated and
# shifted copies of the tile. All strengths are set by hand.
TILE_SIDE = 512  # samples
SAMPLES_PER_WAVE = 16
# Strength of each octave, beginning with the shortest wave; all further octaves have the last
# value.
OCTAVE_STRENGTHS = (0.09, 0.16, 0.55, 0.85)
DETAIL_EDGE = 0.09  # strength of an octave of detail at the edges of blotches
DETAIL_INSIDE = 0.045  # strength of an octave of detail inside blotches


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A rectangle of one grey level on a texture.

    Parameters
    ----------
    center : (float, float)
        Centre in the coordinates of the surface, in the scene's unit of length.
    size : (float, float)
        Edge lengths, in the same unit.
    grey : float
        Grey level before shading.

    Raises
    ------
    ValueError
        If a number is not finite, a length is not positive or the grey level not in [0, 255].

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.scenes import Patch
    >>> patch = Patch(center=(0, 0), size=(2, 1), grey=105)
    >>> patch.covers(np.array([0.0, 0.9, 1.1]), np.zeros(3)).tolist()
    [True, True, False]
    """

    center: tuple[float, float]
    size: tuple[float, float]
    grey: float

    def __post_init__(self) -> None:
        check_finite(self.center, (2,), "center")
        if not (check_finite(self.size, (2,), "size") > 0).all():
            raise InputError(f"size is {self.size}: expected positive edge lengths")
        if not 0 <= self.grey <= 255:
            raise InputError(f"grey is {self.grey}: expected a grey level in [0, 255]")

    def covers(self, s: Floats, t: Floats) -> NDArray[np.bool_]:
        """Return whether points of the surface, s and t of shape (n,), lie in the rectangle."""
        ds, dt = np.abs(s - self.center[0]), np.abs(t - self.center[1])
        return (ds <= self.size[0] / 2) & (dt <= self.size[1] / 2)


@dataclass(frozen=True, kw_only=True)
class Texture:
    """Marbled grey levels: large blotches with weak variation inside.

    Parameters
    ----------
    wavelength : float
        Shortest wavelength without detail, in the scene's unit of length.
    octaves : int, default 5
        Number of octaves; each octave has twice the wavelength of the octave before. The first two
        are the weak variation.
    detail : int, default 0
        Number of additional weak octaves with shorter waves; each halves the wavelength.
    mean, contrast : float
        Grey levels lie within mean ± contrast before shading, except for small deviations by
        detail.
    seed : int, default 0
        Seed of the random pattern.
    patches : tuple of Patch
        Parts without texture; later patches cover earlier patches. A box has the patches on every
        face.

    Raises
    ------
    ValueError
        If the wavelength, a number of octaves, the seed or the range of grey levels is impossible.

    Examples
    --------
    >>> from tisfm.scenes import Patch, Texture
    >>> bare = Patch(center=(0, 0), size=(1, 1), grey=105)
    >>> paint = Texture(wavelength=0.4, mean=110, contrast=50, seed=3, patches=(bare,))
    >>> paint.mean
    110
    """

    wavelength: float
    octaves: int = 5
    detail: int = 0
    mean: float = 124.0
    contrast: float = 76.0
    seed: int = 0
    patches: tuple[Patch, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.wavelength) and self.wavelength > 0):
            raise InputError(f"wavelength is {self.wavelength}: expected a positive length")
        check_whole_numbers(1, octaves=self.octaves)
        check_whole_numbers(0, detail=self.detail, seed=self.seed)
        if not 0 <= self.contrast <= min(self.mean, 255 - self.mean):
            span = f"{self.mean} ± {self.contrast}"
            raise InputError(f"mean ± contrast is {span}: expected grey levels in [0, 255]")

    def _grey(self, s: Floats, t: Floats, footprint: Floats, face: int = 0) -> NDArray:
        """Return the grey levels, (n,) float32, at coordinates s, t of a face, (n,), length.

        A footprint, (n,), length, is the size of a pixel on the surface. Waves shorter than two
        footprints are left out; waves longer than three footprints have their full strength.
        """
        octave_parameters = iter(_random_numbers(self.seed, face, 2 + self.octaves + self.detail))
        min_footprint = footprint.min() if s.size else math.inf

        def wave(position: tuple[Floats, Floats], octave: int) -> NDArray | float:
            wavelength, parameters = self.wavelength * 2.0**octave, next(octave_parameters)
            if wavelength / min_footprint <= 2:  # the wave is left out at every point
                return 0.0
            fade = np.clip(wavelength / footprint - 2, 0, 1).astype(np.float32)
            strength = (
                OCTAVE_STRENGTHS[min(octave, len(OCTAVE_STRENGTHS) - 1)] if octave >= 0 else 1.0
            )
            return (
                strength * fade * fade * (3 - 2 * fade) * _noise(*position, wavelength, parameters)
            )

        # A displacement of the blotches by the longest wave gives the veins of marble.
        max_wavelength = self.wavelength * 2 ** (self.octaves - 1)
        amplitude = 0.05 * max_wavelength
        displaced_points = (
            s + amplitude * _noise(s, t, max_wavelength, next(octave_parameters)),
            t + amplitude * _noise(s, t, max_wavelength, next(octave_parameters)),
        )
        blotches, detail = np.zeros((2, s.size), np.float32)
        for octave in range(self.octaves):
            blotches += wave((s, t) if octave < 2 else displaced_points, octave)
        # The random numbers of detail are the last ones: detail does not change the longer waves.
        for octave in range(self.detail):
            detail += wave((s, t), -1 - octave)
        # The soft limit flattens the inside of the blotches and bounds the range.
        level = np.tanh(blotches + DETAIL_EDGE * detail) + DETAIL_INSIDE * detail
        grey = np.clip(np.float32(self.mean) + np.float32(self.contrast) * level, 0, 255)
        for patch in self.patches:
            grey[patch.covers(s, t)] = patch.grey
        return grey

    def _is_plain(self, s: Floats, t: Floats) -> NDArray[np.bool_]:
        """Return whether the surface has a single grey level around points s, t, (n,) each."""
        is_plain = np.full(s.shape, self.contrast == 0)
        for patch in self.patches:
            is_plain |= patch.covers(s, t)
        return is_plain


@lru_cache(maxsize=256)
def _random_numbers(seed: int, face: int, count: int) -> Floats:
    """Return the random numbers of octaves, (count, 3): angle, rad, and shifts, samples."""
    random = np.random.default_rng([seed, face])
    return random.uniform(0, 1, (count, 3)) * (2 * math.pi, TILE_SIDE, TILE_SIDE)


def _noise(s: Floats, t: Floats, wavelength: float, parameters: Floats) -> NDArray:
    """Return one octave of noise of unit variance, rotated and shifted by random numbers."""
    angle, *shift = parameters
    cos = math.cos(angle) * SAMPLES_PER_WAVE / wavelength  # samples per length
    sin = math.sin(angle) * SAMPLES_PER_WAVE / wavelength
    column = cos * s - sin * t + shift[0]
    row = sin * s + cos * t + shift[1]
    left, top = np.floor(column), np.floor(row)
    index = (top.astype(np.int64) % TILE_SIDE) * TILE_SIDE + left.astype(np.int64) % TILE_SIDE
    coefficients = _tile().take(index, axis=0)
    dx, dy = (column - left).astype(np.float32), (row - top).astype(np.float32)
    return (
        coefficients[:, 0]
        + dx * coefficients[:, 1]
        + dy * (coefficients[:, 2] + dx * coefficients[:, 3])
    )


@lru_cache(maxsize=1)
def _tile() -> NDArray:
    """Return periodic noise as coefficients of bilinear interpolation, (TILE_SIDE², 4)."""
    white_noise = np.random.default_rng(2007).standard_normal((TILE_SIDE, TILE_SIDE))
    frequency = np.fft.fftfreq(TILE_SIDE) * SAMPLES_PER_WAVE  # 1: frequency of the mean wave
    radial_frequency = np.hypot(frequency[:, None], frequency)
    noise = np.fft.ifft2(
        np.fft.fft2(white_noise) * ((radial_frequency > 0.7) & (radial_frequency < 1.3))
    ).real
    noise /= noise.std()
    east, south = np.roll(noise, -1, axis=1), np.roll(noise, -1, axis=0)
    south_east = np.roll(east, -1, axis=0)
    coefficients = np.stack(
        [noise, east - noise, south - noise, south_east - east - south + noise], -1
    )
    return coefficients.reshape(-1, 4).astype(np.float32)
