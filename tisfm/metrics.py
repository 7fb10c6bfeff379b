"""Errors of flow, depth and pose against the truth, as the usual benchmarks define them.

Pixels whose truth is unknown never count: those where it is not finite or above 1e9 in magnitude,
the Middlebury convention. Sums are float64 whatever the input.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.coverage import std_coverage
from tisfm.poses import PoseErrors, pose_errors

__all__ = [
    "DepthErrors",
    "FlowErrors",
    "OcclusionScores",
    "PoseErrors",
    "angular_error",
    "depth_error_map",
    "depth_errors",
    "endpoint_error",
    "endpoint_error_map",
    "flow_errors",
    "occlusion_scores",
    "outlier_rate",
    "pose_errors",
    "std_coverage",
]

UNKNOWN = 1e9


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
        If shapes differ, or no pixel counts.
    """
    estimate, truth, counts = _flows(flow, truth, mask)
    counts &= np.isfinite(estimate).all(axis=-1)
    error = np.full(counts.shape, np.nan)
    error[counts] = _length(estimate[counts] - truth[counts])
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
        If shapes differ, no pixel counts, or the flow is not finite where one does.

    References
    ----------
    Baker et al., A database and evaluation methodology for optical flow, IJCV 92 (2011) 1-31,
    doi 10.1007/s11263-010-0390-2.
    """
    estimate, known = _finite_pairs(flow, truth, mask)
    return float(_length(estimate - known).mean())


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
        If shapes differ, no pixel counts, or the flow is not finite where one does.

    References
    ----------
    Barron, Fleet and Beauchemin, Performance of optical flow techniques, IJCV 12 (1994) 43-77,
    doi 10.1007/BF01420984.
    """
    estimate, known = _finite_pairs(flow, truth, mask)
    dot = (estimate * known).sum(axis=-1) + 1
    # Of (u, v, 1) × (u*, v*, 1); an arc cosine would lose small angles to rounding.
    turn = estimate[:, 0] * known[:, 1] - estimate[:, 1] * known[:, 0]
    cross = np.hypot(_length(estimate - known), turn)
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
        An outlier is off by at least this, px,
    fraction : float, default 0.05
        and by at least this fraction of the true displacement. A flow that is not finite is an
        outlier too.

    Returns
    -------
    float
        Outliers among the pixels that count, in [0, 1].

    Raises
    ------
    ValueError
        If shapes differ, or no pixel counts.

    References
    ----------
    Menze and Geiger, Object scene flow for autonomous vehicles, CVPR 2015,
    doi 10.1109/CVPR.2015.7298925.
    """
    estimate, truth, counts = _flows(flow, truth, mask)
    estimate, known = estimate[counts], truth[counts]
    finite = np.isfinite(estimate).all(axis=-1)
    error = _length(np.where(finite[:, None], estimate - known, 0))
    wrong = (error >= pixels) & (error >= fraction * _length(known))
    return float((wrong | ~finite).mean())


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
        Pixels that counted.
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
        If shapes differ, no pixel counts, or the flow is not finite where one does.
    """
    estimate, known = _finite_pairs(flow, truth, mask)
    # All of them at once below: a mask would be applied once for each.
    estimate, known = estimate[None], known[None]
    return FlowErrors(
        endpoint=endpoint_error(estimate, known),
        angular=angular_error(estimate, known),
        outliers=outlier_rate(estimate, known),
        over_one=outlier_rate(estimate, known, pixels=1.0, fraction=0.0),
        pixels=known.shape[1],
    )


