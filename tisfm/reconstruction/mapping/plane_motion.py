"""The second motion that a plane allows.

Two views of a plane show a homography. It has two interpretations in front of the camera, each with
its own motion and its own normal of the plane. More views tell them apart, but only by the
curvature of the paths of points. So a model of a plane may have the wrong motion, and an adjustment
does not leave it.
"""

import numpy as np

from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.rigid import nearest_rotation


def find_other_motion(
    poses: np.ndarray,  # (V, 3, 4) float64: world to camera, of the views of a model
    points: np.ndarray,  # (N, 3) float64: points of the model, in the world
) -> np.ndarray | None:
    """Return the poses of the other motion, (V, 3, 4), if all points lie in one plane.

    For two views the poses are exact; with more views, adjust them. None is returned
    if the points do not lie in one plane, if the camera does not move along a line, or if the plane
    of the other motion is not in front of the camera.

    References
    ----------
    Longuet-Higgins, "The reconstruction of a plane surface from two perspective projections",
    Proc. R. Soc. Lond. B 227 (1986), doi 10.1098/rspb.1986.0030.
    """
    middle = poses[len(poses) // 2]
    in_middle = points @ middle[:, :3].T + middle[:, 3]
    plane = fit_plane(in_middle[in_middle[:, 2] > 0])
    if plane is None:
        return None
    rotations = poses[:, :, :3] @ middle[:, :3].T
    translations = poses[:, :, 3] - rotations @ middle[:, 3]
    other_plane = _find_other_plane(plane, rotations, translations, in_middle)
    if other_plane is None:
        return None
    homographies = rotations + translations[:, :, None] * plane
    return np.array([_move_with_plane(each, other_plane) for each in homographies])


def fit_plane(points: np.ndarray) -> np.ndarray | None:
    """Return the vector m, (3,), of the plane m · X = 1 near most points; None if there is none."""
    if len(points) < MAPPING.min_observations:
        return None
    weights = np.ones(len(points))
    for _ in range(MAPPING.plane_rounds):
        plane = np.linalg.lstsq(points * weights[:, None], weights, rcond=None)[0]
        residual = np.abs(points @ plane - 1)
        spread = max(float(np.median(residual)), 1e-12)
        weights = 1 / np.sqrt(1 + (residual / spread) ** 2)
    return plane if spread < MAPPING.max_plane_residual else None


def _find_other_plane(
    plane: np.ndarray,  # (3,)
    # rotations, translations: (V, 3, 3) and (V, 3), from the middle view to each view
    rotations: np.ndarray,
    translations: np.ndarray,
    points: np.ndarray,  # (N, 3): in the axes of the middle view
) -> np.ndarray | None:
    """Return the unit normal of the plane of the other motion, in the middle view, or None.

    With u = Rᵀt and a plane m, the homography H = R + t mᵀ has HᵀH = I + m wᵀ + w mᵀ, where
    w = u + |u|² m / 2. So m and w may change places.
    """
    shift = np.einsum("vji,vj->vi", rotations, translations)
    normals = shift + (shift**2).sum(axis=1, keepdims=True) / 2 * plane
    _, extents, axes = np.linalg.svd(normals)
    if extents[1] > MAPPING.max_sideways_share * extents[0]:
        return None
    heights = points @ axes[0]
    is_in_front = heights * np.median(heights) > 0
    if is_in_front.mean() < MAPPING.min_share_before_plane:
        return None
    return np.asarray(axes[0] * np.sign(np.median(heights)))


def _move_with_plane(homography: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the motion, (3, 4), nearest to a homography of a plane with this unit normal.

    The plane is at distance 1.
    """
    directions = np.linalg.svd(normal[None])[2][1:]  # along the plane: they are only rotated
    before = np.column_stack([*directions, np.cross(*directions)])
    moved = directions @ homography.T
    after = np.column_stack([*moved, np.cross(*moved)])
    rotation = nearest_rotation(after @ before.T)
    return np.column_stack([rotation, (homography - rotation) @ normal])
