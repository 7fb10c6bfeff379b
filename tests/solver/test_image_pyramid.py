"""Image pyramids: where levels lie, how many there are, and smoothing."""

import numpy as np
import pytest

import tisfm
from tisfm.solver.image_pyramid import (
    COARSEST_FRAME_SIDE,
    ImagePyramid,
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


@pytest.mark.parametrize("masked", [False, True])
def test_the_coarser_levels_are_a_pyramid_of_their_own(masked):
    rng = np.random.default_rng(3)
    frames = rng.uniform(0, 255, (2, 61, 83)).astype(np.float32)
    valid = rng.random((2, 61, 83)) > 0.1
    camera = tisfm.Camera(focal=50.0)
    pyramid = ImagePyramid(
        *frames, camera, factor=0.5, last=1, valid=tuple(valid) if masked else None
    )
    assert pyramid.coarser(0) is pyramid
    coarse = pyramid.coarser(2)
    assert coarse.levels == pyramid.levels - 2 and coarse.last == 0
    assert coarse.shape == pyramid.frames0[2].shape and coarse.scales == [1.0]
    assert coarse.cameras[0] == pyramid.cameras[2]
    assert coarse.contrast != pyramid.contrast
    assert coarse.frames1[0] is pyramid.frames1[2]
    np.testing.assert_array_equal(coarse.spline1(0), pyramid.spline1(2))
    if masked:
        for own, of_all in zip(coarse.valid_on(0), pyramid.valid_on(2), strict=True):
            np.testing.assert_array_equal(own, of_all)
        flow = np.zeros((2, *coarse.shape), np.float32)
        missing = pyramid.masks.ignored_pixels(flow, 2)
        np.testing.assert_array_equal(coarse.masks.ignored_pixels(flow), missing)
    else:
        assert coarse.masks is None
    assert pyramid.levels == len(pyramid.frames0)  # as it was
