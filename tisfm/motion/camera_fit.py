"""Cameras that differ from the stated one in one parameter, and motions that fit rays with them.

All M cameras are computed at once: arrays have one row for each of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tisfm.motion.camera_settings import INTRINSICS
from tisfm.motion.epipolar_fit import (
    MAD_TO_DEVIATION,
    MIN_LENGTH,
    MIN_SQUARE,
    Pose,
    Rays,
    fix_scale,
)

# "focal": logarithm of the focal length of both frames over the stated one; "zoom": logarithm of
# the zoom from frame 0 to frame 1; "distortion": k₁ of both frames
Parameter = Literal["focal", "zoom", "distortion"]
PARAMETERS: tuple[Parameter, ...] = ("focal", "zoom", "distortion")
FOCAL, ZOOM, DISTORTION = range(3)  # indices into `PARAMETERS`
FOLD = -4 / 27  # k₁ r² of distorted points, beyond which the image is folded
STEPS = {
    "focal": INTRINSICS.focal_values,
    "zoom": INTRINSICS.zoom_values,
    "distortion": INTRINSICS.distortion_values,
}
VALUES = np.array([STEPS[parameter] for parameter in PARAMETERS])  # (3, 5)
LARGEST = VALUES.max(axis=1)
PRIORS = np.array(
    [INTRINSICS.focal_prior, INTRINSICS.zoom_prior, INTRINSICS.distortion_prior]
)  # of `PARAMETERS`


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """Cameras that differ from the stated one in one parameter each, and their motions."""

    groups: np.ndarray  # (M,) int: indices into `PARAMETERS`
    values: np.ndarray  # (M,)
    rotations: np.ndarray  # (M, 3, 3)
    translations: np.ndarray  # (M, 3): ‖t‖ = 1

    @classmethod
    def of(
        cls, parameters: Sequence[Parameter], values: Sequence[float], poses: Sequence[Pose]
    ) -> "Cameras":
        """Return cameras with a parameter, its value, and a motion for each."""
        return cls(
            groups=np.array([PARAMETERS.index(parameter) for parameter in parameters], np.intp),
            values=np.array(values, float),
            rotations=np.array([rotation for rotation, _ in poses]),
            translations=np.array([translation for _, translation in poses]),
        )

    @classmethod
    def join(cls, parts: Sequence["Cameras"]) -> "Cameras":
        """Return the cameras of all parts, in order."""
        return cls(
            groups=np.concatenate([part.groups for part in parts]),
            values=np.concatenate([part.values for part in parts]),
            rotations=np.concatenate([part.rotations for part in parts]),
            translations=np.concatenate([part.translations for part in parts]),
        )

    def select(self, rows: np.ndarray | slice) -> "Cameras":
        """Return some of the cameras, by their numbers."""
        return Cameras(
            groups=self.groups[rows],
            values=self.values[rows],
            rotations=self.rotations[rows],
            translations=self.translations[rows],
        )

    @property
    def priors(self) -> np.ndarray:
        """Standard deviations of the values, (M,)."""
        return PRIORS[self.groups]


@dataclass(frozen=True, kw_only=True)
class EpipolarLines:
    """Epipolar lines in frame 1 of the rays of frame 0, l = [t]× R x̂, by all cameras."""

    matrices: np.ndarray  # (M, 6, 3): R, and E = [t]× R
    vectors: np.ndarray  # (M, 2, 3, N): R x̂, and l
    offsets: np.ndarray  # (M, N): l · x̂₁ of the rays of frame 1; 0 on the line
    px: np.ndarray  # (M, N): px of an offset of 1
    sides: np.ndarray  # (M, N): positive if the nearest point of the line is in front of the camera

    @property
    def distances(self) -> np.ndarray:
        """Signed distances of rays from the lines, (M, N), px."""
        return self.offsets * self.px


def find_lines(
    changed: Rays,  # of the cameras: `change_cameras`
    cameras: Cameras,
) -> EpipolarLines:
    """Return the epipolar lines of cameras."""
    x1, y1 = changed.rays1[:, 0], changed.rays1[:, 1]
    essential = make_crosses(cameras.translations) @ cameras.rotations
    matrices = np.concatenate([cameras.rotations, essential], axis=1, dtype=x1.dtype)
    moved = matrices @ changed.rays0
    x, y, z, l_x, l_y, l_z = (moved[:, k] for k in range(6))
    lengths = np.maximum(np.sqrt(l_x * l_x + l_y * l_y), MIN_LENGTH)
    # x̂₁ has to leave R x̂ in the direction in which the translation moves it
    t_x, t_y, t_z = cameras.translations.T.astype(x1.dtype)[:, :, None]
    sides = (x1 * z - x) * (t_x - x1 * t_z) + (y1 * z - y) * (t_y - y1 * t_z)
    return EpipolarLines(
        matrices=matrices,
        vectors=moved.reshape(len(moved), 2, 3, -1),
        offsets=l_x * x1 + l_y * y1 + l_z,
        px=changed.focal / lengths,
        sides=sides,
    )


def improve_cameras(
    changed: Rays,  # of the cameras: `change_cameras`
    cameras: Cameras,
    *,
    is_free: bool,
) -> tuple[Cameras, np.ndarray]:
    """Return cameras with better motions, and the standard deviations of their values, (M,).

    Free values are improved as well; the deviations of other values are infinite.
    """
    trust = changed.trust
    found = find_lines(changed, cameras)
    is_behind = np.sign(found.sides) @ trust < 0
    if is_behind.any():
        turned = np.where(is_behind[:, None], -cameras.translations, cameras.translations)
        cameras = replace(cameras, translations=turned)
        found = find_lines(changed, cameras)
    weight = _weigh_rays(found, trust)
    rows = find_derivatives(changed, cameras, found, is_free=is_free)
    equations = (rows[:, :-1] * weight[:, None]) @ np.swapaxes(rows, 1, 2)
    matrix = equations[:, :, :-1].astype(np.float64)
    matrix[:, :6, :6] = fix_scale(matrix[:, :6, :6], cameras.translations)
    # a second column on the right gives the variance of the last unknown
    right = np.zeros((*matrix.shape[:2], 2))
    right[:, :, 0] = -equations[:, :, -1]
    right[:, -1, 1] = 1
    if is_free:
        stiffness = 1 / cameras.priors**2
        matrix[:, 6, 6] += stiffness
        right[:, 6, 0] -= stiffness * cameras.values
    solutions = np.linalg.solve(matrix, right)
    step = solutions[:, :, 0]
    values, deviations = cameras.values, np.full(len(cameras.values), np.inf)
    if is_free:
        values, variances = values + step[:, 6], solutions[:, 6, 1]
        # single precision may leave no positive variance: such rays say nothing about the value
        deviations = np.sqrt(np.where(variances > 0, variances, cameras.priors**2))
    turns = make_turns(step[:, 3:6])
    translations = (turns @ cameras.translations[..., None])[..., 0] + step[:, :3]
    translations /= np.sqrt((translations * translations).sum(axis=1, keepdims=True))
    improved = replace(
        cameras, values=values, rotations=turns @ cameras.rotations, translations=translations
    )
    return improved, deviations


def _weigh_rays(
    found: EpipolarLines,
    trust: np.ndarray,  # (N,)
) -> np.ndarray:
    """Return robust weights of squared offsets, (M, N), in squared standard deviations."""
    distances = found.distances
    scales = np.maximum(robust_deviations(np.abs(distances), trust), INTRINSICS.min_residual)
    distances *= (0.5 / scales)[:, None]
    distances *= distances
    distances += 1
    weight = found.px / distances
    weight *= weight
    weight *= trust * (INTRINSICS.independent_rays / (scales**2 * trust.size))[:, None]
    weight[found.sides <= 0] *= INTRINSICS.weight_behind
    return np.asarray(weight)


def find_derivatives(
    changed: Rays,  # of the cameras
    cameras: Cameras,
    found: EpipolarLines,  # of the cameras
    *,
    is_free: bool,
) -> np.ndarray:
    """Return the derivatives of distances, and the distances.

    The array is (M, 7, N), or (M, 8, N) if the value is free: six rows for the motion (translation
    and rotation), one for the value if it is free, and the distances last. All are in units of
    offsets: times `found.px`, they are in px.

    A small motion turns a line about the point p that is nearest to the ray, so that it changes the
    distance by p · δl, with δl = δt × R x̂ and δl = δω × l.
    """
    l_z = found.vectors[:, 1, 2]
    to_line = found.offsets * np.square(found.px / changed.focal)
    points = changed.rays1 - to_line[:, None] * found.vectors[:, 1, :2]
    p_x, p_y = points[:, 0], points[:, 1]
    count = p_x.shape[1]
    rows = np.empty((len(p_x), 8 if is_free else 7, count), p_x.dtype)
    x, y, z = (found.vectors[:, :, k] for k in range(3))
    crosses = rows[:, :6].reshape(-1, 2, 3, count)
    np.subtract(y, z * p_y[:, None], out=crosses[:, :, 0])
    np.subtract(z * p_x[:, None], x, out=crosses[:, :, 1])
    np.subtract(x * p_y[:, None], y * p_x[:, None], out=crosses[:, :, 2])
    rows[:, -1] = found.offsets
    if is_free:
        # a point x̂ moves by −x̂ · change; E x̂ = l, and p · l = 0
        a, b, c = found.matrices[:, 3:, 2].T[:, :, None]
        change0, change1 = _find_changes(changed, cameras.groups)
        rows[:, 6] = change0 * (a * p_x + b * p_y + c) - change1 * (found.offsets - l_z)
    return rows


def _find_changes(changed: Rays, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the relative motion of points of both frames as values grow, (M, N) each."""
    x0, x1 = changed.rays0[:, :2], changed.rays1
    change0, change1 = np.ones((2, len(groups), x0.shape[2]), x0.dtype)
    change0[groups == ZOOM] = 0.0
    is_distorted = groups == DISTORTION
    if is_distorted.any():
        change0[is_distorted] = np.square(x0[is_distorted]).sum(axis=1)
        change1[is_distorted] = np.square(x1[is_distorted]).sum(axis=1)
    return change0, change1


