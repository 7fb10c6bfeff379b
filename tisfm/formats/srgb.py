"""The transfer curve of sRGB: coded values, as in pictures, and amounts of light.

References
----------
IEC 61966-2-1:1999.
"""

import functools

import numpy as np
from numpy.typing import NDArray


@functools.cache
def linear_from_srgb() -> NDArray[np.float32]:
    """Return the light of each of the 256 coded values, from 0 to 1."""
    coded_values = np.arange(256) / 255
    dark_part = coded_values / 12.92
    bright_part = ((coded_values + 0.055) / 1.055) ** 2.4
    return np.where(coded_values <= 0.04045, dark_part, bright_part).astype(np.float32)


@functools.cache
def srgb_from_linear() -> NDArray[np.uint8]:
    """Return the coded values of 65536 amounts of light, in steps of at most 1/20 coded value."""
    light = np.arange(65536) / 65535
    dark_part = light * 12.92
    bright_part = 1.055 * light ** (1 / 2.4) - 0.055
    return np.rint(np.where(light <= 0.0031308, dark_part, bright_part) * 255).astype(np.uint8)
