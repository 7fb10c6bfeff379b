"""Disagreement with the reference."""

import numpy as np
import pytest

from bench.shared.problems import check, check_quantile, disagreement


def test_disagreement_is_relative_to_each_component():
    expected = np.array([[[100.0, 0.0]], [[0.0, 0.1]]])
    actual = expected.copy()
    actual[1, 0, 0] = 0.01
    assert disagreement(actual, expected) == pytest.approx(0.1)
    assert check(actual, expected, 0.2) == pytest.approx(0.1)


@pytest.mark.parametrize("wrong", [0.5, np.nan, np.inf])
def test_one_wrong_pixel_fails_the_check(wrong):
    expected = np.ones((2, 30, 40))
    actual = expected.copy()
    actual[1, 7, 7] = wrong
    with pytest.raises(AssertionError, match="differs from the reference"):
        check(actual, expected, 1e-3)
    with pytest.raises(AssertionError, match="100% of the pixels"):
        check_quantile(np.abs(actual - expected), 1.0, 1e-3)
