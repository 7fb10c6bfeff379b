"""Labels of least cost whose boundaries are short and lie on edges of the image.

`Potts` labels a whole image by a convex relaxation, `MinSum` a part of an image by belief
propagation.
"""

import math
from dataclasses import replace

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes
from tisfm.motion.objects.settings import OBJECTS
from tisfm.runtime import lane_grid
from tisfm.solver.half_quadratic import Effort, HalfQuadratic
from tisfm.solver.smoothness import MIN_GREY_STEP, Smoothness, image_driven_factor, mean_step
from tisfm.solver.unknowns import Unknowns

POTTS_SMOOTHNESS = Smoothness(
    alpha=20.0,
    contrast=0.05,  # step of a label's share above which the regulariser is total variation
    stiffness=(1.0,),
    joint=True,
    image_edges=5.0,  # boundaries lie on edges of the image
)


POTTS_EFFORT = Effort(
    outer_iterations=12, sweeps=10, relaxation=1.9, tolerance=5e-3, solver="cholesky"
)


class Potts:
    """Assigns labels by a convex relaxation of the Potts model.

    The share of every label is exp(−cost/2), normalised over labels. The solver of the
    interpretation smooths it: the energy is the weighted squared distance from the share plus the
    edge-preserving regularisation, which edges of the image interrupt. Each pixel takes the label
    of the largest smoothed share.

    References
    ----------
    Nieuwenhuis, Töppe, Cremers, "A survey and comparison of discrete and continuous multi-label
    optimization approaches for the Potts model", IJCV 104 (2013) 223, doi
    10.1007/s11263-013-0619-y.
    """

    def __init__(
        self,
        frame: np.ndarray,  # (H, W) float32: grey levels
        *,
        # Sampling density of the frame over that of the frames for which `POTTS_SMOOTHNESS` was
        # set. It scales the weight of boundaries: in a smaller frame, costs fall with the area,
        # boundaries only with the length.
        density: float = 1.0,
    ) -> None:
        self._smoothness = replace(POTTS_SMOOTHNESS, alpha=POTTS_SMOOTHNESS.alpha * density)
        self._grid = lane_grid(*frame.shape)
        self._edges = image_driven_factor(self._grid, frame, POTTS_SMOOTHNESS.image_edges)

    def assign(
        self,
        costs: np.ndarray,  # (K, H, W) float32: cost of every label
        # (H, W) float32: weight of each pixel's costs; at small weights the neighbours decide
        weight: np.ndarray,
    ) -> np.ndarray:
        """Return the labels, (H, W) int32."""
        if len(costs) == 1:
            return np.zeros(costs.shape[1:], np.int32)
        shares = np.exp(-0.5 * (costs - costs.min(axis=0)))
        shares /= shares.sum(axis=0)
        if len(costs) == 2:  # the second share is 1 minus the first
            return (self._smooth_share(shares[0], weight) < 0.5).astype(np.int32)
        smoothed = np.stack([self._smooth_share(share, weight) for share in shares])
        return smoothed.argmax(axis=0).astype(np.int32)

    def _smooth_share(self, share: np.ndarray, weight: np.ndarray) -> np.ndarray:
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
            unknowns,
            constraints,
            scales=(math.inf,),
            smoothness=self._smoothness,
            effort=POTTS_EFFORT,
        )
        minimiser.update()
        minimiser.minimise()
        return unknowns.images()[0]


# Steps to the eight neighbours; the steps of indices k and k ^ 1 are opposite.
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))


class MinSum:
    """Assigns labels of least cost and short boundaries to the pixels of a mask.

    This is min-sum belief propagation: in one direction after the other, each pixel sends a
    message to its neighbour, the least cost of each of the neighbour's labels given the messages
    from the other neighbours. Boundaries cost their length, as in the Potts model.

    References
    ----------
    Szeliski et al., "A comparative study of energy minimization methods for Markov random fields
    with smoothness-based priors", PAMI 30 (2008) 1068, doi 10.1109/TPAMI.2007.70844.
    """

    def __init__(
        self,
        is_free: np.ndarray,  # (H, W) bool: the mask; other pixels keep their labels
        frame: np.ndarray,  # (H, W) float32: grey levels
        *,
        length: float,  # cost of a boundary per px of its length, where the frame is uniform
        # κ: a step ΔI of the frame divides that cost by 1 + κ|ΔI|/m, with m the mean of |ΔI|
        image_edges: float,
    ) -> None:
        rows, columns = np.nonzero(is_free)
        mean_grey_step = max(mean_step(frame), MIN_GREY_STEP)
        count = len(rows)
        # `count` is a pixel that sends no message
        number = np.full(np.add(is_free.shape, 2), count)
        number[1:-1, 1:-1][is_free] = np.arange(count)
        inside = np.pad(np.ones(is_free.shape, bool), 1)
        padded = np.pad(frame, 1)
        grey = padded[rows + 1, columns + 1]
        self._neighbours, self._costs, self._fixed = [], [], []
        for down, right in NEIGHBOURS:
            neighbour = rows + 1 + down, columns + 1 + right
            distance = np.hypot(down, right)
            # With this factor, axis-aligned and diagonal boundaries cost their length.
            cost = (2 - 2**0.5) * length / distance * inside[neighbour]
            cost /= 1 + image_edges / (mean_grey_step * distance) * np.abs(padded[neighbour] - grey)
            self._neighbours.append(number[neighbour])
            self._costs.append(cost.astype(np.float32))
            is_fixed = np.flatnonzero((number[neighbour] == count) & inside[neighbour])
            self._fixed.append((is_fixed, neighbour[0][is_fixed] - 1, neighbour[1][is_fixed] - 1))

    def assign(
        self,
        costs: np.ndarray,  # (K, N) float32: cost of every label
        labels: np.ndarray,  # (H, W) int32: the labels of pixels outside the mask count
    ) -> np.ndarray:
        """Return the labels of the free pixels, (N,) int32."""
        count = len(costs)
        total = np.zeros((count, costs.shape[1] + 1), np.float32)
        total[:, :-1] = costs
        label_numbers = np.arange(count)[:, None]
        for (pixels, rows, columns), cost in zip(self._fixed, self._costs, strict=True):
            total[:, pixels] += cost[pixels] * (labels[rows, columns] != label_numbers)
        messages = np.zeros((len(NEIGHBOURS), *total.shape), np.float32)
        for _ in range(OBJECTS.message_rounds):
            for step, (neighbour, cost) in enumerate(
                zip(self._neighbours, self._costs, strict=True)
            ):
                # The neighbour's message: its total cost without the message that it got from here.
                message = total.take(neighbour, axis=1) - messages[step ^ 1].take(neighbour, axis=1)
                message -= message.min(axis=0)
                np.minimum(message, cost, out=message)
                message[:, neighbour == costs.shape[1]] = 0
                total[:, :-1] += message - messages[step, :, :-1]
                messages[step, :, :-1] = message
        return total[:, :-1].argmin(axis=0).astype(np.int32)
