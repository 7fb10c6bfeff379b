"""Fixtures of the motion models."""

import pytest

from tests.motion.one_motion import SIZE
from tests.rendered import static_scene


@pytest.fixture(scope="module")
def small():
    return static_scene("sideways+rotation", *SIZE, seed=2)
