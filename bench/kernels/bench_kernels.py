"""Every kernel, and the step of the NumPy reference that it replaces."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import taichi as ti

from bench import reference
from bench.kernels.multigrid_steps import MultigridOperations, MultigridReferences
from bench.kernels.operations import FieldOperations
from bench.kernels.plane_steps import (
    PlaneOperations,
    PlaneReferences,
    ViewOperations,
    ViewReferences,
)
from bench.kernels.references import FieldReferences
from bench.kernels.rigid_steps import DepthOperations, DepthReferences
from bench.kernels.second_order_steps import SecondOrderOperations, SecondOrderReferences
from bench.kernels.traffic import TRAFFIC
from bench.shared.problems import ALPHA, RELAXATION, Problem, check
from tisfm import runtime

MODELS = {6: "rigid", 3: "translation"}
# Kernels that share their names with others are called after these.
PREFIXES = {"solve.second_order": "second_order_", "rigid.view_search": "views_"}
DEPTH = 1  # unknown per pixel, along an epipolar line
SOLVERS = ("cholesky", "closed_form")
EDGES = ("separate", "joint")  # for each component, or for all
SLOW, LARGEST_OF_SLOW = ("improve",), (480, 640)  # a dozen costs of planes of the reference
LEXICOGRAPHIC_SIZE = (48, 64)  # one pixel at a time in Python: a larger image takes its time

# Of the largest value of a component. A few roundings; more where B has condition numbers of some
# hundreds, and where a residual is the difference of much larger numbers. `defeated` decides by
# thresholds, and some pixels of thousands lie so near one that rounding decides.
TOLERANCE = 1e-6
TOLERANCES = {
    "restrict_residual": 1e-5,
    "sweep": 1e-4,
    "sweep_unfused": 1e-4,
    "data_precision": 1e-4,
    "share_of_data": 1e-5,  # of determinants, which are such differences
    "update": 1e-4,
    "squared_residual": 1e-4,
    "answered": 1e-5,
    "motion_system": 1e-5,  # of constraints where a pixel goes, in float32
    "defeated": 1e-2,
    "improve": 1e-4,  # of quantiles of costs
}


@dataclass(frozen=True)
class Case:
    """A kernel in one of its variants.

    `module` is where the kernel is: below `tisfm.kernels`, or with its whole path.
    """

    module: str
    kernel: str
    components: int = 0  # unknowns per pixel; 0 where they do not matter
    scheme: str = ""
    solver: str = ""

    @property
    def step(self) -> str:
        """Name of the method of both sides."""
        prefixes = (PREFIXES[start] for start in PREFIXES if self.module.startswith(start))
        return next(prefixes, "") + self.kernel

    @property
    def name(self) -> str:
        return f"{self.step} {self.scheme}".strip()

    @property
    def model(self) -> str:
        return {**MODELS, DEPTH: "depth"}.get(self.components, "")

    @property
    def in_lanes(self) -> bool:
        """Whether the kernel works on lane arrays, and is another for each lane count."""
        return self.kernel not in WITHOUT_LANES

    def __str__(self) -> str:
        return "-".join(filter(None, (self.step, self.scheme, self.model, self.solver)))

    def without_solver(self) -> "Case":
        """Return the case of the reference, which has one solver."""
        return replace(self, solver="")

    def tolerance(self, problem: Problem) -> float:
        if self.kernel in AT_PLACES:
            # A position is off by some 2⁻²⁴ of the width, times slopes of half the range a pixel.
            return AT_PLACES[self.kernel] * problem.width * 2.0**-22
        if self.kernel in OF_FLOW:
            return OF_FLOW[self.kernel] * max(1.0, 1.5 * np.abs(problem.flow).max())
        return TOLERANCES.get(self.kernel, TOLERANCE)

    def label(self, problem: Problem) -> dict:
        size = [problem.height, problem.width]
        return {"kernel": self.name, "size": size, "model": self.model}


# Whose weights are of differences of numbers as large as ∇I·u, or (the last) of such numbers
# squared, where u is how far pixels go.
OF_FLOW = {"constancy_constraints": TOLERANCE, "join": TOLERANCE, "add_frame": 10 * TOLERANCE}
# Whose answers depend on where a pixel goes; costs, on derivatives that change as steeply again.
AT_PLACES = {
    "warp": 1,
    "prolong": 1,
    "splat": 1,
    "displacement": 1,
    "matching_cost": 4,
    "score": 4,
    "costs": 4,
}
# On plain images, or vectors of their own.
WITHOUT_LANES = (
    "splat",
    "defeated",
    "share_of_data",
    "motion_fields",
    "cheapest",
    "rigid_fields",
    "score",
    "improve",
    "disagreement",
    "costs",
)
# Of every module.
PLAIN = {
    "layout.images": ("image_to_lanes", "multiply"),
    "data.warp": ("warp",),
    "data.constraints": ("constancy_constraints",),
    "data.both_neighbours": ("backward_flow", "join"),
    "data.image_edges": ("image_edges",),
    "data.forward_splatting": ("splat", "defeated"),
    "solve.data_precision": ("share_of_data",),
    "solve.second_order.relaxation": ("sweep",),
    "solve.second_order.weight_update": ("update",),
    "solve.second_order.coarsening": ("coarsen_system", "restrict_residual", "correct"),
    "solve.second_order.line_search": ("plane",),
    "rigid.epipolar": ("displacement", "along"),
    "rigid.several_frames": ("add_along", "as_constraint"),
    "rigid.motion_system": ("motion_system",),
    "rigid.shared_depth": ("squared_residual", "add_frame", "answered"),
    "rigid.plane_sweep": ("matching_cost",),
    "rigid.patch_match": ("score", "improve", "disagreement"),
    "rigid.view_search": ("score", "improve", "costs"),
    "rigid.semi_global": ("aggregate", "cheapest"),
    "model.readout": ("rigid_fields",),
}
PER_MODEL = {
    "layout.images": "lanes_to_images",
    "model.readout": "motion_fields",
    "model.flow": "flow",
    "solve.prolongation": "prolong",
    "solve.data_precision": "data_precision",
}
MULTIGRID = {"solve.coarsening": ("relayout", "correct"), "solve.line_search": ("descend",)}
MULTIGRID_PER_EDGES = {
    "solve.coarsening": ("coarsen_system", "restrict_residual"),
    "solve.line_search": ("plane",),
}
CASES = [
    *(Case(module, kernel) for module, kernels in PLAIN.items() for kernel in kernels),
    *(Case("data.derivatives", "derivatives", scheme=scheme) for scheme in ("cube", "five_tap")),
    *(
        Case(module, kernel, components)
        for module, kernel in PER_MODEL.items()
        for components in MODELS
    ),
    *(
        Case("solve.relaxation", "sweep", components, scheme=scheme, solver=solver)
        for components in MODELS
        for scheme in EDGES
        for solver in SOLVERS
    ),
    Case("solve.relaxation", "sweep", DEPTH, scheme="line", solver="closed_form"),
    Case("bench.kernels.unfused", "sweep_unfused", 6, scheme="joint", solver="closed_form"),
    *(
        Case("solve.weight_update", "update", components, scheme=scheme)
        for components in MODELS
        for scheme in EDGES
    ),
    Case("solve.weight_update", "update", DEPTH, scheme="line"),
    *(Case(module, kernel, 6) for module, kernels in MULTIGRID.items() for kernel in kernels),
    *(
        Case(module, kernel, 6, scheme=scheme)
        for module, kernels in MULTIGRID_PER_EDGES.items()
        for kernel in kernels
        for scheme in EDGES
    ),
]
REFERENCE_CASES = list(dict.fromkeys(case.without_solver() for case in CASES))


class Operations(
    FieldOperations,
    MultigridOperations,
    DepthOperations,
    SecondOrderOperations,
    PlaneOperations,
    ViewOperations,
):
    """All kernels."""


class References(
    FieldReferences,
    MultigridReferences,
    DepthReferences,
    SecondOrderReferences,
    PlaneReferences,
    ViewReferences,
):
    """What they stand beside."""


def reference_run(problem, case):
    """Return the reference's call; its first answer is kept for the checks of the kernels."""
    run = getattr(References(problem, case.components or 6, case.scheme), case.step)()
    if case not in problem.expected:
        problem.expected[case] = np.array(run())
    return run


