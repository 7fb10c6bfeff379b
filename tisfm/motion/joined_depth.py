"""Depth that is joined from two solutions, for one or several motions."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.motion.rigid_depth import RigidSolution


@dataclass(frozen=True, kw_only=True)
class SolutionWithDeviation(RigidSolution):
    """A rigid solution whose deviation of depth is not that of a single linear problem."""

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
    other_deviation: np.ndarray | None = None,  # (H, W) float32; by default that of `other`
    status_from_other: bool,  # whether the iterations of `other` give the status
) -> SolutionWithDeviation:
    """Return a solution with the depth of two solutions, on the level of the first."""
    size = solution.precision.shape[:0:-1]
    is_coarse_other = (
        cv2.resize(is_other.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    )
    first, last = (solution, other) if status_from_other else (other, solution)
    if other_deviation is None:
        other_deviation = other.deviation()
    return SolutionWithDeviation(
        motions=motions,
        inverse_depth=np.where(is_other, other.inverse_depth, solution.inverse_depth),
        precision=np.where(is_coarse_other, _resize_precision(other, solution), solution.precision),
        level=solution.level,
        density=solution.density,
        history=first.history + last.history,
        converged=last.converged,
        is_limit_adjustable=last.is_limit_adjustable,
        known_deviation=np.where(is_other, other_deviation, solution.deviation()),
    )


def rescale(solution: RigidSolution, factor: float) -> RigidSolution:
    """Return a solution of one motion in another unit: D times a factor, t divided by it."""
    if factor == 1:
        return solution
    motions = solution.motions.copy()
    motions[:, :, 3] /= factor
    # D has the precision J, the residual is of the images, and M is a covariance of D.
    units = np.array([factor**-2] * 3 + [1] + [factor**2] * 3, np.float32)
    values = {
        "motions": motions,
        "inverse_depth": solution.inverse_depth * np.float32(factor),
        "precision": solution.precision * units[:, None, None],
    }
    if isinstance(solution, SolutionWithDeviation):
        values["known_deviation"] = solution.known_deviation * np.float32(factor)
    return replace(solution, **values)


def _resize_precision(solution: RigidSolution, target: RigidSolution) -> np.ndarray:
    """Return the precision of a solution on the level of `target`, (7, h, w) float32."""
    if solution.level == target.level:
        return solution.precision
    size = target.precision.shape[:0:-1]
    ratio = np.float32((solution.density / target.density) ** 2)  # ratio of px² of both levels
    units = (ratio, ratio, ratio, 1 / ratio, 1 / ratio, 1 / ratio, 1 / ratio)
    channels = zip(solution.precision, units, strict=True)
    return np.stack([cv2.resize(channel, size) * unit for channel, unit in channels])
