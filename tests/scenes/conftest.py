"""Fixtures of the scenes."""

import pytest

from tests import rendered
from tisfm.scenes import STATIC_KINDS


@pytest.fixture(scope="module")
def pairs():
    made = {kind: rendered.static_scene(kind) for kind in STATIC_KINDS}
    made["two_blocks"] = rendered.two_blocks()
    return made
