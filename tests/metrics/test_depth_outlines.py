"""Pixels near outlines of a true depth, and errors of depth over a region."""

import numpy as np
import pytest

from tisfm.errors import InputError
from tisfm.metrics import limited_error, outlines, outlines_of_blurred_depth, region_errors

STEP = np.where(np.arange(40) < 20, 2.0, 3.0) * np.ones((30, 1))


def test_a_jump_is_found_along_rows_and_along_columns():
    expected = np.abs(np.arange(40) - 19.5) < 9
    assert (outlines(STEP) == expected).all()
    assert (outlines(STEP.T) == expected[:, None]).all()


def test_a_jump_below_a_tenth_is_no_outline():
    assert not outlines(np.where(STEP > 2.5, 2.15, 2.0)).any()


def test_a_steep_plane_is_no_outline():
    inverse = 0.05 + 0.02 * np.arange(40) * np.ones((30, 1))  # up to 40 % from pixel to pixel
    assert not outlines(1 / inverse).any()


def test_unknown_depth_is_no_outline_and_never_near_one():
    truth = STEP.copy()
    truth[:, 19] = np.nan
    truth[:, 20] = 0.0
    assert not outlines(truth).any()
    truth = STEP.copy()
    truth[3, 15] = np.nan
    assert not outlines(truth)[3, 15]
    assert outlines(truth)[3, 14]


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_small_maps_have_no_outlines(shape):
    assert not outlines(np.full(shape, 2.0)).any()
    assert not outlines_of_blurred_depth(np.full(shape, 2.0)).any()


def test_a_blurred_jump_is_found_in_larger_squares():
    blurred = 1 / np.interp(np.arange(60), [26, 34], [0.5, 0.3]) * np.ones((30, 1))
    assert not outlines(blurred).any()
    assert outlines_of_blurred_depth(blurred)[:, 26:35].all()
    assert not outlines_of_blurred_depth(blurred)[:, :20].any()


def test_errors_of_a_region():
    inverse = 1 / STEP
    inverse[:, 20:] /= 1.2
    region = np.zeros(STEP.shape, bool)
    region[:, 10:30] = True
    errors = region_errors(inverse, STEP, region)
    assert errors.error == pytest.approx(0.1)
    assert errors.wrong == pytest.approx(0.5)
    everywhere = region_errors(inverse, STEP, np.ones(STEP.shape, bool))
    assert everywhere.error == pytest.approx(limited_error(inverse, STEP))


def test_a_region_without_truth_has_no_errors_and_sizes_are_checked():
    truth = STEP.copy()
    truth[:5] = np.nan
    region = np.zeros(STEP.shape, bool)
    region[:5] = True
    assert region_errors(1 / STEP, truth, region) is None
    with pytest.raises(InputError, match="region is"):
        region_errors(1 / STEP, STEP, np.ones((3, 3), bool))
    with pytest.raises(InputError, match="expected \\(H, W\\)"):
        outlines(np.ones(5))
    with pytest.raises(InputError, match="expected \\(H, W\\)"):
        outlines_of_blurred_depth(np.ones(5))