@dataclass(frozen=True, kw_only=True)
class DepthErrors:
    """Errors of a depth map. All but `rmse` are without unit.

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
        100 · standard deviation of log d - log d*, which no scaling changes.
    scale : float
        The factor d was multiplied by before comparing: the median of d*/d, or 1.
    density : float
        Share of the pixels with known truth where the estimate is finite and positive; the errors
        are over these.
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


def depth_errors(
    depth: ArrayLike,
    truth: ArrayLike,
    mask: ArrayLike | None = None,
    align: str | None = "median",
) -> DepthErrors:
    """Compare a depth map with the truth.

    Parameters
    ----------
    depth, truth : array_like, shape (H, W)
        Estimated and true depth. Truth that is not positive is unknown.
    mask : array_like, shape (H, W), optional
        Nonzero where pixels count.
    align : {"median", None}, default "median"
        With "median", the estimate is first multiplied by the median of truth/estimate: one
        camera's depth is relative. With None it is compared as it is.

    Returns
    -------
    DepthErrors
        Estimates that are not finite and positive lower the density and enter no error.

    Raises
    ------
    ValueError
        If shapes differ, `align` is unknown, or no pixel has both a known truth and a valid
        estimate.

    References
    ----------
    Eigen, Puhrsch and Fergus, Depth map prediction from a single image using a multi-scale deep
    network, NIPS 2014, arXiv 1406.2283. `silog` is the root of its scale-invariant error, times 100
    as in KITTI's benchmark (Uhrig et al., Sparsity invariant CNNs, 3DV 2017, arXiv 1708.06500).
    """
    d, true, valid, known, scale = _depths(depth, truth, mask, align)
    d, true = d[valid], true[valid]
    log_ratio = np.log(d) - np.log(true)
    ratio = np.maximum(d / true, true / d)
    delta1, delta2, delta3 = (float((ratio < 1.25**power).mean()) for power in (1, 2, 3))
    return DepthErrors(
        abs_rel=float((np.abs(d - true) / true).mean()),
        rmse=float(np.sqrt(np.square(d - true).mean())),
        rmse_log=float(np.sqrt(np.square(log_ratio).mean())),
        delta1=delta1,
        delta2=delta2,
        delta3=delta3,
        silog=float(100 * log_ratio.std()),
        scale=scale,
        density=float(np.count_nonzero(valid) / np.count_nonzero(known)),
    )


def depth_error_map(
    depth: ArrayLike,
    truth: ArrayLike,
    mask: ArrayLike | None = None,
    align: str | None = "median",
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
    """
    d, true, valid, _, _ = _depths(depth, truth, mask, align)
    error = np.full(valid.shape, np.nan)
    error[valid] = np.abs(d[valid] - true[valid]) / true[valid]
    return error


@dataclass(frozen=True, kw_only=True)
class OcclusionScores:
    """How well a map of occlusion agrees with the truth.

    Attributes
    ----------
    precision : float
        Share of the marked pixels that are occluded, in [0, 1]; 0 if none is marked.
    recall : float
        Share of the occluded pixels that are marked, in [0, 1]; 0 if none is occluded.
    f1 : float
        Their harmonic mean.
    hits, marked, occluded : int
        Pixels that are both, that are marked, and that are occluded: of several maps, they add up.
    pixels : int
        Pixels that counted.
    """

    precision: float
    recall: float
    f1: float
    hits: int
    marked: int
    occluded: int
    pixels: int

    @classmethod
    def from_counts(
        cls, *, hits: int, marked: int, occluded: int, pixels: int
    ) -> "OcclusionScores":
        """Return the scores that follow from the counts."""
        return cls(
            precision=hits / max(marked, 1),
            recall=hits / max(occluded, 1),
            f1=2 * hits / max(marked + occluded, 1),
            hits=hits,
            marked=marked,
            occluded=occluded,
            pixels=pixels,
        )


