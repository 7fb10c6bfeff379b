"""Errors of rigid motions of the scene in front of the camera, P₁ = R P₀ + t."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.rigid import is_rotation


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    """Errors of a rigid motion whose translation has an unknown length.

    Attributes
    ----------
    direction : float or None
        Angle between the directions of translation, degrees, from 0 to 180. None if one of the
        translations is zero.
    rotation : float
        Angle of the relative rotation between estimate and truth, degrees, from 0 to 180.

    Examples
    --------
    >>> import math
    >>> from tisfm.metrics import pose_errors
    >>> from tisfm.rigid import pose_matrix
    >>> estimate = pose_matrix([1, 0, 0, 0, 0, math.radians(3)])
    >>> errors = pose_errors(estimate, pose_matrix([1, 0, 0, 0, 0, 0]))
    >>> round(errors.rotation, 3)  # degrees
    3.0
    """

    direction: float | None
    rotation: float


def pose_errors(pose: ArrayLike, truth: ArrayLike) -> PoseErrors:
    """Compare a rigid motion with the true one.

    Parameters
    ----------
    pose, truth : array_like, shape (4, 4)
        Estimated and true motion (R, t; 0, 1), both from the same axes to the same axes:
        P₁ = R P₀ + t. The lengths of t do not count.

    Returns
    -------
    PoseErrors

    Raises
    ------
    ValueError
        If a motion is not (4, 4), has a masked value, is not finite, or its upper left part is not
        a rotation.

    References
    ----------
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012,
    doi 10.1109/IROS.2012.6385773: the angle of the relative pose error. The angle between
    translations replaces its length, which two frames do not determine.

    Examples
    --------
    >>> from tisfm.metrics import pose_errors
    >>> from tisfm.rigid import pose_matrix
    >>> errors = pose_errors(pose_matrix([2, 0, 0, 0, 0, 0.1]), pose_matrix([1, 0, 0, 0, 0, 0.1]))
    >>> round(errors.direction, 3), round(errors.rotation, 3)  # degrees; lengths do not count
    (0.0, 0.0)
    """
    from scipy.spatial.transform import Rotation  # slow to import

    rotation, translation = _check_motion("pose", pose)
    true_rotation, true_translation = _check_motion("truth", truth)
    residual_rotation = Rotation.from_matrix(true_rotation.T @ rotation)
    direction = None
    if translation.any() and true_translation.any():
        # An arc cosine would lose small angles to rounding.
        cross = np.linalg.norm(np.cross(translation, true_translation))
        direction = float(np.degrees(np.arctan2(cross, translation @ true_translation)))
    return PoseErrors(
        direction=direction, rotation=float(np.degrees(residual_rotation.magnitude()))
    )


def _check_motion(name: str, pose: ArrayLike) -> tuple[NDArray, NDArray]:
    """Check a rigid motion; return its rotation and translation."""
    matrix = check_unmasked(pose, name, np.float64, advice="expected a matrix without a mask")
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InputError(
            f"{name} is {matrix.shape} {matrix.tolist()}: expected a finite (4, 4) matrix"
        )
    rotation = matrix[:3, :3]
    if not is_rotation(rotation):
        raise InputError(
            f"{name} is {matrix.tolist()}: expected a rotation, orthonormal and without mirroring, "
            "in its upper left 3 × 3 part"
        )
    return rotation, matrix[:3, 3]
