"""A reading of motion: what a solver leaves of a pair, before occlusion and confidence."""

from dataclasses import dataclass

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.interpretation import History, Status
from tisfm.kernels.layout.lanes import aligned_empty, on_host
from tisfm.kernels.model.readout import motion_fields
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import Iteration, Pyramid, Solution, coarse_to_fine
from tisfm.solver.unknowns import LaneData


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What a reading of motion found.

    Attributes
    ----------
    rho : (6, H, W) float32
        ρ̂, px/frame.
    flow : (2, H, W) float32
        (u, v), px/frame.
    inverse_depth : (H, W) float32
    evidence : (7, h, w) float32
        Of `tisfm.kernels.solve.data_precision`; of a field, on the level that it ended on.
    normalized : bool
        Whether its residual is in squared px.
    freedom : {1, 2}
        Along how many directions the image motion of a pixel was free.
    history : list of (level, warp, Iteration)
    status : Status
        ``"converged"`` or ``"iteration_limit"``, or why there is nothing to converge to.
    motions : (K, 6) float64 or None
    labels : (H, W) int32 or None
    inverse_depth_std : (H, W) float32 or None
    """

    rho: np.ndarray
    flow: np.ndarray
    inverse_depth: np.ndarray
    evidence: np.ndarray
    normalized: bool
    freedom: int
    history: list[tuple[int, int, Iteration]]
    status: Status
    motions: np.ndarray | None = None
    labels: np.ndarray | None = None
    inverse_depth_std: np.ndarray | None = None


def field_reading(pyramid: Pyramid, settings: Settings) -> Reading:
    """Leave ρ̂ free at every pixel, as the paper does."""
    solution = coarse_to_fine(
        pyramid,
        settings,
        components=settings.components,
        contrast=settings.contrast_for(pyramid.camera.focal),
        finest=pyramid.last(settings),
    )
    evidence, history = solution.minimiser.evidence(), solution.history
    status = unmoved(solution) or ended(history, solution.converged, settings)
    field = solution.field
    del solution  # the larger part of the memory
    rho = pyramid.images(field, pyramid.last(settings))
    flow, inverse_depth = _motion_fields(rho, pyramid.camera)
    if len(rho) < 6:
        rho = np.concatenate([rho, np.zeros((6 - len(rho), *rho.shape[1:]), np.float32)])
    return Reading(
        rho=rho,
        flow=flow,
        inverse_depth=inverse_depth,
        evidence=evidence,
        normalized=settings.normalization is not None,
        freedom=2,
        history=history,
        status=status,
    )


def _motion_fields(rho: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return flow, (2, H, W), and inverse depth, (H, W), of ρ̂ at the finest level."""
    height, width = rho.shape[1:]
    cx, cy = camera.center_for(height, width)
    x_hat = ((np.arange(width) - cx) / camera.focal).astype(np.float32)
    y_hat = ((np.arange(height) - cy) / camera.focal).astype(np.float32)
    flow, inverse_depth = (aligned_empty((*n, height, width)) for n in ((2,), ()))
    motion_fields(
        rho, x_hat, y_hat, flow, inverse_depth, focal=camera.focal, by_pixel=runtime.on_gpu()
    )
    return flow, inverse_depth


def unmoved(solution: Solution, *, textured: bool = True) -> Status | None:
    """Return the status of frames that show no motion at all, None if they show some."""
    if not textured or not _any(solution.minimiser.tensor, 3):
        return Status(
            "no_texture",
            "the frames are uniform, so no motion can be seen: check that they are images of a "
            "textured scene",
        )
    if not _any(solution.field.rho, solution.field.components):
        return Status(
            "no_motion",
            "the frames do not differ, so there is no motion to interpret: take frames further "
            "apart in time",
        )
    return None


def _any(array: LaneData, components: int) -> bool:
    """Return whether the first components of a lane array are not all zero."""
    return any(component.any() for component in on_host(array)[:components])


def ended(history: list[tuple[int, int, Iteration]], converged: bool, settings: Settings) -> Status:
    """Return how the last iterations ended."""
    last = history[-1][2]
    if not converged:
        return Status(
            "iteration_limit",
            f"the unknowns still changed by {last.change:.1e} of their norm in the last of "
            f"{settings.outer_iterations} iterations (tolerance {settings.tolerance:g}): raise "
            "outer_iterations or sweeps, or accept a higher tolerance",
        )
    return Status(
        "converged",
        f"the unknowns changed by {last.change:.1e} of their norm in the last iteration",
    )


def history_of(records: list[tuple[int, int, Iteration]]) -> History:
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
