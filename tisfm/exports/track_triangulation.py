"""Points nearest to where several frames see them, under known poses."""

from dataclasses import dataclass

import numpy as np

from tisfm.checks import Floats
from tisfm.exports.guided_matching import Pose

ROUNDS = 8  # of Gauss–Newton
NOISE = 0.5  # px: of a measured position, and where a residual begins to count less
LARGEST = 1.5  # px, of frames up to 640 across: a position further from its point is dropped
# The deviation of the depth that a point is begun at, that it is held to where rays are parallel.
LEAST_STD, STD_FACTOR = 0.05, 2.0  # share of the depth; of what the depth map says
LOT = 2**17  # places that are worked on at a time
SMALLEST = 1e-3  # of the depth: no point comes nearer to a camera


@dataclass(frozen=True, kw_only=True)
class Triangulated:
    """Points and what sees them.

    Attributes
    ----------
    positions : (N, 3) float64
    residual : (N, M) float64
        From where each frame sees a point to where the pose says, px; NaN where none was measured.
    """

    positions: Floats
    residual: Floats


def triangulated(
    places: np.ndarray,
    poses: list[Pose],
    shape: tuple[int, int],
    begun: np.ndarray,
    relative_std: np.ndarray,
) -> Triangulated:
    """Return the points nearest to their places in M frames, by weighted squares.

    Parameters
    ----------
    places : (N, M, 2) float64
        (x, y), px; NaN where a point is not seen. Frame 0 has the depth that points begin at.
    poses : list of Pose
        Of the M frames.
    shape : (int, int)
        Height and width of the frames, px.
    begun : (N, 3) float64
        Where points are by the depth of frame 0.
    relative_std : (N,) float64
        Of that depth, as a share of it.
    """
    matrices = np.array([pose.matrix for pose in poses])
    focal = np.array([pose.camera.focal for pose in poses])
    centers = np.array([pose.camera.center_for(*shape) for pose in poses])
    seen = np.isfinite(places[..., 0])
    points = begun.copy()
    axis = matrices[0, :3, 2]
    depth = (begun - matrices[0, :3, 3]) @ axis
    std = np.maximum(STD_FACTOR * relative_std, LEAST_STD) * depth
    for _ in range(ROUNDS):
        residual, jacobian = _linearised(points, places, matrices, focal, centers, depth)
        size = np.hypot(residual[..., 0], residual[..., 1])
        weight = np.where(seen, 1 / np.maximum(size, NOISE) / NOISE, 0)  # Huber's, over variance
        matrix = np.einsum("nm,nmki,nmkj->nij", weight, jacobian, jacobian, optimize=True)
        vector = np.einsum("nm,nmki,nmk->ni", weight, jacobian, residual, optimize=True)
        matrix += np.einsum("n,i,j->nij", std**-2, axis, axis)
        away = (points - matrices[0, :3, 3]) @ axis - depth
        vector += (away / std**2)[:, None] * axis
        matrix += np.eye(3) * (1e-9 * np.trace(matrix, axis1=1, axis2=2))[:, None, None]
        points = points - np.linalg.solve(matrix, vector[..., None])[..., 0]
    residual, _ = _linearised(points, places, matrices, focal, centers, depth)
    size = np.hypot(residual[..., 0], residual[..., 1])
    local_z = np.einsum("nmi,mi->nm", points[:, None] - matrices[:, :3, 3], matrices[:, :3, 2])
    size = np.where(local_z > SMALLEST * depth[:, None], size, np.inf)
    return Triangulated(positions=points, residual=np.where(seen, size, np.nan))


def consistent(
    places: np.ndarray,
    poses: list[Pose],
    shape: tuple[int, int],
    begun: np.ndarray,
    relative_std: np.ndarray,
    fewest: int,
) -> tuple[np.ndarray, np.ndarray, Triangulated]:
    """Drop what does not fit one point, and points that too few frames then see.

    Parameters
    ----------
    places, poses, shape, begun, relative_std
        As for `triangulated`.
    fewest : int
        Frames that see a point, frame 0 among them.

    Returns
    -------
    kept : (N,) bool
        Which points are left.
    places : (K, M, 2) float64
        Their places; NaN for those dropped.
    found : Triangulated
        The same K points.
    """
    few = max(1, LOT // len(poses))
    parts = [
        _consistent(places[k : k + few], poses, shape, begun[k : k + few], std, fewest)
        for k in range(0, max(1, len(places)), few)
        for std in [relative_std[k : k + few]]
    ]
    kept, left, positions, residual = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    return kept, left, Triangulated(positions=positions, residual=residual)


def _consistent(
    places: np.ndarray,
    poses: list[Pose],
    shape: tuple[int, int],
    begun: np.ndarray,
    relative_std: np.ndarray,
    fewest: int,
) -> tuple[np.ndarray, ...]:
    """Do what `consistent` does with points that fit into memory together."""
    limit = LARGEST * max(1.0, max(shape) / 640)
    places, index = places.copy(), np.arange(len(places))
    worst = 4 * limit
    while True:
        enough = np.isfinite(places[..., 0]).sum(axis=1) >= fewest
        enough &= np.isfinite(places[:, 0, 0])
        places, index = places[enough], index[enough]
        found = triangulated(places, poses, shape, begun[index], relative_std[index])
        with np.errstate(invalid="ignore"):
            away = found.residual > worst
        if worst <= limit and not away.any():
            break
        places[away] = np.nan
        worst = max(worst / 2, limit)
    kept = np.zeros(len(begun), bool)
    kept[index] = True
    return kept, places, found.positions, found.residual


def _linearised(
    points: np.ndarray,
    places: np.ndarray,
    matrices: np.ndarray,
    focal: np.ndarray,
    centers: np.ndarray,
    depth: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals (N, M, 2), 0 where nothing is seen, and derivatives (N, M, 2, 3)."""
    rotations = matrices[:, :3, :3]
    local = np.einsum("nmi,mij->nmj", points[:, None] - matrices[:, :3, 3], rotations)
    z = np.maximum(local[..., 2], SMALLEST * depth[:, None])
    normal = local[..., :2] / z[..., None]
    residual = normal * focal[:, None] + centers - places
    residual = np.where(np.isfinite(residual), residual, 0)
    toward = rotations.transpose(0, 2, 1)  # rows: axes of the camera in the world
    jacobian = toward[None, :, :2] - normal[..., None] * toward[None, :, None, 2]
    return residual, jacobian * (focal / z)[..., None, None]
