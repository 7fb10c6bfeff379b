"""Labels of least cost on a part of an image: min-sum belief propagation."""

import numpy as np

from tisfm.solver.smoothness import FAINTEST_EDGE, mean_step

# A step to a neighbour, and the one back: pairs that follow one another.
STEPS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
ITERATIONS = 15


class MinSum:
    """Assigns labels that cost little, and whose boundaries do, to the pixels of a mask.

    Each pixel tells its eight neighbours, direction by direction, what their labels would cost it,
    by what it heard from the others. Boundaries cost their length, as in Potts' model.

    Parameters
    ----------
    free : (H, W) bool
        The mask; other pixels keep the label that they have.
    frame : (H, W) float32
        Grey levels.
    length : float
        What a boundary costs for every px of its length, where the frame is uniform.
    image_edges : float
        κ: across a step ΔI of the frame it costs 1/(1 + κ|ΔI|/m) of that, m the mean of |ΔI|.

    References
    ----------
    Szeliski et al., "A comparative study of energy minimization methods for Markov random fields
    with smoothness-based priors", PAMI 30 (2008) 1068, doi 10.1109/TPAMI.2007.70844.
    """

    def __init__(
        self,
        free: np.ndarray,
        frame: np.ndarray,
        *,
        length: float,
        image_edges: float,
    ) -> None:
        rows, columns = np.nonzero(free)
        usual = max(mean_step(frame), FAINTEST_EDGE)
        count = len(rows)
        number = np.full(np.add(free.shape, 2), count)  # of a pixel that says nothing
        number[1:-1, 1:-1][free] = np.arange(count)
        inside = np.pad(np.ones(free.shape, bool), 1)
        padded = np.pad(frame, 1)
        here = padded[rows + 1, columns + 1]
        self._neighbours, self._costs, self._fixed = [], [], []
        for down, right in STEPS:
            there = rows + 1 + down, columns + 1 + right
            apart = np.hypot(down, right)
            # With this factor, axis-aligned and diagonal boundaries cost their length.
            cost = (2 - 2**0.5) * length / apart * inside[there]
            cost /= 1 + image_edges / (usual * apart) * np.abs(padded[there] - here)
            self._neighbours.append(number[there])
            self._costs.append(cost.astype(np.float32))
            known = np.flatnonzero((number[there] == count) & inside[there])
            self._fixed.append((known, there[0][known] - 1, there[1][known] - 1))

    def assign(self, costs: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """Return the labels of the free pixels, (N,) int32.

        Parameters
        ----------
        costs : (K, N) float32
            Of every label.
        labels : (H, W) int32
            Of which those of other pixels count.
        """
        count = len(costs)
        total = np.zeros((count, costs.shape[1] + 1), np.float32)
        total[:, :-1] = costs
        own = np.arange(count)[:, None]
        for (known, rows, columns), cost in zip(self._fixed, self._costs, strict=True):
            total[:, known] += cost[known] * (labels[rows, columns] != own)
        heard = np.zeros((len(STEPS), *total.shape), np.float32)
        for _ in range(ITERATIONS):
            for step, (neighbour, cost) in enumerate(
                zip(self._neighbours, self._costs, strict=True)
            ):
                # What the neighbour says is all that it knows but for what it heard from here.
                says = total.take(neighbour, axis=1) - heard[step ^ 1].take(neighbour, axis=1)
                says -= says.min(axis=0)
                np.minimum(says, cost, out=says)
                says[:, neighbour == costs.shape[1]] = 0
                total[:, :-1] += says - heard[step, :, :-1]
                heard[step, :, :-1] = says
        return total[:, :-1].argmin(axis=0).astype(np.int32)
