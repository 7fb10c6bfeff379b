"""Timings of every kernel, and of the step of the NumPy reference that it replaces."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import taichi as ti

from bench import reference
from bench.kernels.multigrid_steps import MultigridOperations, MultigridReferences
from bench.kernels.operations import FieldOperations
from bench.kernels.plane_steps import PlaneOperations, PlaneReferences
from bench.kernels.references import FieldReferences
from bench.kernels.rigid_steps import DepthOperations, DepthReferences
from bench.kernels.second_order_steps import SecondOrderOperations, SecondOrderReferences
from bench.kernels.traffic import TRAFFIC
from bench.shared.problems import ALPHA, RELAXATION, Problem, check
from tisfm import runtime

MODELS = {6: "rigid", 3: "translation"}
# Module → prefix of its kernels' names, because other modules have kernels of the same names.
PREFIXES = {"solve.second_order": "second_order_", "rigid.view_search": "views_"}
DEPTH = 1  # components of the model with inverse depth as the only unknown
SOLVERS = ("cholesky", "closed_form")
EDGES = ("separate", "joint")  # a weight for each component, or one weight for all
SLOW = ("improve",)  # kernels whose reference takes minutes on large images
MAX_SLOW_SIZE = (480, 640)  # px, height and width: larger images skip the slow kernels
LEXICOGRAPHIC_SIZE = (48, 64)  # px: a plain loop in Python is slow

# Relative to the largest value of a component: a few roundings. It is larger for matrices with
# condition numbers of some hundreds, and for residuals, which are differences of much larger
# numbers. `hidden_pixels` has thresholds: rounding decides a few of thousands of pixels.
TOLERANCE = 1e-6
TOLERANCES = {
    "restrict_residual": 1e-5,
    "sweep": 1e-4,
    "sweep_unfused": 1e-4,
    "data_precision": 1e-4,
    "share_of_data": 1e-5,  # determinants are differences of larger numbers
    "update": 1e-4,
    "squared_residual": 1e-4,
    "eliminate_depth": 1e-5,
    "motion_system": 1e-5,  # constraints at a target position in float32
    "hidden_pixels": 1e-2,
    "improve": 1e-4,  # quantiles of costs
}


@dataclass(frozen=True)
class Case:
    """A kernel in one of its variants.

    `module` is the module of the kernel: below `tisfm.kernels`, or with its whole path.
    """

    module: str
    kernel: str
    components: int = 0  # unknowns per pixel; 0 if the kernel has none
    scheme: str = ""
    solver: str = ""

    @property
    def step(self) -> str:
        """Name of the method of both sides: kernel and reference."""
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
        """Whether the kernel works on lane arrays and is compiled for each lane count."""
        return self.kernel not in WITHOUT_LANES

    def __str__(self) -> str:
        return "-".join(filter(None, (self.step, self.scheme, self.model, self.solver)))

    def without_solver(self) -> "Case":
        """Return the case of the reference, which has one solver."""
        return replace(self, solver="")

    def tolerance(self, problem: Problem) -> float:
        if self.kernel in POSITION_TOLERANCES:
            # A position has an error of some 2⁻²⁴ of the width; slopes are half the range per px.
            return POSITION_TOLERANCES[self.kernel] * problem.width * 2.0**-22
        if self.kernel in FLOW_TOLERANCES:
            return FLOW_TOLERANCES[self.kernel] * max(1.0, 1.5 * np.abs(problem.flow).max())
        return TOLERANCES.get(self.kernel, TOLERANCE)

    def label(self, problem: Problem) -> dict:
        size = [problem.height, problem.width]
        return {"kernel": self.name, "size": size, "model": self.model}


# Tolerance of kernels whose weights are differences of numbers as large as ∇I·u, for the flow u, or
# of their squares (`add_frame`).
FLOW_TOLERANCES = {
    "constancy_constraints": TOLERANCE,
    "join": TOLERANCE,
    "add_frame": 10 * TOLERANCE,
}
# Factor of the tolerance for kernels that sample at target positions. Costs also depend on the
# derivatives there.
POSITION_TOLERANCES = {
    "warp": 1,
    "prolong": 1,
    "splat": 1,
    "displacement": 1,
    "matching_cost": 4,
    "score": 4,
    "costs": 4,
}
# Kernels on plain images, or with other vectors than lanes.
WITHOUT_LANES = (
    "splat",
    "hidden_pixels",
    "share_of_data",
    "motion_fields",
    "best_hypothesis",
    "rigid_fields",
    "score",
    "improve",
    "plane_disagreement",
    "costs",
    "find_fattened",
)
# Module → kernels without variants.
PLAIN = {
    "layout.images": ("image_to_lanes", "multiply"),
    "data.warp": ("warp",),
    "data.constraints": ("constancy_constraints",),
    "data.three_frames": ("backward_flow", "join"),
    "data.image_edges": ("image_edges",),
    "data.forward_splatting": ("splat", "hidden_pixels"),
    "solve.data_precision": ("share_of_data",),
    "solve.second_order.relaxation": ("sweep",),
    "solve.second_order.weight_update": ("update",),
    "solve.second_order.coarsening": ("coarsen_system", "restrict_residual", "add_correction"),
    "solve.second_order.line_search": ("plane_energy",),
    "rigid.epipolar": ("displacement", "restrict_to_line"),
    "rigid.motion_system": ("motion_system",),
    "rigid.shared_depth": (
        "add_depth_terms",
        "depth_constraint",
        "squared_residual",
        "add_frame",
        "eliminate_depth",
    ),
    "rigid.plane_sweep": ("matching_cost",),
    "rigid.patch_match": ("score", "improve", "plane_disagreement"),
    "rigid.view_search": ("score", "improve", "costs"),
    "rigid.foreground_fattening": ("find_fattened",),
    "rigid.census": ("census_cost",),
    "rigid.outline_sweep": ("census_transform", "outline_cost"),
    "rigid.weighted_median": ("weighted_median",),
    "rigid.semi_global": ("aggregate", "best_hypothesis"),
    "model.readout": ("rigid_fields",),
}
PER_MODEL = {
    "layout.images": "lanes_to_images",
    "model.readout": "motion_fields",
    "model.rigid_motion": "flow",
    "solve.coarsening": "prolong",
    "solve.data_precision": "data_precision",
}
MULTIGRID = {
    "solve.coarsening": ("relayout", "add_correction"),
    "solve.line_search": ("move_to_minimum",),
}
MULTIGRID_PER_EDGES = {
    "solve.coarsening": ("coarsen_system", "restrict_residual"),
    "solve.line_search": ("plane_energy",),
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
    FieldOperations, MultigridOperations, DepthOperations, SecondOrderOperations, PlaneOperations
):
    """All kernels."""


class References(
    FieldReferences, MultigridReferences, DepthReferences, SecondOrderReferences, PlaneReferences
):
    """All steps of the reference."""


def reference_run(problem, case):
    """Return the call of the reference; its first answer is kept for the checks of the kernels."""
    run = getattr(References(problem, case.components or 6, case.scheme), case.step)()
    if case not in problem.expected:
        problem.expected[case] = np.array(run())
    return run


def skip_minutes(problem, case, full_reference):
    """Skip a case whose reference takes minutes."""
    large = problem.height * problem.width > np.prod(MAX_SLOW_SIZE)
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
        pytest.skip("the kernel is the same for every lane count")
    components = case.components or 6
    operations = Operations(
        problem,
        lanes,
        components,
        scheme=case.scheme,
        solver=case.solver,
        on_device=runtime.runs_on_gpu(),
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
    """Time the plain loop of the reference, rigid model, without a comparison."""
    problem = Problem(*LEXICOGRAPHIC_SIZE)
    arguments = (problem.tensor, problem.motion, problem.weights(6), problem.rho.copy())
    measure(
        lambda: reference.sweep_lexicographic(*arguments, alpha=ALPHA, relaxation=RELAXATION),
        implementation="numpy",
        kernel="sweep_lexicographic",
        size=LEXICOGRAPHIC_SIZE,
        model="rigid",
    )
