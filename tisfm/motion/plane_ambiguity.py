"""Whether a view of one plane leaves two motions of the camera."""

import numpy as np

from tisfm.motion.epipolar_fit import Pose, Rays, robust_deviation
from tisfm.motion.sparse_motion import SAME, angle, of_plane
from tisfm.status import Status

TWO_MOTIONS = Status(
    "two_motions",
    "two motions of the camera explain the frames alike, as where they show one plane, and "
    "depth follows from one of them: take frames that show more, or give the pose",
)
FEW = 400  # of the rays, which a homography is fitted to
ROUNDS = 4  # of weights
# Of the distances from epipolar lines: those from where the homography of a plane leads, at most.
# They are along two directions, so that noise alone makes it 1.75; of real frames, 2.6 and more.
AS_NEAR = 2.2
SMALLEST = 0.02  # px: distances that are no smaller in real frames
BEFORE = 0.99  # of the rays: a plane that is seen is met by as many, before the camera


def plane_status(rays: Rays, residual: float) -> Status | None:
    """Return a status if rays show one plane that leaves two motions, None if not.

    A homography has two decompositions in general. The plane of the wrong one often is behind the
    camera for some of the rays, which decides.

    Parameters
    ----------
    rays : Rays
        Of a flow field.
    residual : float
        Robust deviation of their distances from the epipolar lines of the best motion, px.

    References
    ----------
    Longuet-Higgins, "The reconstruction of a plane surface from two perspective projections",
    Proc. R. Soc. Lond. B 227 (1986), doi 10.1098/rspb.1986.0030; Malis and Vargas, as in
    `tisfm.motion.sparse_motion.sparse_motions`.
    """
    few = rays.every(max(1, rays.trust.size // FEW))
    homography, off = _homography(few)
    if off > AS_NEAR * max(residual, SMALLEST):
        return None
    found: list[Pose] = []
    for pose in of_plane(homography, few, share=BEFORE):
        if all(angle(pose[1], other[1]) >= SAME for other in found):
            found.append(pose)
    return TWO_MOTIONS if len(found) > 1 else None


def _homography(rays: Rays) -> tuple[np.ndarray, float]:
    """Return the homography nearest to rays, (3, 3), and how far they are from it, px."""
    before = rays.before
    x, y = rays.after
    nothing = np.zeros_like(before)
    system = np.hstack(
        [np.vstack([before, nothing, -x * before]), np.vstack([nothing, before, -y * before])]
    )  # two equations for each ray, (9, 2N)
    weight = rays.trust
    for _ in range(ROUNDS):
        normal = (system * np.tile(weight, 2)) @ system.T
        homography = np.linalg.eigh(normal)[1][:, 0].reshape(3, 3)
        moved = homography @ before
        distance = rays.focal * np.hypot(*(moved[:2] / moved[2] - rays.after))
        scale = robust_deviation(distance, rays.trust)
        weight = rays.trust / (1 + (distance / max(scale, SMALLEST)) ** 2)
    return homography, scale
