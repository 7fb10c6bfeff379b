"""Errors of flow, as defined in the usual benchmarks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.metrics.valid_pixels import compared_pixels, is_known


def endpoint_error_map(
    flow: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Return the length of the flow error at each pixel.

    Parameters
    ----------
    flow, truth : array_like, shape (H, W, 2)
        Estimated and true (u, v), px.
    mask : array_like, shape (H, W), optional
        Nonzero where pixels count.

    Returns
    -------
    ndarray, shape (H, W), float64
        Error, px; NaN where the truth is unknown, the mask is zero or the flow is not finite.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or no pixel counts.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import endpoint_error_map
    >>> truth = np.zeros((2, 2, 2))
    >>> truth[0, 0] = np.nan  # unknown
    >>> endpoint_error_map(truth + (3, 4), truth).tolist()
    [[nan, 5.0], [5.0, 5.0]]
    """
    estimate, truth, is_compared = _check_flows(flow, truth, mask)
    is_compared &= np.isfinite(estimate).all(axis=-1)
    error = np.full(is_compared.shape, np.nan)
    error[is_compared] = _length(estimate[is_compared] - truth[is_compared])
    return error


def endpoint_error(flow: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None) -> float:
    """Return the mean length of the flow error (EPE).

    Parameters
    ----------
    flow, truth, mask
        As in `endpoint_error_map`.

    Returns
    -------
    float
        Mean error, px.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, no pixel counts, or the flow is not finite at a pixel
        that counts.

    References
    ----------
    Baker et al., A database and evaluation methodology for optical flow, IJCV 92 (2011) 1-31,
    doi 10.1007/s11263-010-0390-2.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import endpoint_error
    >>> truth = np.zeros((48, 64, 2))
    >>> endpoint_error(truth + (3, 4), truth)
    5.0
    """
    estimate, true_flow = _finite_flows(flow, truth, mask)
    return float(_length(estimate - true_flow).mean())


def angular_error(flow: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None) -> float:
    """Return the mean angle between the space-time directions (u, v, 1) (AAE).

    Parameters
    ----------
    flow, truth, mask
        As in `endpoint_error_map`.

    Returns
    -------
    float
        Mean angle, degrees.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, no pixel counts, or the flow is not finite at a pixel
        that counts.

    References
    ----------
    Barron, Fleet and Beauchemin, Performance of optical flow techniques, IJCV 12 (1994) 43-77,
    doi 10.1007/BF01420984.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import angular_error
    >>> truth = np.zeros((48, 64, 2))
    >>> round(angular_error(truth + (1, 0), truth), 6)  # between (1, 0, 1) and (0, 0, 1)
    45.0
    """
    estimate, true_flow = _finite_flows(flow, truth, mask)
    dot = (estimate * true_flow).sum(axis=-1) + 1
    # The length of (u, v, 1) × (u*, v*, 1). An arc cosine would lose small angles to rounding.
    flow_cross = estimate[:, 0] * true_flow[:, 1] - estimate[:, 1] * true_flow[:, 0]
    cross = np.hypot(_length(estimate - true_flow), flow_cross)
    return float(np.degrees(np.arctan2(cross, dot)).mean())


def outlier_rate(
    flow: ArrayLike,
    truth: ArrayLike,
    *,
    mask: ArrayLike | None = None,
    pixels: float = 3.0,
    fraction: float = 0.05,
) -> float:
    """Return the share of pixels whose flow is plainly wrong (KITTI's Fl).

    Parameters
    ----------
    flow, truth, mask
        As in `endpoint_error_map`.
    pixels : float, default 3
        Smallest error of an outlier, px.
    fraction : float, default 0.05
        Smallest error of an outlier as a fraction of the true displacement. Both bounds must hold.
        A flow that is not finite is an outlier.

    Returns
    -------
    float
        Share of outliers among the pixels that count, in [0, 1].

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or no pixel counts.

    References
    ----------
    Menze and Geiger, Object scene flow for autonomous vehicles, CVPR 2015,
    doi 10.1109/CVPR.2015.7298925.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import outlier_rate
    >>> truth = np.full((48, 64, 2), 10.0)
    >>> flow = truth.copy()
    >>> flow[:12] += 4  # a quarter of the rows
    >>> outlier_rate(flow, truth)
    0.25
    """
    estimate, truth, is_compared = _check_flows(flow, truth, mask)
    estimate, true_flow = estimate[is_compared], truth[is_compared]
    is_finite = np.isfinite(estimate).all(axis=-1)
    error = _length(np.where(is_finite[:, None], estimate - true_flow, 0))
    is_outlier = (error >= pixels) & (error >= fraction * _length(true_flow))
    return float((is_outlier | ~is_finite).mean())


