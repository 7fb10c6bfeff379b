"""Times of two clocks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.trajectory.paths import PATIENT
from tisfm.trajectory import associate

TIMES = st.lists(st.integers(0, 300), max_size=30, unique=True).map(
    lambda values: np.array(sorted(values)) / 100
)


@PATIENT
@given(first=TIMES, second=TIMES)
def test_matches_are_mutually_nearest(first, second):
    mine, theirs = associate(first, second)
    assert len(set(mine)) == len(mine) == len(set(theirs)) == len(theirs)
    assert (np.diff(mine) > 0).all() and (np.diff(theirs) > 0).all()
    for i, j in zip(mine, theirs, strict=True):
        distance = abs(first[i] - second[j])
        assert distance <= 0.02
        assert distance == pytest.approx(np.abs(second - first[i]).min(), abs=1e-12)
        assert distance == pytest.approx(np.abs(first - second[j]).min(), abs=1e-12)
    # Whatever is as near and has no other as near is in a pair.
    apart = np.abs(first[:, None] - second) if len(first) and len(second) else np.empty((0, 0))
    for i, j in zip(*np.nonzero(apart <= 0.02), strict=True):
        alone = (apart[i] <= 0.02).sum() == 1 and (apart[:, j] <= 0.02).sum() == 1
        assert not alone or (i in mine and j in theirs)


def test_only_the_nearer_of_two_times_is_paired():
    """Both are within the limit of the one time of the other list."""
    assert [pair.tolist() for pair in associate([0.0, 0.012], [0.01])] == [[1], [0]]
    assert [pair.tolist() for pair in associate([0.01], [0.0, 0.012])] == [[0], [1]]


def test_a_limit_and_times_that_do_not_increase():
    mine, theirs = associate([0.0, 1.0, 2.0], [0.5, 1.05], farthest=0.1)
    assert mine.tolist() == [1] and theirs.tolist() == [1]
    assert len(associate([0.0, 1.0, 2.0], [0.5, 1.05])[0]) == 0
    with pytest.raises(ValueError, match=r"times\[1\] is 0.0"):
        associate([0.0, 0.0], [1.0])
