"""The variance of windows."""

import cv2
import numpy as np
import pytest

from tisfm.motion.window_statistics import window_variance


@pytest.mark.parametrize(("shape", "size"), [((1, 1), 3), ((9, 13), 3), ((20, 17), 11)])
@pytest.mark.parametrize("level", [0.0, 1000.0])
def test_variance_is_that_of_every_window(shape, size, level):
    image = level + np.random.default_rng(0).normal(size=shape)
    image = image.astype(np.float32)
    before = image.copy()
    half = size // 2
    padded = cv2.copyMakeBorder(image, half, half, half, half, cv2.BORDER_REFLECT_101)
    windows = np.lib.stride_tricks.sliding_window_view(padded.astype(float), (size, size))
    expected = windows.var(axis=(2, 3))
    found = window_variance(image, size)
    assert found.dtype == np.float32 and (found >= 0).all()
    # About 10 roundings of the squares, relative to the rest after the mean is subtracted.
    np.testing.assert_allclose(found, expected, atol=1e-5)
    if level == 0:
        means = windows.mean(axis=(2, 3)).astype(np.float32)
        np.testing.assert_allclose(window_variance(image, size, means), expected, atol=1e-5)
    np.testing.assert_array_equal(image, before)
