"""Inverse depth of one view as several others show it, merged."""

import numpy as np
import pytest

from bench import reference


def merge(inverse_depths, deviations, alike=0.1):
    from tisfm import runtime

    runtime.start()
    from tisfm.kernels.rigid.depth_maps import merge_depths

    shape = inverse_depths.shape[1:]
    out, spread = (np.full(shape, 7, np.float32) for _ in range(2))
    merge_depths(inverse_depths, deviations, out, spread, max_difference=alike)
    return out, spread


def pixels(*values):
    """Return one pixel, (N, 1, 1) float32, as N sources show it."""
    return np.array(values, np.float32)[:, None, None]


@pytest.mark.parametrize("size", [(1, 1), (5, 1), (1, 7), (13, 37)], ids=str)
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_kernel_is_the_reference(size, count):
    random = np.random.default_rng(count)
    shape = count, *size
    depth = np.where(random.random(shape) < 0.5, 0.2, 0.5) * (1 + 0.08 * random.random(shape))
    depth[random.random(shape) < 0.2] = 0
    depth = depth.astype(np.float32)
    deviation = (0.05 * random.random(shape)).astype(np.float32)
    before = depth.copy(), deviation.copy()
    out, spread = merge(depth, deviation)
    expected, its_spread = reference.merge_depths(depth.astype(float), deviation.astype(float), 0.1)
    # Sums of a few products in single precision.
    np.testing.assert_allclose(out, expected, rtol=1e-5)
    np.testing.assert_allclose(spread, its_spread, rtol=1e-5, atol=1e-8)
    np.testing.assert_array_equal(depth, before[0])
    np.testing.assert_array_equal(deviation, before[1])


def test_agreeing_depths_are_averaged_by_precision():
    out, spread = merge(pixels(1.0, 1.05), pixels(0.1, 0.1 * 1.05 / 2))
    np.testing.assert_allclose(out, (1 + 4 * 1.05) / 5, rtol=1e-6)
    np.testing.assert_allclose(spread, (0.1 + 4 * 0.0525) / 5, rtol=1e-6)


def test_two_outvote_one_that_is_as_sure():
    out, _ = merge(pixels(2.0, 1.0, 1.0), pixels(0.2, 0.1, 0.1))
    np.testing.assert_allclose(out, 1, rtol=1e-6)


def test_one_that_is_much_surer_outvotes_two():
    out, spread = merge(pixels(2.0, 1.0, 1.0), pixels(0.02, 0.1, 0.1))
    np.testing.assert_allclose(out, 2, rtol=1e-6)
    np.testing.assert_allclose(spread, 0.02, rtol=1e-6)


def test_pixels_without_depth_have_no_vote():
    out, spread = merge(pixels(0.0, 1.0), pixels(0.0, 0.1))
    assert out == 1 and spread == np.float32(0.1)
    out, spread = merge(pixels(0.0, 0.0), pixels(0.0, 0.0))
    assert out == 0 and spread == 0


def test_how_alike_they_have_to_be_counts():
    values = pixels(1.0, 1.05), pixels(0.05, 0.1)
    assert merge(*values, alike=0.1)[0] > 1
    assert merge(*values, alike=0.02)[0] == 1


def test_wrong_arguments_are_refused():
    depth = np.ones((2, 4, 5), np.float32)
    with pytest.raises(ValueError, match="deviations"):
        merge(depth, np.ones((2, 4, 6), np.float32))
    with pytest.raises(ValueError, match="inverse_depths"):
        merge(depth[0], depth[0])
    with pytest.raises(TypeError, match="inverse_depths"):
        merge(depth.astype(float), depth)
