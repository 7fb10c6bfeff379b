"""Which of two surfaces a pixel beside their edge shows."""

import numpy as np
import pytest

from bench import reference


def moved(inverse_depth, deviation, middle, frame, similar=10.0):
    from tisfm import runtime

    runtime.start()
    from tisfm.kernels.rigid.depth_edges import align_depth_edges

    out, spread = (np.full(inverse_depth.shape, 7, np.float32) for _ in range(2))
    align_depth_edges(inverse_depth, deviation, middle, frame, out, spread, grey_decay=similar)
    return out, spread


@pytest.mark.parametrize("size", [(1, 1), (5, 1), (1, 7), (13, 37), (30, 21)], ids=str)
def test_kernel_is_the_reference(size):
    random = np.random.default_rng(5)
    depth = np.where(random.random(size) < 0.5, 0.2, 0.5) + 0.01 * random.random(size)
    middle = np.where(random.random(size) < 0.7, 0.3, 0)
    images = depth, 0.05 * random.random(size), middle, 40 * random.random(size)
    given = [image.astype(np.float32) for image in images]
    before = [image.copy() for image in given]
    out = moved(*given)
    expected = reference.align_depth_edges(*(image.astype(float) for image in given), 10.0)
    # Of votes that are equal but for rounding, either may win.
    close = np.isclose(out[0], expected[0], rtol=1e-5)
    assert close.mean() > 0.99
    np.testing.assert_allclose(out[1][close], expected[1][close], rtol=1e-4)
    if min(size) > 1:
        assert (out[0] != given[0]).mean() > 0.1
    for image, kept in zip(given, before, strict=True):
        np.testing.assert_array_equal(image, kept)


def step(at):
    """Return 1 from a column on, and 0.5 before it, (20, 30) float32."""
    return np.where(np.arange(30) < at, 0.5, 1.0).astype(np.float32) + np.zeros((20, 1), np.float32)


@pytest.mark.parametrize("beside", [14, 16])
def test_edges_go_to_those_of_the_frame(beside):
    depth, frame = step(beside), 100 * step(15)
    middle = np.full_like(depth, 0.7)
    out, spread = moved(depth, 0.1 * depth, middle, frame)
    np.testing.assert_allclose(out, step(15), rtol=1e-6)
    np.testing.assert_allclose(spread, 0.1 * step(15), rtol=1e-6)


def test_one_surface_has_no_edges():
    depth, frame = step(14), 100 * step(15)
    out, _ = moved(depth, depth, np.zeros_like(depth), frame)
    np.testing.assert_array_equal(out, depth)


def test_straight_edges_stay_where_the_frame_is_bare():
    depth = step(13)
    out, _ = moved(depth, depth, np.full_like(depth, 0.7), np.full_like(depth, 100))
    np.testing.assert_array_equal(out, depth)


def test_similar_pixels_count():
    depth, frame = step(14), 100 * step(15)
    out, _ = moved(depth, depth, np.full_like(depth, 0.7), frame, similar=1e6)
    np.testing.assert_array_equal(out, depth)


def test_wrong_arguments_are_refused():
    depth = np.ones((4, 5), np.float32)
    with pytest.raises(ValueError, match="frame"):
        moved(depth, depth, depth, np.ones((4, 6), np.float32))
    with pytest.raises(TypeError, match="inverse_depth"):
        moved(depth.astype(float), depth, depth, depth)
