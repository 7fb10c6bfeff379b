"""Depth of one motion that is joined of two solutions."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.motion.rigid_depth import RigidSolution


@dataclass(frozen=True, kw_only=True)
class JoinedSolution(RigidSolution):
    """A rigid solution whose deviation of depth is known, because its parts were made apart."""

    known_deviation: np.ndarray  # (H, W) float32: standard deviation of D

    def deviation(self) -> np.ndarray:
        """Return the standard deviation of D, (H, W) float32."""
        return self.known_deviation.copy()


def join_solutions(
    solution: RigidSolution,
    other: RigidSolution,
    is_other: np.ndarray,  # (H, W) bool: pixels that get the depth of the other solution
    *,
    motions: np.ndarray,  # (K, 3, 4) array: R and t of the joined solution
    status_of: RigidSolution,  # the solution whose iterations give the status
) -> JoinedSolution:
    """Return a solution with the depth of two solutions, on the level of the first."""
    size = solution.precision.shape[:0:-1]
    is_coarse_other = (
        cv2.resize(is_other.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    )
    first = other if status_of is solution else solution
    return JoinedSolution(
        motions=motions,
        inverse_depth=np.where(is_other, other.inverse_depth, solution.inverse_depth),
        precision=np.where(is_coarse_other, _resize_precision(other, solution), solution.precision),
        level=solution.level,
        density=solution.density,
        history=first.history + status_of.history,
        converged=status_of.converged,
        is_limit_adjustable=status_of.is_limit_adjustable,
        known_deviation=np.where(is_other, other.deviation(), solution.deviation()),
    )


def _resize_precision(solution: RigidSolution, target: RigidSolution) -> np.ndarray:
    """Return the precision of a solution on the level of `target`, (7, h, w) float32."""
    if solution.level == target.level:
        return solution.precision
    size = target.precision.shape[:0:-1]
    ratio = np.float32((solution.density / target.density) ** 2)  # ratio of px² of both levels
    units = (ratio, ratio, ratio, 1 / ratio, 1 / ratio, 1 / ratio, 1 / ratio)
    channels = zip(solution.precision, units, strict=True)
    return np.stack([cv2.resize(channel, size) * unit for channel, unit in channels])
