"""What is timed is every kernel, and agrees with the NumPy reference. No timing."""

import ast
import itertools
import pkgutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from bench.kernels import bench_kernels
from bench.kernels.traffic import TRAFFIC
from bench.kernels.unfused import sweep_unfused
from bench.shared.problems import Problem, check
from tisfm import kernels
from tisfm.runtime import cpu_lanes


def test_every_kernel_has_its_traffic():
    from bench.kernels.bench_kernels import CASES, Operations, References

    assert {case.name for case in CASES} == set(TRAFFIC)
    for case, side in itertools.product(CASES, (Operations, References)):
        assert callable(getattr(side, case.step))


# Not timed: no reference improves or carries displacements of all pixels at once, those of fusion,
# rendering, merging and edges go point by point.
AS_A_WHOLE = {
    "rigid.flow_search",
    "rigid.depth_maps",
    "rigid.depth_votes",
    "rigid.depth_edges",
    "fusion.agreement",
    "fusion.consistency",
    "fusion.distance_field",
}
PARTS = {("data.image_edges", "scale"), ("solve.line_search", "subtract")}


def test_every_public_kernel_is_timed():
    """In its own module: others have kernels of the same name. But what is a part of another."""
    timed = {(case.module, case.kernel) for case in bench_kernels.CASES}
    timed |= {(case.module, case.scheme) for case in bench_kernels.CASES}
    found = set()
    for info in pkgutil.walk_packages(kernels.__path__, "tisfm.kernels."):
        source = Path(find_spec(info.name).origin).read_text(encoding="utf-8")
        tree = ast.parse(source)
        decorated = {
            node.name.removeprefix("_")
            for node in tree.body
            if isinstance(node, ast.FunctionDef)
            and any(getattr(d, "id", "") in ("lane_kernel", "Kernel") for d in node.decorator_list)
        }
        variants = {name for name in decorated if name.endswith(("_sites", "_by_pixel", "_order"))}
        module = info.name.removeprefix("tisfm.kernels.")
        if module not in AS_A_WHOLE:
            found |= {(module, name) for name in decorated - variants}
    assert found - PARTS - timed == set()
    assert found >= PARTS


@pytest.mark.nightly  # `python -m bench --smoke` in .ci/run compares the same cases
@pytest.mark.parametrize(("lanes", "on_device"), [(cpu_lanes(), False), (1, True)])
def test_timed_kernels_agree_with_the_reference(lanes, on_device):
    problem = Problem(23, 34)
    for case in bench_kernels.CASES:
        operations = bench_kernels.Operations(
            problem,
            lanes,
            case.components or 6,
            scheme=case.scheme,
            solver=case.solver,
            on_device=on_device,
        )
        run, read = getattr(operations, case.step)()
        bench_kernels.reference_run(problem, case.without_solver())
        expected = problem.expected[case.without_solver()]
        check(read(run()), expected, case.tolerance(problem))


def test_two_passes_need_more_lanes_than_one():
    problem = Problem(5, 6)
    side = bench_kernels.Operations(problem, 1, 6, scheme="joint")
    with pytest.raises(ValueError, match="1 lane: expected 8 or 16"):
        sweep_unfused(side.system(), side.unknowns.rho, relaxation=1.0, solver="cholesky")


def test_a_pass_for_one_color_spares_lines_of_the_other():
    two_passes = TRAFFIC["sweep_unfused joint"]
    once = TRAFFIC["sweep joint"]
    n = 6
    assert two_passes.bytes_per_pixel(n, 8) == 2 * once.bytes_per_pixel(n, 8) == 2 * 4 * 19
    # Of 16 lanes, each color has lines of its own: of the tensor, and of ρ̂ where it is written.
    assert two_passes.bytes_per_pixel(n, 16) == 4 * (2 * 19 - 5 - n)
