"""Adjustment of poses, points and a camera whose focal length may change from frame to frame.

Unknowns of the camera are the logarithm of the focal length, the logarithm of the zoom of each
frame, and coefficients of the lens. Each of them is free or fixed. The result has their standard
deviations, which include what poses and points take from them. pycolmap's adjustment knows no
prior of a focal length that changes slowly, so the normal equations are solved here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from tisfm.reconstruction.calibration.bundle_residuals import (
    COMMON,
    BundleResiduals,
    BundleState,
    linearise,
)
from tisfm.reconstruction.calibration.normal_equations import (
    reduce_equations,
    zoom_differences,
)
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.calibration.track_bundle import TrackBundle


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustedCamera:
    """The camera of an adjustment, with its standard deviations."""

    bundle: TrackBundle  # with adjusted poses and points
    common: np.ndarray  # (5,) float64: logarithm of the focal length in px, k1, k2, p1, p2
    common_deviation: np.ndarray  # (5,): 0 where fixed
    zoom: np.ndarray  # (F,) float64: logarithm of the zoom of each frame; 0 in the first frame
    zoom_deviation: np.ndarray  # (F,): 0 where fixed
    residual: float  # px: robust standard deviation of a coordinate
    costs: np.ndarray  # (P,) float64: by track, sum of the robust costs of its observations, px²

    @property
    def cost(self) -> float:
        """Sum of the robust costs, px²."""
        return float(self.costs.sum())

    @property
    def focal(self) -> float:
        """Focal length of the first frame, px."""
        return float(np.exp(self.common[0]))


def adjust_camera(
    bundle: TrackBundle,
    focal: float,  # px: start value
    free: Sequence[str] = (),  # the free unknowns of `COMMON`; the others keep their start value
    *,
    radial: float = 0.0,  # start value of k1
    has_zoom: bool = False,  # whether each frame has a focal length of its own
    # (F,): logarithm of the zoom of each frame: start values, or fixed without `has_zoom`; by
    # default 0
    zoom: np.ndarray | None = None,
    # (F,): zoom that was removed from the tracks before; the prior holds for the sum
    removed_zoom: np.ndarray | None = None,
    # px: residuals beyond these have a decreasing weight; adjustments follow one another
    scales: Sequence[float] = CALIBRATION.bundle_scales,
    steps: int = CALIBRATION.bundle_steps,  # largest number of steps of each adjustment
) -> AdjustedCamera:
    """Adjust poses, points and the free unknowns of the camera.

    The zoom of the first frame is 0. A prior says that the zoom per frame hardly changes from frame
    to frame; single jumps are allowed. Other coefficients of the lens start at 0.

    References
    ----------
    Triggs et al., "Bundle adjustment – a modern synthesis", 2000, doi 10.1007/3-540-44480-7_21.
    """
    count = len(bundle.frames)
    is_free = np.ones(7 * count + len(COMMON), bool)
    is_free[:6] = False  # the pose of the first frame
    is_free[6 * count : 7 * count] = has_zoom
    is_free[6 * count] = False
    is_free[7 * count :] = [name in free for name in COMMON]
    state = BundleState(
        poses=bundle.poses,
        points=bundle.points,
        common=np.array([np.log(focal), radial, 0.0, 0.0, 0.0]),
        zoom=np.zeros(count) if zoom is None else zoom,
        removed_zoom=np.zeros(count) if removed_zoom is None else removed_zoom,
    )
    for scale in scales:
        state = _minimise(bundle, state, is_free, scale, steps)
    linear = linearise(bundle, state)
    variances = np.zeros(len(is_free))
    matrix = reduce_equations(bundle, state, linear, is_free, scales[-1]).matrix
    variances[is_free] = _find_variances(matrix) * CALIBRATION.correlated_observations
    deviations = np.sqrt(variances)
    costs = _robust_costs(linear.residuals, scales[-1])
    return AdjustedCamera(
        bundle=replace(bundle, poses=state.poses, points=state.points),
        common=state.common,
        common_deviation=deviations[7 * count :],
        zoom=state.zoom,
        zoom_deviation=deviations[6 * count : 7 * count],
        residual=linear.deviation,
        costs=np.bincount(bundle.indices, costs, minlength=len(bundle.points)),
    )


def solve_equations(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return the solution, (K,), of normal equations with finite numbers.

    A Cholesky factorisation takes a fraction of the time of the singular value decomposition of
    `numpy.linalg.lstsq`. The matrix is scaled to a unit diagonal first, which makes the result
    independent of the units of the unknowns. Where the matrix is singular, `numpy.linalg.lstsq`
    gives the result.
    """
    diagonal = np.diag(matrix)
    if (diagonal > 0).all():
        unit = 1 / np.sqrt(diagonal)
        try:
            factors = cho_factor(unit[:, None] * matrix * unit, lower=True, check_finite=False)
        except LinAlgError:
            pass
        else:
            if np.diag(factors[0]).min() > CALIBRATION.min_pivot:
                return np.asarray(unit * cho_solve(factors, unit * vector, check_finite=False))
    return np.asarray(np.linalg.lstsq(matrix, vector, rcond=None)[0])


def _find_variances(matrix: np.ndarray) -> np.ndarray:
    """Return the diagonal of the inverse of normal equations; infinite if there is no inverse."""
    if not np.isfinite(matrix).all():
        return np.full(len(matrix), np.inf)
    return np.maximum(np.diag(np.linalg.pinv(matrix, hermitian=True)), 0)


def _robust_costs(residuals: np.ndarray, scale: float) -> np.ndarray:
    """Return Cauchy's robust cost of each observation, (M,), px²."""
    square = (residuals**2).sum(axis=1)
    return np.asarray(scale**2 * np.log1p(square / scale**2))


def measure_cost(
    bundle: TrackBundle, state: BundleState, linear: BundleResiduals, scale: float, deviation: float
) -> float:
    """Return the cost that a step lowers, px²: of the residuals, and of the prior of the zoom.

    The deviation of a coordinate, px, gives the prior the unit of the residuals.
    """
    change = zoom_differences(bundle.frames) @ (state.zoom + state.removed_zoom)
    prior = np.log1p((change / CALIBRATION.zoom_change) ** 2).sum()
    return float(_robust_costs(linear.residuals, scale).sum() + deviation**2 * prior)


def _minimise(
    bundle: TrackBundle, state: BundleState, is_free: np.ndarray, scale: float, steps: int
) -> BundleState:
    """Return the state after damped Gauss–Newton steps (Levenberg and Marquardt).

    The steps end where numbers are too large: a point lies beside a camera, far from its axis.
    """
    damping = CALIBRATION.bundle_damping
    linear = linearise(bundle, state)
    for _ in range(steps):
        deviation = linear.weighting_deviation
        cost = measure_cost(bundle, state, linear, scale, deviation)
        reduced = reduce_equations(bundle, state, linear, is_free, scale, damping)
        if not (np.isfinite(reduced.matrix).all() and np.isfinite(reduced.gradient).all()):
            break
        step = np.zeros(len(is_free))
        step[is_free] = -solve_equations(reduced.matrix, reduced.gradient)
        candidate = state.moved(step, reduced.point_step(step[is_free]))
        new_linear = linearise(bundle, candidate)
        new_cost = measure_cost(bundle, candidate, new_linear, scale, deviation)
        if not new_cost < cost:
            damping *= CALIBRATION.bundle_damping_factor
            continue
        is_done = cost - new_cost < CALIBRATION.bundle_tolerance * cost
        state, linear, damping = candidate, new_linear, damping / CALIBRATION.bundle_damping_factor
        if is_done:
            break
    return state
