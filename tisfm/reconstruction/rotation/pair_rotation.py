"""The rotation between two frames, from points that both show."""

import numpy as np

from tisfm.reconstruction.rotation.settings import ROTATION


def make_unit_rays(points: np.ndarray, focal: float) -> np.ndarray:
    """Return the unit directions to points, (N, 3); points are (N, 2) px from the centre."""
    rays = np.column_stack([points, np.full(len(points), focal)])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def fit_rotation(
    # before, after: (N, 2) float64, px from the centre; N is at least 2
    before: np.ndarray,
    after: np.ndarray,
    focal: float,  # px
    noise: float,  # px: larger residuals have a decreasing weight
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation of directions, (3, 3), and the residuals of the points, (N,) px.

    Rotations from two points each are tried, and the best one is refined with all points. So the
    points of a moving object hardly count, if they are fewer than half.

    References
    ----------
    Black, "A passive system for determining the attitude of a satellite", AIAA Journal 1964,
    doi 10.2514/3.2555: the rotation from two directions. Kabsch, "A solution for the best rotation
    to relate two sets of vectors", 1976, doi 10.1107/S0567739476001873.
    """
    start, end = make_unit_rays(before, focal), make_unit_rays(after, focal)
    random = np.random.default_rng(0)  # the same input gives the same bits
    first, second = random.integers(0, len(start), (2, ROTATION.trials))
    trials = _make_two_ray_axes(end[first], end[second]) @ np.swapaxes(
        _make_two_ray_axes(start[first], start[second]), 1, 2
    )
    distances = focal * np.linalg.norm(start @ np.swapaxes(trials, 1, 2) - end, axis=2)
    costs = np.log1p((distances / noise) ** 2).sum(axis=1)
    rotation = trials[costs.argmin()]
    for _ in range(ROTATION.rounds):
        distance = focal * np.linalg.norm(start @ rotation.T - end, axis=1)
        weights = 1 / (1 + (distance / noise) ** 2)
        left, _, right = np.linalg.svd((end * weights[:, None]).T @ start)
        rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return rotation, focal * np.linalg.norm(start @ rotation.T - end, axis=1)


def _make_two_ray_axes(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return right-handed axes, (N, 3, 3), from the sum and the normal of two unit rays."""
    middle = _normalise(first + second)
    normal = _normalise(np.cross(first, second))
    return np.stack([middle, np.cross(normal, middle), normal], axis=2)


def _normalise(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, ROTATION.min_length))
