"""Paint for surfaces: marbled grey levels, a sum of octaves of band-limited noise."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats, check_finite, check_whole_numbers
from tisfm.errors import InputError

# The noise tile has TILE / SAMPLES_PER_WAVE waves along each side; octaves are rotated and shifted
# copies of it. All strengths are set by hand.
TILE = 512  # samples along each side of the tile
SAMPLES_PER_WAVE = 16
OCTAVE_STRENGTHS = (
    0.09,
    0.16,
    0.55,
    0.85,
)  # of the octaves from `wavelength` up, the last for all further
DETAIL_EDGE = 0.09  # strength of an octave of detail at the edges of blotches
DETAIL_INSIDE = 0.045  # strength of an octave of detail inside blotches


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A rectangle of one grey level painted over a texture.

    Parameters
    ----------
    center : (float, float)
        In the coordinates of the surface, in the scene's unit of length.
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
        """Return whether points of the surface, (n,) each, lie on it."""
        across, down = np.abs(s - self.center[0]), np.abs(t - self.center[1])
        return (across <= self.size[0] / 2) & (down <= self.size[1] / 2)


@dataclass(frozen=True, kw_only=True)
class Texture:
    """Marbled paint: macro blotches with weak variation inside.

    Parameters
    ----------
    wavelength : float
        Shortest wavelength without detail, in the scene's unit of length.
    octaves : int, default 5
        Number of octaves; each doubles the wavelength. The first two are the weak variation.
    detail : int, default 0
        Number of weak octaves added below; each halves the wavelength.
    mean, contrast : float
        Grey levels lie within mean ± contrast before shading. Detail may go somewhat beyond.
    seed : int, default 0
        Another seed gives another pattern.
    patches : tuple of Patch
        Parts without texture, later ones over earlier ones; a box has them on every face.

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
        """Return the grey level, (n,) float32, at coordinates s, t of a face, (n,), length.

        A footprint, (n,), length, is the size of a pixel's patch of surface: a wave shorter than
        two of them is left out, one longer than three is whole.
        """
        draws = iter(_draws(self.seed, face, 2 + self.octaves + self.detail))
        finest = footprint.min() if s.size else math.inf

        def wave(at: tuple[Floats, Floats], octave: int) -> NDArray | float:
            wavelength, draw = self.wavelength * 2.0**octave, next(draws)
            if wavelength / finest <= 2:  # it is left out at every point
                return 0.0
            kept = np.clip(wavelength / footprint - 2, 0, 1).astype(np.float32)
            strength = (
                OCTAVE_STRENGTHS[min(octave, len(OCTAVE_STRENGTHS) - 1)] if octave >= 0 else 1.0
            )
            return strength * kept * kept * (3 - 2 * kept) * _noise(*at, wavelength, draw)

        # Bending the blotches by the longest wave gives the veins of marble.
        longest = self.wavelength * 2 ** (self.octaves - 1)
        bend = 0.05 * longest
        bent = (
            s + bend * _noise(s, t, longest, next(draws)),
            t + bend * _noise(s, t, longest, next(draws)),
        )
        blotches, fine = np.zeros((2, s.size), np.float32)
        for octave in range(self.octaves):
            blotches += wave((s, t) if octave < 2 else bent, octave)
        # Drawn last, detail leaves the longer waves as they are.
        for octave in range(self.detail):
            fine += wave((s, t), -1 - octave)
        # The soft limit flattens the inside of the blotches and bounds the range.
        level = np.tanh(blotches + DETAIL_EDGE * fine) + DETAIL_INSIDE * fine
        grey = np.clip(np.float32(self.mean) + np.float32(self.contrast) * level, 0, 255)
        for patch in self.patches:
            grey[patch.covers(s, t)] = patch.grey
        return grey

    def _plain(self, s: Floats, t: Floats) -> NDArray[np.bool_]:
        """Return whether points, (n,) each, have a single grey level around them."""
        plain = np.full(s.shape, self.contrast == 0)
        for patch in self.patches:
            plain |= patch.covers(s, t)
        return plain


@lru_cache(maxsize=256)
def _draws(seed: int, face: int, count: int) -> Floats:
    """Return the random numbers of octaves, (count, 3): angle, rad, and shifts, samples."""
    random = np.random.default_rng([seed, face])
    return random.uniform(0, 1, (count, 3)) * (2 * math.pi, TILE, TILE)


def _noise(s: Floats, t: Floats, wavelength: float, draw: Floats) -> NDArray:
    """Look up one octave of noise, unit variance, turned and shifted as drawn."""
    angle, *shift = draw
    across = math.cos(angle) * SAMPLES_PER_WAVE / wavelength
    along = math.sin(angle) * SAMPLES_PER_WAVE / wavelength
    column = across * s - along * t + shift[0]
    row = along * s + across * t + shift[1]
    left, top = np.floor(column), np.floor(row)
    index = (top.astype(np.int64) % TILE) * TILE + left.astype(np.int64) % TILE
    corner = _tile().take(index, axis=0)
    dx, dy = (column - left).astype(np.float32), (row - top).astype(np.float32)
    return corner[:, 0] + dx * corner[:, 1] + dy * (corner[:, 2] + dx * corner[:, 3])


@lru_cache(maxsize=1)
def _tile() -> NDArray:
    """Return a periodic octave of noise as coefficients of bilinear interpolation, (TILE², 4)."""
    white = np.random.default_rng(2007).standard_normal((TILE, TILE))
    frequency = np.fft.fftfreq(TILE) * SAMPLES_PER_WAVE
    radius = np.hypot(frequency[:, None], frequency)
    wave = np.fft.ifft2(np.fft.fft2(white) * ((radius > 0.7) & (radius < 1.3))).real
    wave /= wave.std()
    east, south = np.roll(wave, -1, axis=1), np.roll(wave, -1, axis=0)
    south_east = np.roll(east, -1, axis=0)
    coefficients = np.stack([wave, east - wave, south - wave, south_east - east - south + wave], -1)
    return coefficients.reshape(-1, 4).astype(np.float32)
