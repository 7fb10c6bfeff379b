"""Check whether a view of a single plane allows two camera motions."""

import numpy as np

from tisfm.motion.epipolar_fit import Pose, Rays, robust_deviation
from tisfm.motion.sparse_motion import SAME, angle_between, plane_poses
from tisfm.status import Status

TWO_MOTIONS = Status(
    "two_motions",
    "two camera motions explain the frames equally well, as if the frames show a single plane, so "
    "depth may belong to the wrong one: take frames that show more than a plane, or give the pose",
)
FEW = 400  # rays that a homography is fitted to, about
ROUNDS = 4  # rounds of robust weights
# Largest ratio of the distances from a homography's points and from epipolar lines, for a plane.
# The former have two components, so noise alone makes it 1.75; in real frames it is 2.6 or more.
AS_NEAR = 2.2
SMALLEST = 0.02  # px: smallest distance in real frames
BEFORE = 0.99  # least share of the rays that meet a visible plane before the camera


def plane_status(
    rays: Rays,  # rays of a flow field
    residual: float,  # robust deviation of the rays from the epipolar lines of the best motion, px
) -> Status | None:
    """Return a status if rays show one plane that allows two motions, else None.

    In general a homography has two decompositions. If the plane of one decomposition is behind the
    camera for some of the rays, this decomposition is wrong.

    References
    ----------
    Longuet-Higgins, "The reconstruction of a plane surface from two perspective projections",
    Proc. R. Soc. Lond. B 227 (1986), doi 10.1098/rspb.1986.0030; Malis and Vargas, as in
    `tisfm.motion.sparse_motion.sparse_motions`.
    """
    sample = rays.subsample(max(1, rays.trust.size // FEW))
    homography, homography_error = _homography(sample)
    if homography_error > AS_NEAR * max(residual, SMALLEST):
        return None
    poses: list[Pose] = []
    for pose in plane_poses(homography, sample, min_share=BEFORE):
        if all(angle_between(pose[1], other[1]) >= SAME for other in poses):
            poses.append(pose)
    return TWO_MOTIONS if len(poses) > 1 else None


def _homography(rays: Rays) -> tuple[np.ndarray, float]:
    """Return the homography that fits rays best, (3, 3), and the deviation of the fit, px."""
    before = rays.before
    x, y = rays.after
    zeros = np.zeros_like(before)
    system = np.hstack(
        [np.vstack([before, zeros, -x * before]), np.vstack([zeros, before, -y * before])]
    )  # two equations for each ray, (9, 2N)
    weight = rays.trust
    for _ in range(ROUNDS):
        normal = (system * np.tile(weight, 2)) @ system.T
        homography = np.linalg.eigh(normal)[1][:, 0].reshape(3, 3)
        projected = homography @ before
        distance = rays.focal * np.hypot(*(projected[:2] / projected[2] - rays.after))
        scale = robust_deviation(distance, rays.trust)
        weight = rays.trust / (1 + (distance / max(scale, SMALLEST)) ** 2)
    return homography, scale
