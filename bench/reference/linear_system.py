"""The linear system of fixed weights (eq. 16, 22–23), and sweeps over it."""

import numpy as np

Array = np.ndarray  # of float64


def local_matrices(tensor: Array, motion: Array, weights: Array, alpha: float) -> Array:
    """Return B, (H, W, n, n), of Bρ̂ = c (eq. 16, 22–23) at every pixel."""
    n = motion.shape[1]
    j11, j12, j22, *_ = tensor
    total = np.sum(_neighbour_weights(weights), axis=0)  # b̄, eq. 17
    j_motion = np.stack([j11 * motion[0] + j12 * motion[1], j12 * motion[0] + j22 * motion[1]])
    matrix = np.einsum("ckyx,clyx->yxkl", motion, j_motion)
    matrix[..., range(n), range(n)] += alpha * np.moveaxis(total, 0, -1)
    return matrix


def local_right_sides(
    tensor: Array, motion: Array, weights: Array, rho: Array, alpha: float
) -> Array:
    """Return c, (H, W, n), of Bρ̂ = c at every pixel."""
    north, south, east, west = _neighbour_weights(weights)
    neighbours = np.zeros_like(rho)  # Σ b_N ρ̂_N, eq. 17
    neighbours[:, 1:] += north[:, 1:] * rho[:, :-1]
    neighbours[:, :-1] += south[:, :-1] * rho[:, 1:]
    neighbours[:, :, :-1] += east[:, :, :-1] * rho[:, :, 1:]
    neighbours[:, :, 1:] += west[:, :, 1:] * rho[:, :, :-1]
    right = alpha * neighbours - motion[0] * tensor[3] - motion[1] * tensor[4]
    return np.moveaxis(right, 0, -1)


def _neighbour_weights(weights: Array) -> tuple[Array, Array, Array, Array]:
    """Return b to the north, south, east and west of every pixel, each (n, H, W)."""
    n = len(weights) // 2
    east, south = weights[:n], weights[n:]
    north, west = np.zeros_like(south), np.zeros_like(east)
    north[:, 1:] = south[:, :-1]
    west[:, :, 1:] = east[:, :, :-1]
    return north, south, east, west


def sweep_lexicographic(
    tensor: Array,
    motion: Array,
    weights: Array,
    rho: Array,
    *,
    alpha: float,
    relaxation: float = 1.0,
) -> None:
    """Gauss–Seidel in reading order, one pixel at a time; `rho` is modified in place."""
    n, height, width = rho.shape
    j11, j12, j22, j1, j2, _ = tensor
    east, south = weights[:n], weights[n:]
    for y in range(height):
        for x in range(width):
            g = motion[:, :, y, x]
            tensor_here = np.array([[j11[y, x], j12[y, x]], [j12[y, x], j22[y, x]]])
            right = -g.T @ np.array([j1[y, x], j2[y, x]])
            total = np.zeros(n)
            for edge, is_inside, ny, nx in (
                (east[:, y, x], x + 1 < width, y, x + 1),
                (east[:, y, x - 1], x > 0, y, x - 1),
                (south[:, y, x], y + 1 < height, y + 1, x),
                (south[:, y - 1, x], y > 0, y - 1, x),
            ):
                if is_inside:
                    total += edge
                    right += alpha * edge * rho[:, ny, nx]
            matrix = g.T @ tensor_here @ g + alpha * np.diag(total)
            rho[:, y, x] += relaxation * (np.linalg.solve(matrix, right) - rho[:, y, x])


def sweep_red_black(
    tensor: Array,
    motion: Array,
    weights: Array,
    rho: Array,
    *,
    alpha: float,
    relaxation: float = 1.0,
) -> None:
    """Gauss–Seidel over all red pixels at once, then all black pixels; `rho` is modified in place.

    Red pixels have an even sum of row and column.
    """
    rows, columns = np.indices(rho.shape[1:])
    matrix = local_matrices(tensor, motion, weights, alpha)
    for color in (0, 1):
        sites = (rows + columns) % 2 == color
        right = local_right_sides(tensor, motion, weights, rho, alpha)
        solution = np.linalg.solve(matrix[sites], right[sites][..., None])[..., 0].T
        rho[:, sites] += relaxation * (solution - rho[:, sites])
