"""How colours look without one kind of cone, and how far they are from one another."""

import cv2
import numpy as np

# Linear RGB as it looks with full severity. G. M. Machado, M. M. Oliveira and L. A. F. Fernandes,
# "A physiologically-based model for simulation of color vision deficiency", IEEE Transactions on
# Visualization and Computer Graphics 15 (2009) 1291-1298, doi:10.1109/TVCG.2009.113, the tables
# that accompany it.
_MATRICES = {
    "usual": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
VISIONS = tuple(_MATRICES)


def seen(colors, vision):
    """Return how uint8 colours, (N, 3), look: L* a* b*, in which 2 is just told apart."""
    coded = np.asarray(colors) / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ _MATRICES[vision].T, 0, 1)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(shown.astype(np.float32)[None], cv2.COLOR_RGB2LAB)[0].astype(float)


def distances(colors, others, vision):
    """Return how far each colour is from each other, (N, M)."""
    return np.linalg.norm(seen(colors, vision)[:, None] - seen(others, vision)[None], axis=-1)
