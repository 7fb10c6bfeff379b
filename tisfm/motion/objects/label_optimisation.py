"""Labels of least cost whose boundaries are short and lie on edges of the image.

`Potts` labels a whole image by moves of graph cuts on it, `MinSum` a part of one by belief
propagation.
"""

import math
from dataclasses import replace

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes
from tisfm.runtime import lane_grid
from tisfm.solver.half_quadratic import Effort, HalfQuadratic
from tisfm.solver.smoothness import FAINTEST_EDGE, Smoothness, image_edges_in_lanes, mean_step
from tisfm.solver.unknowns import Unknowns

SMOOTHNESS = Smoothness(
    alpha=20.0,
    contrast=0.05,  # of a share of a label: total variation, but for the smallest steps
    stiffness=(1.0,),
    joint=True,
    image_edges=5.0,  # boundaries lie on edges of the image
)


EFFORT = Effort(outer_iterations=12, sweeps=10, relaxation=1.9, tolerance=5e-3, solver="cholesky")


class Potts:
    """Assigns labels by a convex relaxation of Potts' model.

    The share of every label, exp(−cost/2) normalised over labels, is smoothed by the solver of
    the interpretation itself: squared distance from it, weighted, plus the edge-preserving
    regularisation, cut by the edges of the image. The label of the largest share is taken.

    Parameters
    ----------
    frame : (H, W) float32
        Grey levels.
    density : float
        How densely it is sampled, of the frames whose boundaries weigh what `SMOOTHNESS` says.
        With fewer pixels on either side, boundaries count for less: costs fall with the area,
        boundaries with the length.

    References
    ----------
    Nieuwenhuis, Töppe, Cremers, "A survey and comparison of discrete and continuous multi-label
    optimization approaches for the Potts model", IJCV 104 (2013) 223, doi
    10.1007/s11263-013-0619-y.
    """

    def __init__(self, frame: np.ndarray, *, density: float = 1.0) -> None:
        self._smoothness = replace(SMOOTHNESS, alpha=SMOOTHNESS.alpha * density)
        self._grid = lane_grid(*frame.shape)
        self._edges = image_edges_in_lanes(self._grid, frame, SMOOTHNESS.image_edges)

    def assign(self, costs: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return the labels, (H, W) int32.

        Parameters
        ----------
        costs : (K, H, W) float32
            Of every label.
        weight : (H, W) float32
            How far each pixel has a say; elsewhere its neighbours decide.
        """
        if len(costs) == 1:
            return np.zeros(costs.shape[1:], np.int32)
        shares = np.exp(-0.5 * (costs - costs.min(axis=0)))
        shares /= shares.sum(axis=0)
        if len(costs) == 2:  # the second share is what the first leaves of 1
            return (self._smoothed(shares[0], weight) < 0.5).astype(np.int32)
        smoothed = np.stack([self._smoothed(share, weight) for share in shares])
        return smoothed.argmax(axis=0).astype(np.int32)

    def _smoothed(self, share: np.ndarray, weight: np.ndarray) -> np.ndarray:
        grid = self._grid
        unknowns = Unknowns(grid, Camera(), 1)
        unknowns.edges = self._edges
        unknowns.set_images(share[None].astype(np.float32))
        # weight · (p − share)² as a constraint on the flow (p, 0).
        root = np.sqrt(weight).astype(np.float32)
        constraints = grid.allocate(3)
        for component, values in ((0, root), (2, -root * share)):
            image_to_lanes(
                grid, np.ascontiguousarray(values, np.float32), constraints, component=component
            )
        minimiser = HalfQuadratic(
            unknowns, constraints, scales=(math.inf,), smoothness=self._smoothness, effort=EFFORT
        )
        minimiser.update()
        minimiser.minimise()
        return unknowns.images()[0]


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
