"""The choice of parameters leaves out no pair."""

from itertools import combinations, product

import pytest

from tests.pairwise import covering


@pytest.mark.parametrize(
    ("sizes", "ways", "most"),
    [
        ([6, 4, 3], 2, 26),
        ([6, 4, 4, 4, 3, 3], 2, 30),
        ([2, 2, 2, 2], 2, 8),
        ([8, 4, 3, 3, 2, 2], 3, 130),
        ([5], 1, 5),
        ([3, 4], 2, 12),
    ],
)
def test_every_combination_occurs(sizes, ways, most):
    first = covering(sizes, ways - 1) if ways > 1 else []
    rows = covering(sizes, ways)
    assert len(first) <= len(rows)
    check_combinations(rows, sizes, ways)
    check_combinations([*first, *covering(sizes, ways, first)], sizes, ways)
    assert len(rows) <= most
    assert len({tuple(row) for row in rows}) == len(rows)
    assert rows == covering(sizes, ways)


def check_combinations(rows, sizes, ways):
    for columns in combinations(range(len(sizes)), ways):
        found = {tuple(row[column] for column in columns) for row in rows}
        assert found == set(product(*(range(sizes[column]) for column in columns)))
