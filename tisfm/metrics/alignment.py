"""The similarity that aligns points with other points in least squares."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError

# Spread of points divided by their largest coordinate: with less spread they are one point.
_MIN_SPREAD = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Similarity:
    """The transform p ↦ s R p + t.

    Attributes
    ----------
    scale : float
    rotation : (3, 3) float64 ndarray
    translation : (3,) float64 ndarray

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import Similarity
    >>> twice = Similarity(scale=2.0, rotation=np.eye(3), translation=np.array([1.0, 0, 0]))
    >>> twice.apply([[1.0, 1.0, 1.0]]).tolist()
    [[3.0, 2.0, 2.0]]
    """

    scale: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return transformed points, (N, 3)."""
        return np.asarray(self.scale * np.asarray(points) @ self.rotation.T + self.translation)


def align(points: ArrayLike, truth: ArrayLike, *, with_scale: bool = True) -> Similarity:
    """Return the similarity that minimises the sum of squared distances of points from true points.

    Parameters
    ----------
    points, truth : array_like, shape (N, 3)
        N ≥ 1. If all points lie on a line, or are one point, several rotations are best, and one of
        them is returned. The scale is 1 if all points are one point.
    with_scale : bool, default True
        If False, the scale is 1: the similarity is a rigid motion.

    Returns
    -------
    Similarity

    Raises
    ------
    ValueError
        If the arrays have other shapes, or a value is masked or not finite.

    References
    ----------
    Umeyama, Least-squares estimation of transformation parameters between two point patterns,
    IEEE Transactions on Pattern Analysis and Machine Intelligence 13 (1991) 376–380,
    doi 10.1109/34.88573: eq. 40–43.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import align
    >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> similarity = align(points, 2 * points + (1, 0, 0))
    >>> round(similarity.scale, 6), similarity.translation.round(6).tolist()
    (2.0, [1.0, 0.0, 0.0])
    """
    source, target = _check_points(points, "points"), _check_points(truth, "truth")
    if source.shape != target.shape:
        raise InputError(
            f"points are {source.shape} and truth is {target.shape}: expected the same number"
        )
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    centred_source, centred_target = source - source_mean, target - target_mean
    u, singular_values, vt = np.linalg.svd(centred_target.T @ centred_source / len(source))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u * signs @ vt
    spread = float(np.square(centred_source).sum(axis=1).mean())
    is_point = spread <= (_MIN_SPREAD * np.abs(source).max()) ** 2
    scale = float(singular_values @ signs / spread) if with_scale and not is_point else 1.0
    return Similarity(
        scale=scale, rotation=rotation, translation=target_mean - scale * rotation @ source_mean
    )


def _check_points(values: ArrayLike, name: str) -> NDArray[np.float64]:
    array = check_unmasked(values, name, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise InputError(f"{name} are {array.shape}: expected (N, 3), N at least 1")
    if not np.isfinite(array).all():
        raise InputError(f"{name} have values that are NaN or infinite: leave them out")
    return array
