"""Correction of ρ̂ along fields without image motion, which sweeps and cycles correct slowly.

ρ̂ = (τ, ω)·f are the unknowns of a pixel: τ is the translation over depth, ω the rotation, and f the
focal length. Gρ̂ is their image motion at the pixel (x̂, ŷ) for f = 1. Four fields of ρ̂ have no image
motion, Gρ̂ = 0: τ along the line of sight, and each component of ω with the τ that cancels its image
motion,

    (x̂, ŷ, 1, 0, 0, 0),            (x̂ŷ, 1 + ŷ², 0, 1, 0, 0),
    (−1 − x̂², −x̂ŷ, 0, 0, 1, 0),    (ŷ, −x̂, 0, 0, 0, 1).

The data term does not depend on these fields. The fields are so smooth that the smoothness
term hardly depends on them either, so errors along them shrink most slowly. The best multiple of
each field follows exactly from 4 linear equations.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.solver.unknowns import Unknowns

# share of the largest singular value below which fields count as dependent
MIN_SINGULAR_VALUE = 1e-12
BAND_ROWS = 64  # image rows that are computed at a time, in float64


class FlowlessFields:
    """The fields without image motion on one level."""

    def __init__(
        self,
        unknowns: Unknowns,  # with 6 or 3 components; with 3, only the first field exists
    ) -> None:
        self._unknowns = unknowns
        self._count = 4 if unknowns.components == 6 else 1
        grid, camera = unknowns.grid, unknowns.camera
        cx, cy = camera.center_for(grid.height, grid.width)
        self._x = (np.arange(grid.width) - cx) / camera.focal
        self._y = (np.arange(grid.height) - cy) / camera.focal

    def minimise(
        self,
        system: LinearSystem,  # its weights are fixed; its tensor is not read
    ) -> None:
        """Add to ρ̂ the multiple of each field that minimises the energy of a system."""
        matrix, vector = self._normal_equations(system)
        if not (np.isfinite(matrix).all() and np.isfinite(vector).all()):
            return  # ρ̂ has diverged; the status of the result will say so
        scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(np.float64).tiny))
        scaled_multiples, *_ = np.linalg.lstsq(
            matrix / np.outer(scale, scale), vector / scale, MIN_SINGULAR_VALUE
        )
        unknowns = self._unknowns
        for component, (rows, columns) in enumerate(self._fields(scaled_multiples / scale)):
            image = unknowns.to_image(unknowns.rho, component)
            for band in _bands(len(image)):
                image[band] += rows[:, band].T @ columns
            unknowns.set_image(component, image)

    def _normal_equations(self, system: LinearSystem) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrix and the right-hand side for the multiples of the fields, float64.

        Only the first two components of a field, τ1 and τ2, vary from pixel to pixel, so the
        equations contain the differences of these components alone.
        """
        n, unknowns = self._count, self._unknowns
        matrix, vector = np.zeros((n, n)), np.zeros(n)
        for component, steps in enumerate(self._steps()):
            k = min(component, system.weights_per_edge - 1)
            alpha = float(system.alphas[component])
            rho = unknowns.to_image(unknowns.rho, component)
            for side, step in enumerate(steps):
                # Every step is a function of the row times a function of the column.
                rows, columns = (np.stack(parts) for parts in zip(*step[:n], strict=True))
                products, slopes = _sum_steps(
                    unknowns.to_image(system.weights, k + side * system.weights_per_edge),
                    rho,
                    rows,
                    columns,
                    axis=1 - side,
                )
                matrix += alpha * products
                vector -= alpha * slopes
        return matrix, vector

    def _steps(self) -> Sequence[Sequence[Sequence[tuple[np.ndarray, np.ndarray]]]]:
        """Return the differences of τ1 and τ2, to the east and to the south, of every field.

        Each difference is the product of a function of the row and a function of the column.
        """
        x, y, pitch = self._x, self._y, 1 / self._unknowns.camera.focal  # pitch: step of x̂ and ŷ
        pitch_x, one_y = np.full(x.shape, pitch), np.ones(y.shape)
        zero_x, zero_y = np.zeros(x.shape), np.zeros(y.shape)
        east1 = (one_y, pitch_x), (y, pitch_x), (one_y, -(2 * x + pitch) * pitch), (zero_y, zero_x)
        south1 = (zero_y, zero_x), (one_y, x * pitch), (zero_y, zero_x), (one_y, pitch_x)
        east2 = (zero_y, zero_x), (zero_y, zero_x), (y, -pitch_x), (one_y, -pitch_x)
        south2 = (one_y, pitch_x), (2 * y + pitch, pitch_x), (one_y, -x * pitch), (zero_y, zero_x)
        return (
            ([(r, c[:-1]) for r, c in east1], [(r[:-1], c) for r, c in south1]),
            ([(r, c[:-1]) for r, c in east2], [(r[:-1], c) for r, c in south2]),
        )

    def _fields(self, multiples: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return a weighted sum of the fields, as row and column functions for each component.

        A component is the sum over products of a row function and a column function.
        """
        x, y = self._x, self._y
        one_x, one_y = np.ones(x.shape), np.ones(y.shape)
        a, b, c, d = np.concatenate([multiples, np.zeros(4 - len(multiples))])
        tau1 = np.stack([one_y, y]), np.stack([a * x - c * (1 + x * x), b * x + d])
        tau2 = np.stack([a * y + b * (1 + y * y), -c * y - d]), np.stack([one_x, x])
        constants = [(one_y[None], value * one_x[None]) for value in (a, b, c, d)]
        return [tau1, tau2, *constants][: self._unknowns.components]


def _bands(height: int) -> Iterator[slice]:
    """Yield the rows of an image in bands."""
    return (slice(first, min(first + BAND_ROWS, height)) for first in range(0, height, BAND_ROWS))


def _sum_steps(
    # weights, rho: (H, W): weights b of the edges along an axis, and a component of ρ̂
    weights: np.ndarray,
    rho: np.ndarray,
    # rows, columns: (n, H') and (n, W'): functions of the row and of the column. Their product is
    # the step of each field from a pixel to the next pixel along the axis.
    rows: np.ndarray,
    columns: np.ndarray,
    *,
    axis: int,  # {1, 0}
) -> tuple[np.ndarray, np.ndarray]:
    """Return Σ b·step·step for every pair of fields, and Σ b·Δρ̂·step for every field."""
    n = len(rows)
    products, slopes = np.zeros((n, n)), np.zeros(n)
    for band in _bands(rows.shape[1]):
        row, weight = rows[:, band], weights[band, : columns.shape[1]]
        rho_rows = slice(band.start, band.stop + (axis == 0))
        slopes += _weighted_sums(weight * np.diff(rho[rho_rows], axis=axis), row, columns)
        products += _weighted_sums(weight, row[:, None] * row, columns[:, None] * columns)
    return products, slopes


def _weighted_sums(image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return Σ image · row · column over the pixels, for every pair of row and column functions."""
    return np.asarray(((rows @ image) * columns).sum(axis=-1))
