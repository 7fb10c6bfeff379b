"""Parameters of a test chosen pairwise."""

import pytest
from allpairspy import AllPairs


def pairwise(**choices):
    """Parametrise a test so that every two values of two parameters meet in some case.

    The product of all choices has far more cases. Nearly all defects depend on one value, or on
    two together. The choice is the same in every run.
    """
    cases = [tuple(case) for case in AllPairs(list(choices.values()))]
    return pytest.mark.parametrize(list(choices), cases)