def make_crosses(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices [v]× of the cross product with vectors, (M, 3)."""
    x, y, z = vectors.T
    crosses = np.zeros((len(vectors), 3, 3))
    crosses[:, 2, 1], crosses[:, 0, 2], crosses[:, 1, 0] = x, y, z
    return crosses - np.swapaxes(crosses, 1, 2)


def make_turns(vectors: np.ndarray) -> np.ndarray:
    """Return the rotations, (M, 3, 3), of rotation vectors, (M, 3), rad, by Rodrigues' formula."""
    crosses = make_crosses(vectors)
    half = np.maximum(0.5 * np.sqrt((vectors * vectors).sum(axis=1)), MIN_LENGTH)[:, None, None]
    sine = np.sin(half) / half
    return np.asarray(
        np.eye(3) + sine * np.cos(half) * crosses + 0.5 * sine * sine * (crosses @ crosses)
    )


def change_cameras(rays: Rays, cameras: Cameras) -> Rays:
    """Return the rays of all cameras: (M, 3, N) and (M, 2, N), and focal lengths (M, 1)."""
    x0, x1 = rays.rays0[:2], rays.rays1
    groups, values = cameras.groups[:, None], cameras.values[:, None].astype(x1.dtype)
    shrinking, one = np.exp(-values), x1.dtype.type(1)
    factor0 = np.where(groups == FOCAL, shrinking, one)
    factor1 = np.where(groups == DISTORTION, one, shrinking)
    focal = rays.focal / factor0
    is_distorted = cameras.groups == DISTORTION
    if is_distorted.any():
        count = rays.trust.size
        squares = np.concatenate([x[0] * x[0] + x[1] * x[1] for x in (x0, x1)])
        undistorting = undistort_points(squares, values[is_distorted])
        factor0, factor1 = (np.repeat(factor, count, axis=1) for factor in (factor0, factor1))
        factor0[is_distorted] = undistorting[:, :count]
        factor1[is_distorted] = undistorting[:, count:]
    moved0 = np.ones((len(values), 3, rays.trust.size), x1.dtype)
    np.multiply(x0, factor0[:, None], out=moved0[:, :2])
    return Rays(
        rays0=moved0,
        rays1=x1 * factor1[:, None],
        trust=rays.trust,
        focal=focal,  # (M, 1)
    )


def undistort_points(square: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return factors of points without the distortion k₁, (M, N); `square` is r² of the points.

    The factor f solves f (1 + k₁ r² f²) = 1 for values k₁, (M, 1). Of the three roots, it is the
    one that tends to 1 as k₁ tends to 0, by the trigonometric solution of a cubic. Beyond the
    radius where the distortion folds the image, there is no such root, and the largest factor is
    returned.
    """
    strength = values * square
    root = np.sqrt(np.maximum(3 * np.abs(strength), MIN_SQUARE))
    is_barrel = values.ravel() < 0
    factor = np.empty_like(strength)
    factor[is_barrel] = np.sin(np.arcsin(np.minimum(1.5 * root[is_barrel], 1.0)) / 3)
    factor[~is_barrel] = np.sinh(np.arcsinh(1.5 * root[~is_barrel]) / 3)
    factor *= 2 / root
    return np.where(strength < FOLD, INTRINSICS.max_undistortion, factor)


def robust_deviations(distances: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return standard deviations from weighted medians of absolute distances, (M, N)."""
    order = np.argsort(distances, axis=1)
    sums = np.cumsum(weights[order], axis=1)
    middle = np.argmax(sums >= 0.5 * sums[:, -1:], axis=1)
    rows = np.arange(len(distances))
    return np.asarray(MAD_TO_DEVIATION * distances[rows, order[rows, middle]])


def measure_costs(
    lines: EpipolarLines,  # of the cameras
    rays: Rays,
    cameras: Cameras,
    scales: np.ndarray,  # px: deviations of the rays, for each of `PARAMETERS`
) -> np.ndarray:
    """Return robust costs (Geman–McClure) of cameras, (M,)."""
    inverse_scales = (0.5 / scales[cameras.groups, None]).astype(lines.offsets.dtype)
    square = np.square(lines.distances * inverse_scales)
    costs = np.where(lines.sides > 0, square / (1 + square), 1.0)
    mean = costs @ rays.trust / rays.trust.sum()
    return np.asarray(
        4 * INTRINSICS.independent_rays * mean + (cameras.values / cameras.priors) ** 2
    )