def skip_minutes(problem, case, full_reference):
    """Skip a case whose reference takes minutes."""
    large = problem.height * problem.width > np.prod(LARGEST_OF_SLOW)
    if case.kernel in SLOW and large and not full_reference:
        pytest.skip("the reference takes minutes at this size: --full-reference runs it")


@pytest.mark.parametrize("case", REFERENCE_CASES, ids=str)
def bench_numpy(problem, case, measure, full_reference):
    skip_minutes(problem, case, full_reference)
    run = reference_run(problem, case)
    measure(run, implementation="numpy", **case.label(problem))


@pytest.mark.parametrize("case", CASES, ids=str)
def bench_taichi(problem, case, lanes, measure, pytestconfig, full_reference):
    skip_minutes(problem, case, full_reference)
    if not case.in_lanes and str(lanes) != pytestconfig.getoption("lanes").split(",")[0]:
        pytest.skip("it is the same kernel for every lane count")
    components = case.components or 6
    operations = Operations(
        problem,
        lanes,
        components,
        scheme=case.scheme,
        solver=case.solver,
        on_device=runtime.on_gpu(),
    )
    run, read = getattr(operations, case.step)()
    reference_case = case.without_solver()
    if reference_case not in problem.expected:
        reference_run(problem, reference_case)
    expected = problem.expected[reference_case]
    error = check(read(run()), expected, case.tolerance(problem))

    def call():
        run()
        ti.sync()

    measure(
        call,
        implementation="taichi",
        lanes=lanes if case.in_lanes else 0,
        solver=case.solver,
        bytes_per_pixel=TRAFFIC[case.name].bytes_per_pixel(components, lanes),
        disagreement=error,
        **case.label(problem),
    )


def bench_sweep_lexicographic(measure):
    """Time the reference's plain loop, rigid model: quoted, compared with nothing."""
    problem = Problem(*LEXICOGRAPHIC_SIZE)
    arguments = (problem.tensor, problem.motion, problem.weights(6), problem.rho.copy())
    measure(
        lambda: reference.sweep_lexicographic(*arguments, alpha=ALPHA, relaxation=RELAXATION),
        implementation="numpy",
        kernel="sweep_lexicographic",
        size=LEXICOGRAPHIC_SIZE,
        model="rigid",
    )
