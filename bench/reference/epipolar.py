"""Rigid motions: every pixel moves along a line, by an amount that its inverse depth gives."""

import numpy as np

from tisfm.camera import Camera

Array = np.ndarray  # of float64


def displacement(
    inverse_depth: Array, camera: Camera, rotation: Array, translation: Array
) -> Array:
    """Return the exact flow (u, v), (2, H, W), of pixels under P₁ = R P₀ + t.

    `inverse_depth`, (H, W), is D = f·d, px/frame for ‖t‖ = 1.
    """
    ray = rays(camera, *inverse_depth.shape)
    points = np.einsum("ij,jyx->iyx", rotation, ray)
    points += translation[:, None, None] * inverse_depth / camera.focal
    return camera.focal * (points[:2] / points[2] - ray[:2])


def restrict_to_line(
    terms: list[Array], flow: Array, direction: Array, inverse_depth: Array
) -> list[Array]:
    """Restrict each tensor to a line: return tensors of D for (u, v) = flow + (D − D₀)·direction.

    They have the form of tensors of a flow (D, 0). D₀ is `inverse_depth`, for which (u, v) = flow.
    """
    fixed = flow - inverse_depth * direction
    restricted = []
    for j11, j12, j22, j1, j2, jtt in terms:
        matrix = np.array([[j11, j12], [j12, j22]])
        vector = np.array([j1, j2])
        zero = np.zeros_like(j11)
        gradient = np.einsum("abyx,byx->ayx", matrix, fixed)
        square = np.einsum("ayx,abyx,byx->yx", direction, matrix, direction)
        linear = (direction * (gradient + vector)).sum(axis=0)
        constant = (fixed * (gradient + 2 * vector)).sum(axis=0) + jtt
        restricted.append(np.stack([square, zero, zero, linear, zero, constant]))
    return restricted


def motion_system(
    tensor: Array,  # (6, H, W), weighted sum of the data terms
    inverse_depth: Array,  # (H, W), D = f·d
    depth_weight: Array,  # (H, W), weight of the squared change of D
    camera: Camera,
    rotation: Array,
    translation: Array,
) -> tuple[Array, Array]:
    """Return the normal equations of a small change (δt, δω) of the motion, D eliminated.

    With (u, v) = flow + B (δt, δω) + a δD, the energy of a pixel is its data term plus
    `depth_weight`·δD². It is minimised over δD before the sum over pixels. The energy is constant +
    xᵀ matrix x + 2 xᵀ vector, with the returned matrix, (6, 6), and vector, (6,).
    """
    square, linear = _equations(tensor, inverse_depth, camera, rotation, translation)
    pivot = square[6, 6] + depth_weight
    matrix = square[:6, :6] - square[:6, 6][:, None] * square[6, :6] / pivot
    vector = linear[:6] - square[:6, 6] * linear[6] / pivot
    return matrix.sum(axis=(2, 3)), vector.sum(axis=(1, 2))


def frame_equations(
    tensor: Array,  # (6, H, W), weighted
    inverse_depth: Array,  # (H, W), D = f·d
    camera: Camera,
    rotation: Array,
    translation: Array,
) -> tuple[Array, Array, Array, Array]:
    """Return the normal equations of a frame's motion and of the depth that frames share.

    With e = J (u, v) + j: the sums of BᵀJB, (6, 6), and Bᵀe, (6,), over all pixels; then aᵀJB,
    (6, H, W), and aᵀJa and aᵀe, (2, H, W), of every pixel.
    """
    square, linear = _equations(tensor, inverse_depth, camera, rotation, translation)
    depth = np.stack([square[6, 6], linear[6]])
    return square[:6, :6].sum(axis=(2, 3)), linear[:6].sum(axis=(1, 2)), square[6, :6], depth


def motion_jacobian(
    inverse_depth: Array, camera: Camera, rotation: Array, translation: Array
) -> Array:
    """Return how (u, v) changes with (δt, δω) and with δD, (2, 7, H, W): B and a."""
    focal = camera.focal
    d = inverse_depth / focal
    x, y, z = _points(inverse_depth, camera, rotation, translation)
    zero = np.zeros_like(x)
    # d(f·x/z) and d(f·y/z) of the point, and the point's own changes: d·δt + δω × P, and δD·t/f.
    projection = focal * np.array([[1 / z, zero, -x / z**2], [zero, 1 / z, -y / z**2]])
    cross = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])  # δω × P = cross · δω
    change = np.concatenate([np.eye(3)[..., None, None] * d, cross], axis=1)
    b = np.einsum("ckyx,kmyx->cmyx", projection, change)
    a = np.einsum("ckyx,k->cyx", projection, translation) / focal
    return np.concatenate([b, a[:, None]], axis=1)


def _equations(
    tensor: Array, inverse_depth: Array, camera: Camera, rotation: Array, translation: Array
) -> tuple[Array, Array]:
    """Return GᵀJG and Gᵀe of every pixel, G of `motion_jacobian`: (7, 7, H, W) and (7, H, W)."""
    full = motion_jacobian(inverse_depth, camera, rotation, translation)
    point = _points(inverse_depth, camera, rotation, translation)
    j11, j12, j22, j1, j2, _ = tensor
    j = np.array([[j11, j12], [j12, j22]])
    flow = camera.focal * (point[:2] / point[2] - rays(camera, *inverse_depth.shape)[:2])
    gradient = np.einsum("abyx,byx->ayx", j, flow) + np.array([j1, j2])
    square = np.einsum("akyx,abyx,blyx->klyx", full, j, full)
    return square, np.einsum("akyx,ayx->kyx", full, gradient)


def _points(inverse_depth: Array, camera: Camera, rotation: Array, translation: Array) -> Array:
    """Return R x̂ + d t of every pixel, (3, H, W)."""
    ray = rays(camera, *inverse_depth.shape)
    rotated = np.einsum("ij,jyx->iyx", rotation, ray)
    return np.asarray(rotated + translation[:, None, None] * inverse_depth / camera.focal)


def rays(camera: Camera, height: int, width: int) -> Array:
    """Return (x̂, ŷ, 1) of every pixel, (3, H, W)."""
    cx, cy = camera.center_for(height, width)
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    return np.stack([(columns - cx) / camera.focal, (rows - cy) / camera.focal, np.ones_like(rows)])