@dataclass(frozen=True, kw_only=True)
class FlowErrors:
    """Errors of a flow.

    Attributes
    ----------
    endpoint : float
        Mean length of the error (EPE), px.
    angular : float
        Mean angle between the directions (u, v, 1) (AAE), degrees.
    outliers : float
        Share of pixels off by at least 3 px and 5 % (KITTI's Fl), in [0, 1].
    over_one : float
        Share of pixels off by at least 1 px (R1.0), in [0, 1].
    pixels : int
        Number of compared pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import flow_errors
    >>> errors = flow_errors(np.zeros((48, 64, 2)), np.zeros((48, 64, 2)))
    >>> errors.endpoint, errors.over_one
    (0.0, 0.0)
    """

    endpoint: float
    angular: float
    outliers: float
    over_one: float
    pixels: int


def flow_errors(flow: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None) -> FlowErrors:
    """Compare a flow with the truth.

    Parameters
    ----------
    flow, truth, mask
        As in `endpoint_error_map`.

    Returns
    -------
    FlowErrors

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, no pixel counts, or the flow is not finite at a pixel
        that counts.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import flow_errors
    >>> truth = np.zeros((48, 64, 2))
    >>> errors = flow_errors(truth + (3, 4), truth)
    >>> errors.endpoint, errors.outliers, errors.pixels
    (5.0, 1.0, 3072)
    """
    estimate, true_flow = _finite_flows(flow, truth, mask)
    # One row with the pixels that count, so that the functions below need no mask.
    estimate, true_flow = estimate[None], true_flow[None]
    return FlowErrors(
        endpoint=endpoint_error(estimate, true_flow),
        angular=angular_error(estimate, true_flow),
        outliers=outlier_rate(estimate, true_flow),
        over_one=outlier_rate(estimate, true_flow, pixels=1.0, fraction=0.0),
        pixels=true_flow.shape[1],
    )


def _check_flows(flow: ArrayLike, truth: ArrayLike, mask: ArrayLike | None) -> tuple[NDArray, ...]:
    """Check a pair of flows; return them in float64 with the map of pixels that count."""
    estimate = check_unmasked(flow, "flow", np.float64)
    truth = check_unmasked(truth, "truth", np.float64)
    if estimate.shape != truth.shape or truth.ndim != 3 or truth.shape[-1] != 2:
        raise InputError(
            f"flow is {estimate.shape} and truth is {truth.shape}: expected the same shape, "
            "(H, W, 2)"
        )
    is_compared = is_known(truth).all(axis=-1) & compared_pixels(mask, truth.shape[:2])
    if not is_compared.any():
        raise InputError(f"no pixel of the {truth.shape} truth is known and in the mask")
    return estimate, truth, is_compared


def _length(vectors: NDArray) -> NDArray[np.float64]:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def _finite_flows(
    flow: ArrayLike, truth: ArrayLike, mask: ArrayLike | None
) -> tuple[NDArray, NDArray]:
    """Return estimate and truth at the pixels that count, (n, 2) each."""
    estimate, truth, is_compared = _check_flows(flow, truth, mask)
    count = np.count_nonzero(~np.isfinite(estimate[is_compared]).all(axis=-1))
    if count:
        raise InputError(
            f"flow is not finite at {count} of the {np.count_nonzero(is_compared)} pixels that "
            "count: expected finite flow there, or a mask without them"
        )
    return estimate[is_compared], truth[is_compared]
