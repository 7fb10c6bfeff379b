"""The same bits with one thread and with all: what `bits` of a module of tests returns."""

from importlib import import_module

import pytest

from tests.draws import nightly_except
from tests.one_thread import bits_on_one_thread, several_threads
from tisfm import runtime

MODULES = [
    "tests.fusion.test_mesh",
    "tests.fusion.test_points",
    "tests.motion.test_flow_proposals",
    "tests.solver.test_second_order",
    "tests.test_pair",
]


@several_threads
@pytest.mark.parametrize(
    "module", nightly_except("tests.fusion.test_points", "tests.test_pair", of=MODULES)
)
def test_same_bits_with_one_thread_and_with_all(module):
    runtime.start()
    assert bits_on_one_thread(module) == import_module(module).bits()
    assert runtime.threads() > 1
