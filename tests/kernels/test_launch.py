"""Kernels bound to their arguments, and launched again and again."""

import subprocess
import sys
import threading

import numpy as np
import pytest

WIDTH = 24


@pytest.fixture
def grid():
    from tisfm.kernels.layout.lanes import LaneGrid

    return LaneGrid(5, WIDTH)


def filled(grid, components, value):
    array = grid.allocate(components)
    array.fill(value)
    return array


def test_a_launch_runs_as_often_as_it_is_called(grid):
    from tisfm.kernels.layout.images import multiply

    factor, array = filled(grid, 1, 3), filled(grid, 2, 1)
    launch = multiply.bind(grid, factor, array)
    assert (array == 1).all()  # binding runs nothing
    for power in (1, 2, 3):
        launch()
        assert (array == 3**power).all()
    factor.fill(2)  # arrays are read as they are
    launch()
    assert (array == 2 * 3**3).all()
    multiply(grid, factor, array)  # a call binds and runs
    assert (array == 4 * 3**3).all()


def test_numbers_are_those_of_the_time_of_binding(grid):
    from tisfm.kernels.model.readout import _motion_fields

    rho = np.ones((3, 4, 5), np.float32)
    x_hat, y_hat = np.zeros(5, np.float32), np.zeros(4, np.float32)
    flow, inverse_depth = np.zeros((2, 4, 5), np.float32), np.zeros((4, 5), np.float32)
    scale = np.array(2.0)
    launch = _motion_fields.bind(rho, x_hat, y_hat, scale, 3, 1, flow, inverse_depth)
    scale[...] = 7
    launch()
    np.testing.assert_allclose(inverse_depth, 2 * np.sqrt(3), rtol=1e-6)


def test_launches_bound_within_others_all_run(grid):
    """What is bound while something else is bound or run is not lost, nor does it disturb."""
    from tisfm.kernels.layout.images import multiply
    from tisfm.kernels.layout.launch import join_launches

    factor, first, second = filled(grid, 1, 2), filled(grid, 1, 1), filled(grid, 1, 1)
    inner = multiply.bind(grid, factor, first)

    def both():
        inner()
        multiply.bind(grid, factor, second)()

    run = join_launches(both, inner, join_launches(inner, multiply.bind(grid, factor, second)))
    for turn in (1, 2, 3):
        run()
        assert (first == 2 ** (3 * turn)).all()
        assert (second == 2 ** (2 * turn)).all()


def test_after_an_error_launches_run_as_before(grid):
    from tisfm.kernels.layout.images import multiply
    from tisfm.kernels.layout.launch import join_launches

    factor, array = filled(grid, 1, 2), filled(grid, 2, 1)
    launch = multiply.bind(grid, factor, array)

    def fail():
        raise RuntimeError("after one launch")

    for power in (1, 2):
        with pytest.raises(RuntimeError, match="after one launch"):
            join_launches(launch, fail)()
        assert (array == 2**power).all()


def test_a_launch_of_another_thread(grid):
    from tisfm.kernels.layout.images import multiply

    factor, array = filled(grid, 1, 2), filled(grid, 2, 2)
    launch = multiply.bind(grid, factor, array)
    thread = threading.Thread(target=launch)
    thread.start()
    thread.join()
    launch()
    assert (array == 8).all()


def test_a_launch_keeps_its_arrays(grid):
    """Their memory is not given to the next array while a launch may write there."""
    from tisfm.kernels.layout.images import multiply
    from tisfm.kernels.layout.lanes import LaneGrid

    large = LaneGrid(100, 200)  # of which blocks are kept
    factor = filled(large, 1, 3)
    launch = multiply.bind(large, factor, filled(large, 1, 1))
    others = [filled(large, 1, 5) for _ in range(4)]
    launch()
    assert all((array == 5).all() for array in others)


@pytest.mark.parametrize("arguments", [(), (None,) * 2, (None,) * 20])
def test_too_many_or_too_few_arguments_are_refused(grid, arguments):
    from tisfm.kernels.layout.images import _multiply

    with pytest.raises(
        TypeError,
        match=f"a kernel got {len(arguments)} arguments: expected 2, factor, out"
        if len(arguments) != 2
        else "factor is NoneType: expected a C-contiguous array of float32",
    ):
        _multiply[8].bind(*arguments)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda array: array.astype(np.float64), "out is float64 of 4 axes: expected"),
        (lambda array: array[0], "out is float32 of 3 axes: expected .* of float32 of 4 axes"),
        (lambda array: array[:, ::2], "out is float32 of 4 axes, not C-contiguous: expected"),
    ],
    ids=["type", "axes", "strides"],
)
def test_arrays_of_another_kind_are_refused_by_the_kernel_itself(grid, change, match):
    from tisfm.kernels.layout.images import _multiply

    factor, array = filled(grid, 1, 2), filled(grid, 2, 1)
    with pytest.raises(TypeError, match=match):
        _multiply[8].bind(factor, change(array))
    _multiply[8](factor, array)  # nothing of it is kept
    assert (array == 2).all()


def test_arguments_are_checked_when_they_are_bound(grid):
    from tisfm.kernels.layout.images import multiply

    with pytest.raises(ValueError, match="factor has 2 components: expected 1 or 6"):
        multiply.bind(grid, grid.allocate(2), grid.allocate(6))
    with pytest.raises(TypeError, match="out is float64"):
        multiply.bind(grid, grid.allocate(1), grid.allocate(2).astype(np.float64))


def test_a_launch_of_a_runtime_that_is_gone_is_refused():
    script = """
import taichi as ti
from tisfm import runtime
runtime.start()
from tisfm.kernels.layout.images import multiply
from tisfm.kernels.layout.lanes import LaneGrid
grid = LaneGrid(5, 24)
factor, array = grid.allocate(1), grid.allocate(2)
factor.fill(2); array.fill(1)
launch = multiply.bind(grid, factor, array)
ti.reset()
runtime.start()
try:
    launch()
except RuntimeError as error:
    assert "bind the launch again" in str(error), error
else:
    raise AssertionError("it ran")
multiply.bind(grid, factor, array)()
assert (array == 2).all()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_taichis_private_names_are_used_in_one_module():
    """Another release needs only that module looked through."""
    import ast
    from pathlib import Path

    import tisfm
    from tisfm import kernels

    private = {"impl", "_primal", "prog", "lang", "launch_kernel", "make_launch_context"}
    found = []
    for folder in (Path(kernels.__file__).parent, Path(tisfm.__file__).parent):
        for path in folder.rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = []
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("taichi"):
                    names = ["impl"]
                elif isinstance(node, ast.Attribute):
                    names = [node.attr]
                if private.intersection(names):
                    found.append(path.name)
    assert set(found) == {"internals.py"}, found
