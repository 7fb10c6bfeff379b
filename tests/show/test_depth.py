"""Depth as grey levels: linear, of one range, and black where there is none."""

import numpy as np
import pytest

from tisfm.show import anaglyph, depth_grey, flow_to_color, inverse_depth_limit


def test_limit_counts_finite_positive_values_only():
    values = np.full((10, 12), np.nan)
    values[0, :4] = [1.0, 2.0, 3.0, 4.0]
    values[1, :5] = [0.0, -7.0, np.inf, -np.inf, np.nan]
    assert inverse_depth_limit(values, 100) == 4.0
    assert inverse_depth_limit(values, 0) == 1.0
    assert inverse_depth_limit(values, 50) == 2.5
    assert inverse_depth_limit(-np.ones((2, 3))) == 0.0
    with pytest.raises(ValueError, match="percentile is 101"):
        inverse_depth_limit(values, 101)


def test_grey_is_linear_in_inverse_depth():
    values = np.array([[0.0, 1.0, 2.0, 4.0, 5.0], [-1.0, np.nan, np.inf, -np.inf, 1e300]])
    assert depth_grey(values, limit=4.0).tolist() == [[0, 64, 128, 255, 255], [0, 0, 0, 0, 255]]


def test_grey_of_a_sequence_shares_one_range():
    first = np.linspace(0.1, 1, 60).reshape(6, 10)
    second = first.copy()
    second[0, 0] = 30.0
    second[-2:] = 9.0  # something near comes into view
    shared = inverse_depth_limit(first)
    unchanged = first == second
    assert np.array_equal(
        depth_grey(first, limit=shared)[unchanged], depth_grey(second, limit=shared)[unchanged]
    )
    assert not np.array_equal(depth_grey(first)[unchanged], depth_grey(second)[unchanged])


def test_grey_without_depth_is_black():
    for values in (np.zeros((3, 4)), np.full((3, 4), np.nan), -np.ones((3, 4))):
        assert not depth_grey(values).any()
    assert not depth_grey(np.ones((3, 4)), limit=0.0).any()


@pytest.mark.parametrize("limit", [-1.0, np.nan, np.inf])
def test_limits_are_checked(limit):
    with pytest.raises(ValueError, match="limit is"):
        depth_grey(np.ones((3, 4)), limit=limit)
    with pytest.raises(ValueError, match="limit is"):
        flow_to_color(np.ones((3, 4, 2)), limit=limit)
    with pytest.raises(ValueError, match="limit is"):
        anaglyph(np.ones((3, 4)), np.ones((3, 4)), limit=limit)
    with pytest.raises(ValueError, match="max_disparity is"):
        anaglyph(np.ones((3, 4)), np.ones((3, 4)), max_disparity=limit)
