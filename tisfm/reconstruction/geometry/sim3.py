"""Similarities in space, (4, 4) matrices (s R, t; 0, 1), and their fits to points."""

import numpy as np
from scipy.spatial.transform import Rotation

# Values without a stated source were set by hand.

# Number of RANSAC trials, each with three points.
RANSAC_TRIALS = 200
# Largest error of an inlier, as a share of its distance from the camera.
INLIER_ERROR = 0.05
# Rounds of the reweighted fit to inliers.
FIT_ROUNDS = 5


def sim3_scale(similarity: np.ndarray) -> float:
    """Return the scale s."""
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))


def transform_points(similarity: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return transformed points, (N, 3)."""
    return np.asarray(points @ similarity[:3, :3].T + similarity[:3, 3])


def transform_pose(similarity: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return a transformed pose, (4, 4) camera to world."""
    there = similarity @ pose
    there[:3, :3] /= sim3_scale(similarity)
    return np.asarray(there)


def mean_pose(poses: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted mean of similar poses, (N, 4, 4), with weights, (N,)."""
    mean = np.asarray(np.average(poses, axis=0, weights=weights))
    u, _, vt = np.linalg.svd(mean[:3, :3])
    mean[:3, :3] = u @ vt
    return mean


def sim3_from_vector(scale: float, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return the similarity for the logarithm of a scale, a rotation vector and a translation."""
    similarity = np.eye(4)
    similarity[:3, :3] = np.exp(scale) * Rotation.from_rotvec(turn).as_matrix()
    similarity[:3, 3] = shift
    return similarity


def fit_sim3(points: np.ndarray, others: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the similarity that moves `others`, (N, 3), nearest to `points`.

    Both sets count as equally exact: the scale is the ratio of their spreads, as in Horn's paper.

    References
    ----------
    Horn, "Closed-form solution of absolute orientation using unit quaternions", JOSA A 4 (1987),
    doi 10.1364/JOSAA.4.000629: sec. 2.D. The rotation is that of Umeyama, eq. 40–43,
    doi 10.1109/34.88573.
    """
    share = (weights / weights.sum())[:, None]
    centre, other = (share * points).sum(axis=0), (share * others).sum(axis=0)
    left, right = points - centre, others - other
    u, _, vt = np.linalg.svd((share * left).T @ right)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    spread = np.array([(share * one**2).sum() for one in (left, right)])
    similarity = np.eye(4)
    similarity[:3, :3] = np.sqrt(spread[0] / max(spread[1], 1e-300)) * (u * signs @ vt)
    similarity[:3, 3] = centre - similarity[:3, :3] @ other
    return similarity


def fit_sim3_ransac(
    # points, others: (N, 3) float64
    points: np.ndarray,
    others: np.ndarray,
    # (N,) float64: distances of the points from the camera: far points are less exact
    distances: np.ndarray,
    *,
    fewest: int,
    share: float,  # the fewest inliers and their smallest share; with less, None is returned
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the similarity from `others` to `points` with most inliers, and the inliers.

    Returns similarity, (4, 4) float64; agree, (N,) bool.
    """
    least = max(fewest, share * len(points))
    if len(points) < max(3, least):
        return None
    random, best, most = np.random.default_rng(0), np.eye(4), 0
    for _ in range(RANSAC_TRIALS):
        three = random.choice(len(points), 3, replace=False)
        found = fit_sim3(points[three], others[three], np.ones(3))
        count = int((relative_errors(found, points, others, distances) < INLIER_ERROR).sum())
        if count > most:
            best, most = found, count
    for _ in range(FIT_ROUNDS):
        off = relative_errors(best, points, others, distances)
        agree = off < INLIER_ERROR
        if agree.sum() < max(3, least):
            return None
        weights = _weights(off[agree]) / distances[agree] ** 2
        best = fit_sim3(points[agree], others[agree], weights)
    return best, relative_errors(best, points, others, distances) < INLIER_ERROR


def refine_sim3(
    similarity: np.ndarray,  # (4, 4) float64: start value
    # two (N, 3) float64: points in the target system, and the same points in the other system
    points: tuple[np.ndarray, np.ndarray],
    distances: np.ndarray,  # (N,) float64: distances of the points from the camera
    # two (M, 4, 4) float64: poses of the same views, camera to world, in the target system and in
    # the other system
    poses: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return a similarity that fits points and poses, with weights from their residuals.

    The rotation comes from the poses alone, where it is exact.
    """
    turns = np.tile(np.eye(4), (len(poses[0]), 1, 1))
    turns[:, :3, :3] = poses[0][:, :3, :3] @ poses[1][:, :3, :3].mT
    turn = mean_pose(turns, np.ones(len(turns)))[:3, :3]
    here, there = (np.vstack([k, one[:, :3, 3]]) for k, one in zip(points, poses, strict=True))
    away = np.concatenate([distances, np.full(len(poses[0]), np.median(distances))])
    count = len(distances)
    for _ in range(FIT_ROUNDS):
        off = relative_errors(similarity, here, there, away)
        weights = np.concatenate([_weights(off[:count]), _weights(off[count:])]) / away**2
        share = (weights / weights.sum())[:, None]
        middle, other = (share * here).sum(axis=0), (share * there).sum(axis=0)
        spread = [(share * one**2).sum() for one in (here - middle, there - other)]
        similarity = np.eye(4)
        similarity[:3, :3] = np.sqrt(spread[0] / max(spread[1], 1e-300)) * turn
        similarity[:3, 3] = middle - similarity[:3, :3] @ other
    return similarity


def _weights(off: np.ndarray) -> np.ndarray:
    """Return robust weights of residuals, (N,): outliers get small weights."""
    usual = max(float(np.median(off)), 1e-9)
    return np.asarray(1 / (usual**2 + (off / 2) ** 2))


def relative_errors(
    similarity: np.ndarray, points: np.ndarray, others: np.ndarray, distances: np.ndarray
) -> np.ndarray:
    """Return the errors of transformed `others`, (N,), as shares of distances."""
    return np.asarray(
        np.linalg.norm(transform_points(similarity, others) - points, axis=1)
        / np.maximum(distances, 1e-300)
    )
