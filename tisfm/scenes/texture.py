"""Paint for surfaces: marbled grey levels, a sum of octaves of band-limited noise."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .checks import Floats, whole

# The noise tile holds TILE / SAMPLES_PER_WAVE waves a side; octaves are turned and shifted copies.
TILE = 512
SAMPLES_PER_WAVE = 16

# Strength of the octaves, the finest first; the last one holds for all beyond.
STRENGTHS = (0.09, 0.16, 0.55, 0.85)
DETAIL_STRENGTH = 0.09


@dataclass(frozen=True, kw_only=True)
class Texture:
    """Marbled paint: macro blotches with weak variation inside.

    Parameters
    ----------
    wavelength : float
        Wavelength of octave 0, in the scene's unit of length.
    octaves : int, default 5
        Number of octaves from there on; each doubles the wavelength. The first two are the weak
        variation.
    detail : int, default 0
        Number of further octaves, as weak, each of which halves the wavelength.
    mean, contrast : float
        Grey levels lie within mean ± contrast before shading.
    seed : int, default 0
        Another seed gives another pattern.

    Raises
    ------
    ValueError
        If the wavelength, a number of octaves or the range of grey levels is impossible.
    """

    wavelength: float
    octaves: int = 5
    detail: int = 0
    mean: float = 124.0
    contrast: float = 76.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.wavelength) and self.wavelength > 0):
            raise ValueError(f"wavelength is {self.wavelength}: expected a positive length")
        whole(1, octaves=self.octaves)
        whole(0, detail=self.detail, seed=self.seed)
        if not 0 <= self.contrast <= min(self.mean, 255 - self.mean):
            raise ValueError(
                f"mean ± contrast is {self.mean} ± {self.contrast}: expected grey levels in "
                "[0, 255]"
            )

    def grey(self, s: Floats, t: Floats, footprint: Floats, *, face: int = 0) -> NDArray:
        """Return the grey level at surface points.

        Parameters
        ----------
        s, t : ndarray, shape (n,)
            Coordinates on the surface, in the scene's unit of length.
        footprint : ndarray, shape (n,)
            Size of a pixel's patch of surface, same unit. A wave shorter than two footprints is
            left out, one longer than three is whole.
        face : int, default 0
            Faces of an object have the same statistics and different patterns.

        Returns
        -------
        ndarray, shape (n,), float32
            Grey level within mean ± contrast.
        """
        random = np.random.default_rng([self.seed, face])
        longest = self.wavelength * 2 ** (self.octaves - 1)
        # Bending the blotches by the longest wave gives the veins of marble.
        bend = 0.05 * longest
        bent = (s + bend * _noise(s, t, longest, random), t + bend * _noise(s, t, longest, random))
        total = np.zeros(s.shape, np.float32)
        # Detail is drawn last: the longer waves are the same with and without it.
        for octave in (*range(self.octaves), *range(-1, -self.detail - 1, -1)):
            wavelength = self.wavelength * 2.0**octave
            kept = np.clip(wavelength / footprint - 2, 0, 1).astype(np.float32)
            strength = (
                STRENGTHS[min(octave, len(STRENGTHS) - 1)] if octave >= 0 else DETAIL_STRENGTH
            )
            wave = _noise(*(bent if octave >= 2 else (s, t)), wavelength, random)
            total += np.float32(strength) * kept * kept * (3 - 2 * kept) * wave
        # The soft limit flattens the inside of the blotches and bounds the range.
        return np.float32(self.mean) + np.float32(self.contrast) * np.tanh(total)


def _noise(s: Floats, t: Floats, wavelength: float, random: np.random.Generator) -> NDArray:
    """Look up one octave of noise, unit variance, turned and shifted at random."""
    angle, *shift = random.uniform(0, 1, 3) * (2 * math.pi, TILE, TILE)
    across = math.cos(angle) * SAMPLES_PER_WAVE / wavelength
    along = math.sin(angle) * SAMPLES_PER_WAVE / wavelength
    column = across * s - along * t + shift[0]
    row = along * s + across * t + shift[1]
    left, top = np.floor(column), np.floor(row)
    index = (top.astype(np.int64) % TILE) * TILE + left.astype(np.int64) % TILE
    corner = _tile().take(index, axis=0)
    dx = (column - left).astype(np.float32)
    dy = (row - top).astype(np.float32)
    return corner[:, 0] + dx * corner[:, 1] + dy * (corner[:, 2] + dx * corner[:, 3])


@lru_cache(maxsize=1)
def _tile() -> NDArray:
    """Return a periodic octave of noise as coefficients of bilinear interpolation, (TILE², 4)."""
    white = np.random.default_rng(2007).standard_normal((TILE, TILE))
    frequency = np.fft.fftfreq(TILE) * SAMPLES_PER_WAVE
    radius = np.hypot(frequency[:, None], frequency[None, :])
    band = (radius > 0.7) & (radius < 1.3)
    wave = np.fft.ifft2(np.fft.fft2(white) * band).real
    wave /= wave.std()
    east, south = np.roll(wave, -1, axis=1), np.roll(wave, -1, axis=0)
    south_east = np.roll(east, -1, axis=0)
    coefficients = np.stack([wave, east - wave, south - wave, south_east - east - south + wave], -1)
    tile = coefficients.reshape(-1, 4).astype(np.float32)
    tile.flags.writeable = False
    return tile