def occlusion_scores(
    occlusion: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None
) -> OcclusionScores:
    """Compare a map of occlusion with the truth.

    Parameters
    ----------
    occlusion, truth : array_like, shape (H, W)
        Nonzero where a pixel is, or is said to be, not visible in the other frame.
    mask : array_like, shape (H, W), optional
        Nonzero where pixels count.

    Returns
    -------
    OcclusionScores

    Raises
    ------
    ValueError
        If shapes differ, or no pixel counts.
    """
    found, true = np.asarray(occlusion, bool), np.asarray(truth, bool)
    if found.shape != true.shape or found.ndim != 2:
        raise ValueError(
            f"occlusion is {found.shape} and truth is {true.shape}: both must be (H, W)"
        )
    counts = _counting(mask, found.shape)
    if not counts.any():
        raise ValueError("no pixel counts: the mask leaves none")
    hits, marked, occluded = (int((m & counts).sum()) for m in (found & true, found, true))
    return OcclusionScores.from_counts(
        hits=hits, marked=marked, occluded=occluded, pixels=int(counts.sum())
    )


def _depths(
    depth: ArrayLike, truth: ArrayLike, mask: ArrayLike | None, align: str | None
) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
    """Check and align two depths.

    Returns
    -------
    depth, truth : (H, W) float64
        The former multiplied by `scale`.
    valid, known : (H, W) bool
        Where both are known, and where the truth is.
    scale : float
    """
    if align not in ("median", None):
        raise ValueError(f"align is {align!r}: expected 'median' or None")
    estimate, true = np.asarray(depth, np.float64), np.asarray(truth, np.float64)
    if estimate.shape != true.shape or true.ndim != 2:
        raise ValueError(
            f"depth is {estimate.shape} and truth is {true.shape}: expected the same shape, (H, W)"
        )
    known = _known(true) & (true > 0) & _counting(mask, true.shape)
    if not known.any():
        raise ValueError(f"no pixel of the {true.shape} truth is known, positive and in the mask")
    valid = known & np.isfinite(estimate) & (estimate > 0)
    if not valid.any():
        raise ValueError(
            f"no pixel of the {estimate.shape} depth is finite and positive where the truth is "
            f"known: {np.count_nonzero(known)} pixels are"
        )
    scale = 1.0 if align is None else float(np.median(true[valid] / estimate[valid]))
    return estimate * scale, true, valid, known, scale


def _flows(flow: ArrayLike, truth: ArrayLike, mask: ArrayLike | None) -> tuple[NDArray, ...]:
    """Check a pair of flows; return them in float64 with the map of pixels that count."""
    estimate, truth = np.asarray(flow, np.float64), np.asarray(truth, np.float64)
    if estimate.shape != truth.shape or truth.ndim != 3 or truth.shape[-1] != 2:
        raise ValueError(
            f"flow is {estimate.shape} and truth is {truth.shape}: expected the same shape, "
            "(H, W, 2)"
        )
    counts = _known(truth).all(axis=-1) & _counting(mask, truth.shape[:2])
    if not counts.any():
        raise ValueError(f"no pixel of the {truth.shape} truth is known and in the mask")
    return estimate, truth, counts


def _finite_pairs(
    flow: ArrayLike, truth: ArrayLike, mask: ArrayLike | None
) -> tuple[NDArray, NDArray]:
    """Return estimate and truth at the pixels that count, (n, 2) each."""
    estimate, truth, counts = _flows(flow, truth, mask)
    missing = np.count_nonzero(~np.isfinite(estimate[counts]).all(axis=-1))
    if missing:
        raise ValueError(
            f"flow is not finite at {missing} of the {np.count_nonzero(counts)} pixels that count: "
            "expected finite flow there, or a mask without them"
        )
    return estimate[counts], truth[counts]


def _known(truth: NDArray) -> NDArray[np.bool_]:
    # A comparison with NaN is false, as wanted.
    return np.abs(truth) <= UNKNOWN


def _counting(mask: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(shape, bool)
    counting = np.asarray(mask) != 0
    if counting.shape != shape:
        raise ValueError(f"mask is {counting.shape}: expected the shape of the truth, {shape}")
    return counting


def _length(vectors: NDArray) -> NDArray[np.float64]:
    return np.hypot(vectors[..., 0], vectors[..., 1])
