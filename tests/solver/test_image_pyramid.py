"""Image pyramids: where levels lie, how many there are, and smoothing."""

import numpy as np
import pytest

from tisfm.solver.image_pyramid import (
    COARSEST_FRAME_SIDE,
    gaussian_pyramid,
    level_count,
    smooth,
)


@pytest.mark.parametrize("factor", [0.5, 0.73, 0.95])
def test_pyramid_levels_lie_where_they_say(factor):
    """A linear image stays the same linear function of full-resolution coordinates."""
    rows, columns = np.mgrid[:61, :83].astype(np.float32)
    image = 2 * columns + 3 * rows
    for level, small in enumerate(gaussian_pyramid(image, factor, 4)):
        scale = factor**level
        y, x = ((np.indices(small.shape) + 0.5) / scale) - 0.5
        inner = (slice(4, -4), slice(4, -4)) if min(small.shape) > 10 else (slice(3, -3),) * 2
        np.testing.assert_allclose(small[inner], (2 * x + 3 * y)[inner], atol=0.05)


def test_level_count():
    assert level_count(12, 12, 0.5) == 1
    assert level_count(64, 2000, 0.5) == 3
    assert level_count(64, 64, 0.5, 2) == 2
    assert level_count(64, 64, 0.5, 50) == 3
    for factor in (0.5, 0.6, 0.7, 0.8, 0.95):
        image = np.zeros((480, 640), np.float32)
        coarsest = gaussian_pyramid(image, factor, level_count(480, 640, factor))[-1]
        assert min(coarsest.shape) >= COARSEST_FRAME_SIDE - 1
        assert min(coarsest.shape) * factor < COARSEST_FRAME_SIDE + 1


def test_smoothing_keeps_constants_and_reduces_noise():
    noise = np.random.default_rng(0).normal(size=(50, 60)).astype(np.float32)
    assert smooth(noise, 0.0) is noise
    assert smooth(noise, 1.5).std() < 0.3 * noise.std()
    np.testing.assert_allclose(smooth(np.full((20, 20), 7.0, np.float32), 2.0), 7.0, rtol=1e-6)
