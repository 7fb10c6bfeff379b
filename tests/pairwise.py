"""Parameters of a test chosen pairwise."""

from itertools import combinations, product

import pytest


def pairwise(*, ways=2, short=False, **choices):
    """Parametrise a test so that every two values of two parameters meet in some case.

    The product of all choices has far more cases. Nearly all defects depend on one value, or on
    two together. Where code is written out for three together, `ways` is 3. The choice is the same
    in every run. If `short`, every value alone (or every two values, if `ways` is 3) meets in a
    case of the short command; the other cases are nightly.
    """
    values = list(choices.values())
    sizes = [len(each) for each in values]
    first = covering(sizes, ways - 1) if short else []
    cases = [
        tuple(each[i] for each, i in zip(values, row, strict=True))
        for row in [*first, *covering(sizes, ways, first)]
    ]
    if short:
        later = cases[len(first) :]
        cases[len(first) :] = [pytest.param(*case, marks=pytest.mark.nightly) for case in later]
    return pytest.mark.parametrize(list(choices), cases)


def covering(sizes, ways, first=()):
    """Return rows of indices below `sizes` in which all combinations of `ways` columns occur.

    Combinations that occur in the rows `first` are left out.

    Greedily: a row starts from a combination that is missing, and takes in every other column the
    index that adds most of the others.
    """
    missing = {
        tuple(zip(columns, indices, strict=True)): None
        for columns in combinations(range(len(sizes)), ways)
        for indices in product(*(range(sizes[column]) for column in columns))
    }
    for row in first:
        for combination in combinations(enumerate(row), ways):
            missing.pop(combination, None)
    rows = []
    while missing:
        row = dict(next(iter(missing)))
        for column in sorted(set(range(len(sizes))) - set(row), key=lambda k: -sizes[k]):
            found = [
                sum(
                    tuple(sorted([*others, (column, index)])) in missing
                    for others in combinations(row.items(), ways - 1)
                )
                for index in range(sizes[column])
            ]
            # Where it makes no difference, columns take turns.
            row[column] = max(
                range(sizes[column]), key=lambda k: (found[k], (k - len(rows)) % sizes[column])
            )
        for combination in combinations(sorted(row.items()), ways):
            missing.pop(combination, None)
        rows.append([row[column] for column in range(len(sizes))])
    return rows
