"""Matches that belong to the contour of a nearer surface."""

import numpy as np
import pytest

from bench import reference

OPTIONS = {
    "contour_distance": 5, "surface_distance": 12, "contrast": 3.0, "min_contrast": 4.0,
    "min_step": 0.07, "max_difference": 0.04,
}  # fmt: skip
NEAR, FAR, EDGE = 0.5, 0.3, 30  # inverse depths, and the first column of the farther surface


def found(frame, depth, matches, **changes):
    from tisfm import runtime

    runtime.start()
    from tisfm.kernels.rigid.foreground_fattening import find_fattened

    arrays = [np.ascontiguousarray(array, np.float32) for array in (frame, depth, matches)]
    out = np.full(frame.shape, 7, np.int32)
    find_fattened(*arrays, out, **OPTIONS | changes)
    assert set(np.unique(out)) <= {0, 1}
    return out > 0


@pytest.mark.parametrize("size", [(1, 1), (3, 1), (1, 40), (21, 34), (40, 61)], ids=str)
def test_kernel_is_the_reference(size):
    random = np.random.default_rng(3)
    depth = np.where(random.random(size) < 0.5, NEAR, FAR)
    frame = 60 * (random.random(size) < 0.2) + 0.3 * random.random(size)
    matches = np.where(random.random(size) < 0.6, depth, 0)
    arrays = [np.float32(array) for array in (frame, depth, matches)]
    expected = reference.find_fattened(*(array.astype(float) for array in arrays), **OPTIONS)
    is_found = found(*arrays)
    assert (is_found == expected).mean() > 0.995  # rounding decides between equal values
    if min(size) > 20:
        assert 0.02 < expected.mean() < 0.9


def outline(fattened=5):
    """Return frame, depth and matches: all near, but columns beyond the fattened strip.

    The frame is bare but for the edge between both surfaces.
    """
    columns = np.arange(60) + np.zeros((24, 1))
    frame = np.where(columns < EDGE, 20.0, 90.0)
    depth = np.where(columns < EDGE + fattened, NEAR, FAR)
    return frame, depth, np.where(np.abs(columns - EDGE + 0.5) < 6, depth, 0)


@pytest.mark.parametrize("turn", range(4))
def test_the_fattened_strip_is_found_on_its_side_alone(turn):
    frame, depth, matches = (np.rot90(array, turn) for array in outline())
    columns = np.rot90(np.arange(60) + np.zeros((24, 1)), turn)
    is_strip = (columns >= EDGE) & (columns < EDGE + 5)
    np.testing.assert_array_equal(found(frame, depth, matches), is_strip)


def test_a_slanted_surface_keeps_its_matches():
    frame, _, _ = outline()
    depth = 0.6 - 0.005 * np.arange(60) + np.zeros((24, 1))  # 20 % beyond the edge, linearly
    assert not found(frame, depth, depth).any()


def test_texture_of_one_surface_keeps_its_matches():
    frame, _, matches = outline()
    assert not found(frame, np.full_like(frame, NEAR), np.where(matches > 0, NEAR, 0)).any()


def test_a_textured_farther_surface_keeps_its_matches():
    frame, depth, matches = outline()
    stripes = frame + 40 * (np.arange(60) % 4 < 2)
    assert not found(stripes, depth, matches)[:, EDGE : EDGE + 5].any()


def test_weak_contours_are_noise():
    frame, depth, matches = outline()
    assert not found(0.05 * frame, depth, matches).any()


def test_arrays_are_checked():
    frame, depth, matches = outline()
    with pytest.raises(ValueError, match="inverse_depth"):
        found(frame, depth[:-1], matches)
    with pytest.raises(ValueError, match="surface_distance is 2"):
        found(frame, depth, matches, surface_distance=2)
    from tisfm.kernels.rigid.foreground_fattening import find_fattened

    arrays = [np.float32(array) for array in (frame, depth, matches)]
    with pytest.raises(ValueError, match=r"expected .* int32"):
        find_fattened(*arrays, np.zeros(frame.shape, np.float32), **OPTIONS)
