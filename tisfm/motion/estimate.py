"""The estimate of a motion model for a pair: unknowns, flow, depth, and status of iterations."""

from dataclasses import dataclass

import numpy as np

from tisfm.kernels.layout.lanes import LaneData, on_host
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, Solution
from tisfm.status import History, Status


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The result of a motion model for a pair, before occlusion and confidence."""

    rho: np.ndarray  # (6, H, W) float32: ρ̂, px/frame
    flow: np.ndarray  # (2, H, W) float32: (u, v), px/frame
    inverse_depth: np.ndarray  # (H, W) float32
    # (7, h, w) float32: as in `tisfm.kernels.solve.data_precision`, on the last level
    precision: np.ndarray
    level: int  # level of the pyramid whose frames decide which of two surfaces is hidden
    normalized: bool  # whether the residual is in squared px
    freedom: int  # {1, 2}: degrees of freedom of a pixel's flow
    history: Records  # list of (level, warp, Iteration)
    status: Status  # ``"converged"`` or ``"iteration_limit"``, or why no estimate was possible
    motions: np.ndarray | None = None  # (K, 6) float64 or None
    labels: np.ndarray | None = None  # (H, W) int32 or None
    inverse_depth_std: np.ndarray | None = None  # (H, W) float32 or None
    deviation_factor: float = 1.0  # factor of the deviations for errors that pixels share
    # whether the first motion came from matched points, as for frames far apart
    uses_matches: bool = False
    # (h, w, 2) float32 or None: flow field that gave the first rigid motion, px of its level; None
    # without depth
    start_flow: np.ndarray | None = None
    start_level: int = 0  # level of the flow field


def no_motion_status(solution: Solution, *, is_textured: bool = True) -> Status | None:
    """Return the status of frames that show no motion, None if they show motion."""
    if not is_textured or not _has_nonzero(solution.system.tensor, 3):
        return Status(
            "no_texture",
            "frame 0 is uniform, so no motion can be seen: check that the frames are images of a "
            "textured scene",
        )
    if not _has_nonzero(solution.unknowns.rho, solution.unknowns.components):
        return Status(
            "no_motion",
            "the frames are equal or differ too little, so no motion is visible: take frames "
            "farther apart in time",
        )
    return None


def _has_nonzero(array: LaneData, components: int) -> bool:
    """Return whether the first components of a lane array have a value other than zero."""
    return any(component.any() for component in on_host(array)[:components])


def iteration_status(
    history: Records, converged: bool, settings: Settings, *, is_adjustable: bool = True
) -> Status:
    """Return the status of the last iterations, whose number the settings set if adjustable."""
    last = history[-1][2]
    if not converged and not is_adjustable:
        return Status(
            "iteration_limit",
            f"depth still changed by {last.change:.1e} of its norm in the last iteration "
            f"(tolerance {settings.tolerance:g}): accept a higher tolerance",
        )
    if settings.pyramid_levels == 1:  # the remaining error stops iterations
        return _remaining_error_status(converged, settings)
    if not converged:
        option = "cycles" if settings.cycles else "sweeps"
        return Status(
            "iteration_limit",
            f"the unknowns still changed by {last.change:.1e} of their norm in the last of "
            f"{settings.outer_iterations} iterations (tolerance {settings.tolerance:g}): raise "
            f"outer_iterations or {option}, or accept a higher tolerance",
        )
    return Status(
        "converged",
        f"the unknowns changed by {last.change:.1e} of their norm in the last iteration",
    )


def _remaining_error_status(converged: bool, settings: Settings) -> Status:
    """Return the status of iterations that an estimate of the remaining error stops."""
    if converged:
        return Status(
            "converged",
            "the estimated distance of the unknowns from the minimum is at most "
            f"{settings.tolerance:g} of their norm",
        )
    faster_advice = "" if settings.cycles else ", set cycles to 1, which takes far fewer iterations"
    return Status(
        "iteration_limit",
        f"after {settings.outer_iterations} iterations the estimated distance of the unknowns from "
        f"the minimum was still above {settings.tolerance:g} of their norm (the tolerance): raise "
        f"outer_iterations{faster_advice}, or accept a higher tolerance",
    )


def history_of(records: Records) -> History:
    """Return records of iterations as arrays."""
    levels, warps, iterations = zip(*records, strict=True) if records else ((), (), ())
    return History(
        level=np.array(levels, np.int32),
        warp=np.array(warps, np.int32),
        **{
            name: np.array([getattr(iteration, name) for iteration in iterations])
            for name in ("energy", "half_quadratic", "change")
        },
    )
