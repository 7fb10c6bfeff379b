"""The transfer curve of sRGB: coded values, as pictures have them, and amounts of light.

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
    coded = np.arange(256) / 255
    low = coded / 12.92
    high = ((coded + 0.055) / 1.055) ** 2.4
    return np.where(coded <= 0.04045, low, high).astype(np.float32)


@functools.cache
def srgb_from_linear() -> NDArray[np.uint8]:
    """Return the coded value of 65536 amounts of light: a step is 1/20 of a code at the darkest."""
    light = np.arange(65536) / 65535
    low = light * 12.92
    high = 1.055 * light ** (1 / 2.4) - 0.055
    return np.rint(np.where(light <= 0.0031308, low, high) * 255).astype(np.uint8)
