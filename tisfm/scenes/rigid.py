"""Exact rigid motion: what a twist does in the time of one frame."""

import math

import numpy as np
from numpy.typing import ArrayLike

from .checks import Floats, finite


def rigid_motion(motion: ArrayLike) -> tuple[Floats, Floats]:
    """Return the finite rigid motion of a twist acting for one frame.

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
        If `motion` is not six finite numbers.
    """
    twist = finite(motion, (6,), "motion")
    velocity, spin = twist[:3], twist[3:]
    angle = float(np.linalg.norm(spin))
    cross = np.array([[0.0, -spin[2], spin[1]], [spin[2], 0.0, -spin[0]], [-spin[1], spin[0], 0.0]])
    # sin θ/θ, (1 - cos θ)/θ² and (θ - sin θ)/θ³, none of which cancels at small angles.
    first = float(np.sinc(angle / np.pi))
    second = 0.5 * float(np.sinc(angle / (2 * np.pi))) ** 2
    if angle < 1e-2:
        third = 1 / 6 - angle**2 / 120 + angle**4 / 5040
    else:
        third = (angle - math.sin(angle)) / angle**3
    rotation = np.eye(3) + first * cross + second * cross @ cross
    translation = (np.eye(3) + second * cross + third * cross @ cross) @ velocity
    return rotation, translation
