"""The rigid motions that move no pixel, which sweeps and cycles find last.

Four fields of ρ̂ have no image motion, Gρ̂ = 0: τ along the line of sight, and each component of ω
with the τ that undoes it,

    (x̂, ŷ, 1, 0, 0, 0),            (x̂ŷ, 1 + ŷ², 0, 1, 0, 0),
    (−1 − x̂², −x̂ŷ, 0, 0, 1, 0),    (ŷ, −x̂, 0, 0, 0, 1).

The data do not see them, and they are so smooth that the smoothness hardly does: of all errors they
shrink most slowly. But how much of each is best follows from 4 equations, to the end.
"""

from collections.abc import Sequence

import numpy as np

from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.solver.unknowns import Unknowns

LEAST_SHARE = 1e-12  # of a pivot, below which fields are as good as dependent


class FlowlessFields:
    """Such fields on one level.

    Parameters
    ----------
    unknowns : Unknowns
        Of 6 or 3 components; with 3, only the first field is among them.
    """

    def __init__(self, unknowns: Unknowns) -> None:
        self._unknowns = unknowns
        self._count = 4 if unknowns.components == 6 else 1
        grid, camera = unknowns.grid, unknowns.camera
        cx, cy = camera.center_for(grid.height, grid.width)
        self._x = (np.arange(grid.width) - cx) / camera.focal
        self._y = (np.arange(grid.height) - cy) / camera.focal

    def minimise(self, system: LinearSystem) -> None:
        """Add to ρ̂ the multiple of each field that minimises the energy of a system.

        Parameters
        ----------
        system : LinearSystem
            With fixed weights; its tensor is not read.
        """
        rho = self._unknowns.images()
        matrix, vector = self._normal_equations(system, rho)
        if not (np.isfinite(matrix).all() and np.isfinite(vector).all()):
            return  # ρ̂ has run away, and its status says so
        scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(np.float64).tiny))
        shares, *_ = np.linalg.lstsq(matrix / np.outer(scale, scale), vector / scale, LEAST_SHARE)
        for component, field in enumerate(self._fields(shares / scale)):
            rho[component] += field
        self._unknowns.set_images(rho)

    def _normal_equations(
        self, system: LinearSystem, rho: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrix and the right-hand side for the shares of the fields, float64.

        Of the differences of neighbours, only those of τ1 and τ2 are not 0.
        """
        n, to_image = self._count, self._unknowns.to_image
        matrix, vector = np.zeros((n, n)), np.zeros(n)
        for component, steps in enumerate(self._steps()):
            k = min(component, system.sets - 1)
            alpha = float(system.alphas[component])
            for side, axis in enumerate((1, 0)):
                weight = to_image(system.weights, k + side * system.sets)
                weight = weight[:, :-1] if axis == 1 else weight[:-1]
                slope = weight * np.diff(rho[component], axis=axis)
                # Every step is a function of the row times one of the column.
                rows, columns = (np.stack(parts) for parts in zip(*steps[side][:n], strict=True))
                vector -= alpha * _weighted(slope, rows, columns)
                products = rows[:, None] * rows, columns[:, None] * columns
                matrix += alpha * _weighted(weight, *products)
        return matrix, vector

    def _steps(self) -> Sequence[Sequence[Sequence[tuple[np.ndarray, np.ndarray]]]]:
        """Return the differences of τ1 and τ2, to the east and to the south, of every field.

        Each as a function of the row and one of the column, whose product it is.
        """
        x, y, pitch = self._x, self._y, 1 / self._unknowns.camera.focal
        one_x, one_y = np.full(x.shape, pitch), np.ones(y.shape)
        zero_x, zero_y = np.zeros(x.shape), np.zeros(y.shape)
        east1 = (one_y, one_x), (y, one_x), (one_y, -(2 * x + pitch) * pitch), (zero_y, zero_x)
        south1 = (zero_y, zero_x), (one_y, x * pitch), (zero_y, zero_x), (one_y, one_x)
        east2 = (zero_y, zero_x), (zero_y, zero_x), (y, -one_x), (one_y, -one_x)
        south2 = (one_y, one_x), (2 * y + pitch, one_x), (one_y, -x * pitch), (zero_y, zero_x)
        return (
            ([(r, c[:-1]) for r, c in east1], [(r[:-1], c) for r, c in south1]),
            ([(r, c[:-1]) for r, c in east2], [(r[:-1], c) for r, c in south2]),
        )

    def _fields(self, shares: np.ndarray) -> list[np.ndarray]:
        """Return a sum of the fields, an array or a number for each component."""
        x, y = self._x, self._y[:, None]
        a, b, c, d = np.concatenate([shares, np.zeros(4 - len(shares))])
        tau = [
            a * x + b * x * y - c * (1 + x * x) + d * y,
            a * y + b * (1 + y * y) - c * x * y - d * x,
            a,
        ]
        return [*tau, b, c, d][: self._unknowns.components]


def _weighted(image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return Σ image · row · column over the pixels, for every pair of functions of them."""
    return np.asarray(((rows @ image) * columns).sum(axis=-1))
