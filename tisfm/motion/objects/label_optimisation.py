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

    The share of every label is exp(−cost/2), normalised over labels. The half-quadratic solver
    smooths the share: the energy is the weighted squared distance from the share plus an
    edge-preserving regularisation, which is weaker across contours of the image. Each pixel takes
    the label of the largest smoothed share.

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
        # sampling density of the frame divided by the density for which `POTTS_SMOOTHNESS` was set.
        # It scales the weight of boundaries: in a smaller frame, costs fall with the area,
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
        smooth_shares = np.stack([self._smooth_share(share, weight) for share in shares])
        return smooth_shares.argmax(axis=0).astype(np.int32)

    def _smooth_share(self, share: np.ndarray, weight: np.ndarray) -> np.ndarray:
        grid = self._grid
        unknowns = Unknowns(grid, Camera(), 1)
        unknowns.edges = self._edges
        unknowns.set_images(share[None].astype(np.float32))
        # weight · (p − share)² as a constraint on the flow (p, 0).
        root_weight = np.sqrt(weight).astype(np.float32)
        constraints = grid.allocate(3)
        for component, values in ((0, root_weight), (2, -root_weight * share)):
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

    This is min-sum belief propagation. In one direction after the other, each pixel sends a message
    to its neighbour: the least cost of each of the neighbour's labels, given the messages from the
    other neighbours. Boundaries cost their length, as in the Potts model.

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
        # κ: a step ΔI of the frame divides `length` by 1 + κ|ΔI|/m, with m the mean of |ΔI|
        image_edges: float,
    ) -> None:
        rows, columns = np.nonzero(is_free)
        mean_grey_step = max(mean_step(frame), MIN_GREY_STEP)
        count = len(rows)
        # the number `count` stands for the pixels outside the mask, which send no message
        pixel_number = np.full(np.add(is_free.shape, 2), count)
        pixel_number[1:-1, 1:-1][is_free] = np.arange(count)
        is_inside = np.pad(np.ones(is_free.shape, bool), 1)
        image = np.pad(frame, 1)
        grey = image[rows + 1, columns + 1]
        self._neighbours, self._costs, self._fixed_neighbours = [], [], []
        for row_step, column_step in NEIGHBOURS:
            neighbour = rows + 1 + row_step, columns + 1 + column_step
            distance = np.hypot(row_step, column_step)
            # With this factor, axis-aligned and diagonal boundaries cost their length.
            cost = (2 - 2**0.5) * length / distance * is_inside[neighbour]
            cost /= 1 + image_edges / (mean_grey_step * distance) * np.abs(image[neighbour] - grey)
            self._neighbours.append(pixel_number[neighbour])
            self._costs.append(cost.astype(np.float32))
            fixed_index = np.flatnonzero((pixel_number[neighbour] == count) & is_inside[neighbour])
            self._fixed_neighbours.append(
                (fixed_index, neighbour[0][fixed_index] - 1, neighbour[1][fixed_index] - 1)
            )

    def assign(
        self,
        costs: np.ndarray,  # (K, N) float32: cost of every label
        labels: np.ndarray,  # (H, W) int32: labels of all pixels; outside the mask they are fixed
    ) -> np.ndarray:
        """Return the labels of the free pixels, (N,) int32."""
        count = len(costs)
        sums = np.zeros((count, costs.shape[1] + 1), np.float32)
        sums[:, :-1] = costs
        label_numbers = np.arange(count)[:, None]
        for (pixels, rows, columns), cost in zip(self._fixed_neighbours, self._costs, strict=True):
            sums[:, pixels] += cost[pixels] * (labels[rows, columns] != label_numbers)
        messages = np.zeros((len(NEIGHBOURS), *sums.shape), np.float32)
        for _ in range(OBJECTS.message_rounds):
            for step, (neighbour, cost) in enumerate(
                zip(self._neighbours, self._costs, strict=True)
            ):
                # The neighbour's message is its sum of costs without the message from this pixel.
                message = sums.take(neighbour, axis=1) - messages[step ^ 1].take(neighbour, axis=1)
                message -= message.min(axis=0)
                np.minimum(message, cost, out=message)
                message[:, neighbour == costs.shape[1]] = 0
                sums[:, :-1] += message - messages[step, :, :-1]
                messages[step, :, :-1] = message
        return sums[:, :-1].argmin(axis=0).astype(np.int32)
