"""Errors of depth near outlines: jumps of the true depth from a surface to one behind it."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.metrics.depth_sequence import relative_errors_of_depth
from tisfm.metrics.valid_pixels import is_known

# Definitions of these measures, set by hand:
MIN_JUMP = 0.1  # difference of neighbours, as a share of the larger inverse depth
MAX_EXTRAPOLATION_ERROR = 0.05  # the same share: a slanted surface explains such a difference
WRONG_ERROR = 0.1  # relative error of a wrong pixel
OUTLINE_RADIUS = 8  # px: distance from a jump


@dataclass(frozen=True, kw_only=True)
class RegionErrors:
    """Errors of depth over some pixels.

    Attributes
    ----------
    error : float
        Mean relative error, limited as by `limited_error`.
    wrong : float
        Share of the pixels with a relative error above 10 %.

    Examples
    --------
    >>> from tisfm.metrics import RegionErrors
    >>> RegionErrors(error=0.03, wrong=0.05).wrong
    0.05
    """

    error: float
    wrong: float


def outlines(truth: ArrayLike, *, radius: int = OUTLINE_RADIUS) -> NDArray[np.bool_]:
    """Return the pixels near jumps of the true depth.

    A jump is between two neighbours, along rows or columns, whose inverse depths differ by more
    than 10 %, unless the linear extrapolation of inverse depth from one side, by the neighbour
    before, gives the other side within 5 %: then the surface is only slanted.

    Parameters
    ----------
    truth : array_like, shape (H, W)
        True depth; unknown where it is not finite and positive.
    radius : int, default 8
        Largest distance from a pixel of a jump along rows and along columns, px.

    Returns
    -------
    ndarray of bool, shape (H, W)
        Pixels of known depth near a jump.

    Raises
    ------
    ValueError
        If the shape is not (H, W), or a value is masked.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import outlines
    >>> truth = np.full((20, 40), 3.0)
    >>> truth[:, :20] = 2.0
    >>> outlines(truth, radius=2)[0].nonzero()[0].tolist()
    [17, 18, 19, 20, 21, 22]
    """
    inverse = _inverse_of_truth(truth)
    return _near(_jumps(inverse) | _jumps(inverse.T).T, radius) & np.isfinite(inverse)


def outlines_of_blurred_depth(
    truth: ArrayLike, *, window: int = 9, min_range: float = 0.2, radius: int = 4
) -> NDArray[np.bool_]:
    """Return the pixels near outlines of a true depth that its sensor blurs.

    Parameters
    ----------
    truth : array_like, shape (H, W)
        True depth; unknown where it is not finite and positive.
    window : int, default 9
        Side of the square in which values are compared, px.
    min_range : float, default 0.2
        Difference of the extremes of inverse depth in this square, as a share of the larger.
    radius : int, default 4
        Largest distance from such a pixel, px.

    Returns
    -------
    ndarray of bool, shape (H, W)
        Pixels of known depth near an outline.

    Raises
    ------
    ValueError
        If the shape is not (H, W), or a value is masked.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import outlines_of_blurred_depth
    >>> truth = np.full((20, 40), 3.0)
    >>> truth[:, :20] = 2.0
    >>> int(outlines_of_blurred_depth(truth)[0].sum())
    16
    """
    inverse = _inverse_of_truth(truth)
    has_truth = np.isfinite(inverse)
    square = np.ones((window, window), np.uint8)
    largest = cv2.dilate(np.where(has_truth, inverse, 0.0), square)
    least = cv2.erode(np.where(has_truth, inverse, np.inf), square)
    is_outline = (largest - least > min_range * largest) & has_truth
    return _near(is_outline, radius) & has_truth


def region_errors(
    inverse_depth: ArrayLike,
    truth: ArrayLike,
    region: NDArray[np.bool_],
    *,
    scale: float = 1.0,
) -> RegionErrors | None:
    """Return the errors of depth over a region.

    Parameters
    ----------
    inverse_depth, truth, scale
        As for `limited_error`.
    region : ndarray of bool, shape (H, W)

    Returns
    -------
    RegionErrors or None
        None if no pixel of the region has a known truth.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or the truth is unknown everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import region_errors
    >>> truth = np.full((3, 4), 2.0)
    >>> errors = region_errors(1 / (1.25 * truth), truth, np.ones((3, 4), bool))
    >>> errors.error, errors.wrong
    (0.25, 1.0)
    """
    errors, has_truth = relative_errors_of_depth(inverse_depth, truth, scale=scale)
    if np.shape(region) != has_truth.shape:
        raise InputError(f"region is {np.shape(region)}: expected {has_truth.shape}, as the truth")
    chosen = errors[np.asarray(region, bool)[has_truth]]
    if not len(chosen):
        return None
    return RegionErrors(error=float(chosen.mean()), wrong=float((chosen > WRONG_ERROR).mean()))


def _inverse_of_truth(truth: ArrayLike) -> NDArray[np.float64]:
    """Return the inverse of a true depth, (H, W), NaN where the depth is unknown."""
    depth = check_unmasked(truth, "truth", np.float64)
    if depth.ndim != 2:
        raise InputError(f"truth is {depth.shape}: expected (H, W)")
    has_truth = is_known(depth) & (depth > 0)
    return np.where(has_truth, 1 / np.where(has_truth, depth, 1.0), np.nan)


def _near(region: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Return the pixels within `radius` px of a region, along rows and along columns."""
    square = np.ones((2 * radius + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(region.astype(np.uint8), square) > 0)


def _jumps(inverse: NDArray) -> NDArray[np.bool_]:
    """Return both pixels of each jump along rows; unknown inverse depth is NaN."""
    out = np.zeros(inverse.shape, bool)
    if inverse.shape[1] < 2:
        return out
    left, right = inverse[:, :-1], inverse[:, 1:]
    before = np.pad(inverse[:, :-2], ((0, 0), (1, 0)), constant_values=np.nan)
    after = np.pad(inverse[:, 2:], ((0, 0), (0, 1)), constant_values=np.nan)
    larger = np.fmax(left, right)
    is_step = np.abs(left - right) > MIN_JUMP * larger
    for prediction, value in ((2 * left - before, right), (2 * right - after, left)):
        is_step &= ~(np.abs(prediction - value) < MAX_EXTRAPOLATION_ERROR * larger)
    out[:, :-1] |= is_step
    out[:, 1:] |= is_step
    return out
