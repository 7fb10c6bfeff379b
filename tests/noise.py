"""Frames of noise."""

import cv2
import numpy as np


def moving_noise(height, width, motion, *, seed=0):
    """Two windows of one random image, the second displaced by whole pixels.

    Its octaves fall off as those of natural images do: without coarse structure no coarse-to-fine
    method can follow a motion of many pixels.
    """
    dx, dy = motion
    rng = np.random.default_rng(seed)
    margin = 40
    image = np.zeros((height + 2 * margin, width + 2 * margin), np.float32)
    for sigma in (1.5, 3.0, 6.0, 12.0, 24.0):
        octave = cv2.GaussianBlur(rng.normal(size=image.shape).astype(np.float32), (0, 0), sigma)
        image += np.sqrt(sigma) * octave / octave.std()
    image = 128 + 40 * image / image.std()
    window = image[margin : margin + height, margin : margin + width]
    moved = image[margin - dy : margin - dy + height, margin - dx : margin - dx + width]
    return window.copy(), moved.copy()
