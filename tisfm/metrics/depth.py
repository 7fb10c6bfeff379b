"""Errors of relative depth, after scaling by the median."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.metrics.depth_sequence import MAX_DEPTH_RATIO, MIN_DEPTH_RATIO
from tisfm.metrics.valid_pixels import compared_pixels, is_known


@dataclass(frozen=True, kw_only=True)
class DepthErrors:
    """Errors of a depth map d with the truth d*. All but `rmse` have no unit.

    Attributes
    ----------
    abs_rel : float
        Mean |d - d*| / d*.
    rmse : float
        Root mean square of d - d*, in the unit of the truth.
    rmse_log : float
        Root mean square of log d - log d*, natural logarithm.
    delta1, delta2, delta3 : float
        Share of pixels with max(d/d*, d*/d) below 1.25, 1.25² and 1.25³.
    silog : float
        100 · standard deviation of log d - log d*; no scaling of d changes it.
    scale : float
        Factor of d before comparing: the median of d*/d, or 1.
    density : float
        Share of the pixels with known truth where the estimate is finite and positive; the other
        errors, except `abs_rel_all`, are over these pixels.
    abs_rel_all : float
        Mean |d - d*| / d* over all pixels with known truth: estimates are limited to
        [0.1 min d*, 10 max d*], and a pixel without an estimate counts as 10 max d*.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import depth_errors
    >>> truth = np.full((3, 4), 2.0)
    >>> depth = truth.copy()
    >>> depth[0, :3] = np.nan  # no estimate there
    >>> errors = depth_errors(depth, truth)
    >>> errors.density, errors.delta1
    (0.75, 1.0)
    """

    abs_rel: float
    rmse: float
    rmse_log: float
    delta1: float
    delta2: float
    delta3: float
    silog: float
    scale: float
    density: float
    abs_rel_all: float


def depth_errors(
    depth: ArrayLike, truth: ArrayLike, mask: ArrayLike | None = None, align: str | None = "median"
) -> DepthErrors:
    """Compare a depth map with the truth.

    Parameters
    ----------
    depth, truth : array_like, shape (H, W)
        Estimated and true depth. Truth that is not positive is unknown.
    mask : array_like, shape (H, W), optional
        Nonzero where pixels count.
    align : {"median", None}, default "median"
        With "median", the estimate is first multiplied by the median of truth/estimate, since depth
        from one camera has no scale. With None it is compared unscaled.

    Returns
    -------
    DepthErrors
        Estimates that are not finite and positive lower the density, and count in no other error
        but `abs_rel_all`.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, `align` is unknown, or no pixel has both a known truth
        and a valid estimate.

    References
    ----------
    Eigen, Puhrsch and Fergus, Depth map prediction from a single image using a multi-scale deep
    network, NIPS 2014, arXiv 1406.2283. `silog` is the root of its scale-invariant error, times 100
    as in KITTI's benchmark (Uhrig et al., Sparsity invariant CNNs, 3DV 2017, arXiv 1708.06500).

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import depth_errors
    >>> truth = np.linspace(2, 4, 12).reshape(3, 4)
    >>> errors = depth_errors(truth / 2, truth)  # correct apart from its scale
    >>> round(errors.abs_rel, 6), round(errors.scale, 6)
    (0.0, 2.0)
    """
    d, d_true, has_both, has_truth, scale = _align_depths(depth, truth, mask, align)
    known_truth = d_true[has_truth]
    min_depth, max_depth = MIN_DEPTH_RATIO * known_truth.min(), MAX_DEPTH_RATIO * known_truth.max()
    limited = np.where(has_both, d, max_depth)[has_truth].clip(min_depth, max_depth)
    d, d_true = d[has_both], d_true[has_both]
    log_ratio = np.log(d) - np.log(d_true)
    ratio = np.maximum(d / d_true, d_true / d)
    delta1, delta2, delta3 = (float((ratio < 1.25**power).mean()) for power in (1, 2, 3))
    return DepthErrors(
        abs_rel=float((np.abs(d - d_true) / d_true).mean()),
        rmse=float(np.sqrt(np.square(d - d_true).mean())),
        rmse_log=float(np.sqrt(np.square(log_ratio).mean())),
        delta1=delta1,
        delta2=delta2,
        delta3=delta3,
        silog=float(100 * log_ratio.std()),
        scale=scale,
        density=float(np.count_nonzero(has_both) / np.count_nonzero(has_truth)),
        abs_rel_all=float((np.abs(limited - known_truth) / known_truth).mean()),
    )


def depth_error_map(
    depth: ArrayLike, truth: ArrayLike, mask: ArrayLike | None = None, align: str | None = "median"
) -> NDArray[np.float64]:
    """Return the relative error of the depth, |d - d*| / d*, at each pixel.

    Parameters
    ----------
    depth, truth, mask, align
        As in `depth_errors`.

    Returns
    -------
    ndarray, shape (H, W), float64
        Error, without unit; NaN where the truth is unknown, the mask is zero or there is no valid
        estimate.

    Raises
    ------
    ValueError
        As `depth_errors`.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import depth_error_map
    >>> truth = np.full((2, 2), 4.0)
    >>> depth_error_map(truth * 1.25, truth, align=None).tolist()
    [[0.25, 0.25], [0.25, 0.25]]
    """
    d, d_true, has_both, _, _ = _align_depths(depth, truth, mask, align)
    error = np.full(has_both.shape, np.nan)
    error[has_both] = np.abs(d[has_both] - d_true[has_both]) / d_true[has_both]
    return error


def _align_depths(
    depth: ArrayLike, truth: ArrayLike, mask: ArrayLike | None, align: str | None
) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
    """Check and align two depths.

    Returns depth, multiplied by the scale, and truth, both (H, W) float64; masks of pixels where
    both are known and where the truth is known, (H, W) bool; and the scale.
    """
    if align not in ("median", None):
        raise InputError(f"align is {align!r}: expected 'median' or None")
    estimate = check_unmasked(depth, "depth", np.float64)
    d_true = check_unmasked(truth, "truth", np.float64)
    if estimate.shape != d_true.shape or d_true.ndim != 2:
        raise InputError(
            f"depth is {estimate.shape} and truth is {d_true.shape}: expected the same shape, "
            "(H, W)"
        )
    has_truth = is_known(d_true) & (d_true > 0) & compared_pixels(mask, d_true.shape)
    if not has_truth.any():
        raise InputError(f"no pixel of the {d_true.shape} truth is known, positive and in the mask")
    has_both = has_truth & np.isfinite(estimate) & (estimate > 0)
    if not has_both.any():
        raise InputError(
            f"no pixel of the {estimate.shape} depth is finite and positive where the truth is "
            f"known: {np.count_nonzero(has_truth)} pixels are"
        )
    scale = 1.0 if align is None else float(np.median(d_true[has_both] / estimate[has_both]))
    return estimate * scale, d_true, has_both, has_truth, scale
