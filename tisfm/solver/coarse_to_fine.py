"""Coarse-to-fine estimation: a large motion is small on a coarse level of the pyramid.

ρ̂ are the unknowns of a pixel, such as the components of its motion, in px/frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.runtime import lane_grid
from tisfm.solver.data_term import Constancy, DataTerm
from tisfm.solver.half_quadratic import Effort, HalfQuadratic, Iteration
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.sampling import enlarge
from tisfm.solver.smoothness import Smoothness, image_driven_factor
from tisfm.solver.three_frames import ThreeFrameData
from tisfm.solver.unknowns import Unknowns

Records = list[tuple[int, int, Iteration]]  # level, warp and record of each iteration


@dataclass(frozen=True, kw_only=True)
class Problem:
    """The unknowns of every pixel and the energy to minimise."""

    constancy: Constancy
    smoothness: Smoothness  # its stiffness has a value for each unknown: 6, 3, 2 or 1
    effort: Effort
    # takes the number of finer levels that follow a level; returns the number of linearisations on
    # this level
    warps: Callable[[int], int]

    @property
    def components(self) -> int:
        """Unknowns per pixel."""
        return len(self.smoothness.stiffness)


class LevelChange(Protocol):
    """A change of the unknowns between the levels of the pyramid."""

    level: int  # the level for `apply`, which is called after half of the level's linearisations

    def apply(self, unknowns: Unknowns) -> bool:
        """Change the unknowns; return whether they changed, so that the level needs more warps."""

    def change_finer_level(self, unknowns: Unknowns, level: int) -> None:
        """Change the unknowns of a finer level before its first linearisation."""


class AdditionalData(Protocol):
    """Additional data for the last level, used after half of the level's linearisations."""

    def joint_data_term(self, unknowns: Unknowns, data_term: DataTerm) -> ThreeFrameData | None:
        """Return a data term that overwrites the constraints of `data_term`, or None to keep it.

        The unknowns may be changed.
        """


@dataclass(frozen=True, kw_only=True)
class Solution:
    """The result of coarse-to-fine estimation, on its last level."""

    unknowns: Unknowns  # ρ̂, px/frame
    system: LinearSystem  # the system with the weights of edges of the last iteration
    level: int
    # list of (level, warp, Iteration): all half-quadratic iterations; level 0 is the finest
    history: Records
    converged: bool  # whether the iterations of the last warp converged


def coarse_to_fine(
    pyramid: ImagePyramid,
    problem: Problem,
    *,
    last: int = 0,  # the last level to compute
    release: bool = False,  # whether to free the splines of every level above the last after use
    level_change: LevelChange | None = None,
    additional_data: AdditionalData | None = None,
) -> Solution:
    """Estimate ρ̂ from the coarsest level to the last, starting at zero."""
    history: Records = []
    unknowns: Unknowns | None = None
    solution: Solution | None = None
    for level in reversed(range(last, pyramid.levels)):
        solution = None  # frees the previous level: only its unknowns are needed
        unknowns = unknowns_on(pyramid, level, problem, unknowns)
        change = None
        if level_change is not None and level < level_change.level:
            level_change.change_finer_level(unknowns, level)
        elif level_change is not None and level == level_change.level:
            change = level_change.apply
        solution = _estimate_level(
            pyramid,
            problem,
            unknowns,
            level,
            problem.warps(level - last),
            history,
            change,
            additional_data if level == last else None,
        )
        if release and level > last:
            pyramid.release_spline1(level)
    assert solution is not None
    return solution


def unknowns_on(
    pyramid: ImagePyramid, level: int, problem: Problem, coarse: Unknowns | None = None
) -> Unknowns:
    """Return the unknowns of a level, interpolated from the next coarser level or zero."""
    frame0 = pyramid.frames0[level]
    grid = lane_grid(*frame0.shape)
    unknowns = Unknowns(grid, pyramid.cameras[level], problem.components)
    if coarse is not None:
        unknowns.start_from(coarse, pyramid.factor)
    if problem.smoothness.image_edges > 0:
        strength = problem.smoothness.image_edges
        valid = pyramid.valid0(level)
        unknowns.edges = image_driven_factor(grid, frame0, strength, valid)
    return unknowns


def data_term_on(
    pyramid: ImagePyramid, level: int, problem: Problem, unknowns: Unknowns
) -> DataTerm:
    """Return the data term of a level."""
    return DataTerm(
        unknowns.grid,
        pyramid.frames0[level],
        pyramid.frames1[level],
        pyramid.spline1(level),
        problem.constancy,
        pyramid.contrast,
        pyramid.valid_on(level),
    )


def minimiser_on(problem: Problem, unknowns: Unknowns, data_term: DataTerm) -> HalfQuadratic:
    """Return the minimiser of the unknowns of a level under its data term."""
    return HalfQuadratic(
        unknowns,
        data_term.constraints,
        scales=data_term.scales,
        smoothness=problem.smoothness,
        effort=problem.effort,
    )


def resize_to_finest(pyramid: ImagePyramid, unknowns: Unknowns, level: int) -> np.ndarray:
    """Return the unknowns of a level at the finest pixels, (components, H, W) float32."""
    if level == 0:
        return unknowns.images()
    if pyramid.factor != 0.5:
        fine = Unknowns(lane_grid(*pyramid.shape), pyramid.cameras[0], unknowns.components)
        fine.start_from(unknowns, pyramid.scales[level])
        return fine.images()
    return enlarge(2**level * unknowns.images(), 2**level, *pyramid.shape)


def _estimate_level(
    pyramid: ImagePyramid,
    problem: Problem,
    unknowns: Unknowns,
    level: int,
    warps: int,  # number of linearisations
    history: Records,
    change: Callable[[Unknowns], bool] | None = None,
    additional_data: AdditionalData | None = None,
) -> Solution:
    """Estimate ρ̂ on one level from the present ρ̂, and append iterations to the history."""
    data_term = data_term_on(pyramid, level, problem, unknowns)
    minimiser = minimiser_on(problem, unknowns, data_term)
    flow = unknowns.grid.allocate(2, zeros=False)
    compute_flow = unknowns.bind_flow(flow)
    linearise = data_term.bind_linearise(flow, minimiser.system.tensor)
    half_warps, warp, is_changed, joint_data = (warps + 1) // 2, 0, True, None
    joint_warp = half_warps
    while warp < warps:
        compute_flow()
        linearise()  # also writes the tensor for this flow
        if is_changed:
            minimiser.update()
        iterations, converged = minimiser.minimise()
        history += [(level, warp, iteration) for iteration in iterations]
        warp += 1
        is_changed = change is not None and warp == half_warps and change(unknowns)
        if is_changed:
            warps, joint_warp = warps + half_warps, joint_warp + half_warps
        if additional_data is not None and warp == joint_warp:
            joint_data = additional_data.joint_data_term(unknowns, data_term)
            if joint_data is not None:
                linearise = joint_data.bind_linearise(flow, minimiser.system.tensor)
                warps, is_changed = max(warps, warp + 1), True
    if joint_data is not None:  # new data need more iterations, which cost less than linearisations
        iterations, converged = minimiser.minimise()
        history += [(level, warp - 1, iteration) for iteration in iterations]
    return Solution(
        unknowns=unknowns,
        system=minimiser.system,
        level=level,
        history=history,
        converged=converged,
    )
