"""Rigid motions of the scene in front of the camera, P₁ = R P₀ + t: twists and matrices."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import Floats, check_finite, refuse_masked
from tisfm.errors import InputError, InputTypeError

__all__ = ["pose_matrix", "rigid_motion", "rigid_twist"]

# Tolerance of R Rᵀ − 1: text files round poses, measured poses to 1e-4.
_ORTHONORMALITY_TOLERANCE = 1e-3
# Range of ‖t‖, in the unit of t: depth and its deviation then fit into float32, with a margin for
# scenes of any size and any parallax.
_MIN_TRANSLATION = 1e-30
_MAX_TRANSLATION = 1e30
# Degrees: frames that differ by a larger rotation have hardly anything in common.
_MAX_ROTATION_ANGLE = 90.0


def rigid_motion(motion: ArrayLike) -> tuple[Floats, Floats]:
    """Return the finite rigid motion of a twist that acts for one frame.

    Parameters
    ----------
    motion : array_like, shape (6,)
        Twist (T, ω): translational velocity, length/frame, and rotational velocity, rad/frame.

    Returns
    -------
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        R = exp([ω]×) and t = V(ω) T, with V the integral of exp(s[ω]×) over s in [0, 1]:
        P1 = R P0 + t.

    Raises
    ------
    ValueError
        If `motion` is not six finite numbers without a mask.

    Examples
    --------
    >>> import math
    >>> from tisfm.rigid import rigid_motion
    >>> rotation, translation = rigid_motion([0, 0, 1, 0, 0, math.pi / 2])
    >>> rotation.round(6).astype(int).tolist()  # a quarter turn about the optical axis
    [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    >>> translation.tolist()
    [0.0, 0.0, 1.0]
    """
    twist = check_finite(motion, (6,), "motion")
    velocity, spin = twist[:3], twist[3:]
    angle = float(np.linalg.norm(spin))
    cross = np.array([[0.0, -spin[2], spin[1]], [spin[2], 0.0, -spin[0]], [-spin[1], spin[0], 0.0]])
    # sin θ/θ, (1 - cos θ)/θ² and (θ - sin θ)/θ³, in forms without cancellation at small angles θ.
    sine_factor = float(np.sinc(angle / np.pi))
    cosine_factor = 0.5 * float(np.sinc(angle / (2 * np.pi))) ** 2
    if angle < 1e-2:
        cubic_factor = 1 / 6 - angle**2 / 120 + angle**4 / 5040
    else:
        cubic_factor = (angle - math.sin(angle)) / angle**3
    rotation = np.eye(3) + sine_factor * cross + cosine_factor * cross @ cross
    translation = (np.eye(3) + cosine_factor * cross + cubic_factor * cross @ cross) @ velocity
    return rotation, translation


def rigid_twist(rotation: ArrayLike, translation: ArrayLike) -> Floats:
    """Return the twist that, acting for one frame, gives a finite rigid motion.

    Parameters
    ----------
    rotation, translation : array_like, shapes (3, 3) and (3,)
        R and t of P1 = R P0 + t; R turns by less than 180°.

    Returns
    -------
    (6,) ndarray
        (T, ω); `rigid_motion` converts it back to R and t.

    Raises
    ------
    ValueError
        If the arguments are not finite numbers of these shapes.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.rigid import rigid_motion, rigid_twist
    >>> twist = [0.1, 0.2, 0.3, 0.01, 0.02, 0.03]
    >>> bool(np.allclose(rigid_twist(*rigid_motion(twist)), twist))
    True
    """
    matrix, offset = (
        check_finite(rotation, (3, 3), "rotation"),
        check_finite(translation, (3,), "translation"),
    )
    # The axis times twice the sine, with the cosine from the trace, is accurate at small angles.
    axis = np.array(
        [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    )
    twice_sine = float(np.linalg.norm(axis))
    angle = math.atan2(twice_sine, float(np.trace(matrix)) - 1)
    spin = axis / 2 if twice_sine < 1e-12 else axis * (angle / twice_sine)
    # t = V(ω) T: the columns of V(ω) are the translations t for the three unit vectors T.
    velocity_matrix = np.column_stack([rigid_motion([*unit, *spin])[1] for unit in np.eye(3)])
    return np.concatenate([np.linalg.solve(velocity_matrix, offset), spin])


def pose_matrix(twist: ArrayLike) -> NDArray[np.float64]:
    """Return the finite motion of a twist that acts for one frame.

    Parameters
    ----------
    twist : array_like, shape (6,)
        (T, ω): translational velocity, length/frame, and rotational velocity, rad/frame.

    Returns
    -------
    (4, 4) float64 ndarray
        The exponential of the twist.

    Raises
    ------
    ValueError
        If `twist` is not six finite numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.rigid import pose_matrix
    >>> pose = pose_matrix([-0.1, 0, 0, 0, 0, 0])  # the camera moved 0.1 to the right
    >>> (pose @ [0, 0, 2, 1]).tolist()  # where a point in front of it is then
    [-0.1, 0.0, 2.0, 1.0]
    """
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rigid_motion(twist)
    return pose


def is_rotation(matrix: NDArray[np.float64]) -> bool:
    """Return whether a (3, 3) matrix is orthonormal within 0.001 and has no mirroring."""
    square = matrix @ matrix.T
    return bool(
        np.abs(square - np.eye(3)).max() <= _ORTHONORMALITY_TOLERANCE and np.linalg.det(matrix) > 0
    )


def nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation R with the greatest trace of Rᵀ M, (3, 3): Umeyama, eq. 40–43."""
    u, _, vt = np.linalg.svd(matrix)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    return np.asarray(u * signs @ vt)


@dataclass(frozen=True, kw_only=True)
class KnownPose:
    """The known part of the motion P₁ = R P₀ + t."""

    rotation: np.ndarray  # (3, 3) float64
    translation: np.ndarray | None  # (3,) float64 or None: none if only the rotation is known


def check_pose(
    # array_like, shape (4, 4) or (3, 3), or None: (R, t; 0, 1), which takes points from frame 0's
    # camera axes to frame 1's; or R alone
    pose: ArrayLike | None,
) -> KnownPose | None:
    """Return a checked pose, with the nearest exact rotation; None for None.

    Raises TypeError if the pose is not an array of real numbers.

    Raises ValueError if it is neither of these matrices, has a masked value, turns by 90° or more,
    or translates by a length that is neither 0 nor from 1e-30 to 1e30: float32 cannot hold depth in
    such a unit.
    """
    if pose is None:
        return None
    refuse_masked(pose, "pose", "expected a 4×4 or 3×3 array without a mask")
    try:
        array = np.asarray(pose)
        if array.dtype.kind in "bc":
            raise TypeError
        matrix = array.astype(np.float64)
    except (TypeError, ValueError):
        raise InputTypeError(
            f"pose is {pose!r}: expected a 4×4 or 3×3 array of real numbers"
        ) from None
    if matrix.shape not in ((4, 4), (3, 3)):
        raise InputError(
            f"pose has the shape {matrix.shape}: expected (4, 4), points in frame 0's camera axes "
            "to frame 1's, or (3, 3), its rotation alone"
        )
    if not np.isfinite(matrix).all():
        raise InputError(
            "pose has a value that is NaN or infinite: give finite numbers, or, if the pose is "
            "unknown, leave pose out"
        )
    if matrix.shape == (4, 4) and not np.allclose(
        matrix[3], (0, 0, 0, 1), rtol=0, atol=_ORTHONORMALITY_TOLERANCE
    ):
        raise InputError(f"the last row of pose is {matrix[3].tolist()}: expected 0, 0, 0, 1")
    rotation = matrix[:3, :3]
    if not is_rotation(rotation):
        raise InputError(
            f"pose holds {rotation.tolist()}, which is not a rotation: expected an "
            "orthonormal matrix without mirroring"
        )
    rotation = nearest_rotation(rotation)  # measured poses are rounded
    from scipy.spatial.transform import Rotation  # slow to import

    angle = math.degrees(Rotation.from_matrix(rotation).magnitude())
    if angle >= _MAX_ROTATION_ANGLE:
        raise InputError(
            f"pose turns by {angle:.0f}°: expected less than {_MAX_ROTATION_ANGLE:g}° between two "
            "frames of one scene; check that it is the motion from frame 0's camera to frame 1's, "
            "not a pose in the world, and that both have their axes right, down and forward"
        )
    if len(matrix) == 3:
        return KnownPose(rotation=rotation, translation=None)
    translation = matrix[:3, 3].copy()
    length = math.hypot(*translation)  # hypot: squares would overflow
    if translation.any() and not _MIN_TRANSLATION <= length <= _MAX_TRANSLATION:
        raise InputError(
            f"pose translates by {length:.1e}: expected 0 if it only turns, or a length of "
            f"{_MIN_TRANSLATION:g} to {_MAX_TRANSLATION:g}, for single precision to hold depth in "
            "its unit; give it in another unit"
        )
    return KnownPose(rotation=rotation, translation=translation)
