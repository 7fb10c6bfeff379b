"""Kernels launched again with the arguments of before."""

import threading

import numpy as np
import pytest

WIDTH = 24


@pytest.fixture
def grid():
    from tisfm.kernels.layout.lanes import LaneGrid

    return LaneGrid(5, WIDTH)


def test_a_replay_launches_what_was_launched(grid):
    from tisfm.kernels.layout.images import multiply
    from tisfm.kernels.layout.launch import Replay

    factor, array, calls = grid.allocate(1), grid.allocate(2), []
    factor.fill(3)
    array.fill(1)

    def triple():
        calls.append(1)
        multiply(grid, factor, array)
        multiply(grid, factor, array)
        return "result"

    replay = Replay(triple)
    for power in (2, 4, 6):
        assert replay() == "result"
        assert (array == 3**power).all()
    assert calls == [1]
    factor.fill(2)  # arrays are read as they are
    replay()
    assert (array == 4 * 3**6).all()


def test_nothing_is_recorded_after_an_error(grid):
    from tisfm.kernels.layout import launch
    from tisfm.kernels.layout.images import multiply
    from tisfm.kernels.layout.launch import Replay

    factor, array = grid.allocate(1), grid.allocate(2)
    factor.fill(2)
    array.fill(1)

    def fail():
        multiply(grid, factor, array)
        raise RuntimeError("after one launch")

    replay = Replay(fail)
    for power in (1, 2):
        with pytest.raises(RuntimeError, match="after one launch"):
            replay()
        assert launch._recording.launches is None
        assert (array == 2**power).all()


def test_other_threads_are_not_recorded(grid):
    from tisfm.kernels.layout.images import multiply
    from tisfm.kernels.layout.launch import Replay

    factor, array, other = grid.allocate(1), grid.allocate(2), grid.allocate(2)
    for a in (factor, array, other):
        a.fill(2)

    def here():
        thread = threading.Thread(target=multiply, args=(grid, factor, other))
        thread.start()
        thread.join()
        multiply(grid, factor, array)

    replay = Replay(here)
    replay()
    replay()
    assert (array == 8).all() and (other == 4).all()


def test_on_a_device_the_function_is_called(grid):
    from tisfm.kernels.layout.launch import Replay

    calls = []
    replay = Replay(lambda: calls.append(1) or len(calls), on_device=True)
    assert [replay(), replay()] == [1, 2]


def test_the_answer_is_that_of_calls():
    """Levels of a pyramid replay their linearisations: the answer is that of calling them."""
    import tisfm
    from tisfm.solver import image_pyramid

    class Calls:
        def __init__(self, function, *, on_device):
            self.function = function

        def __call__(self):
            return self.function()

    frames = np.random.default_rng(0).integers(0, 255, (2, 60, 90), dtype=np.uint8)
    expected = tisfm.interpret(*frames)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(image_pyramid, "Replay", Calls)
        found = tisfm.interpret(*frames)
    np.testing.assert_array_equal(found.rho, expected.rho)
