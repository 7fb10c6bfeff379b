"""Labels that cost little and whose boundaries are short and lie on edges of the image."""

import math
from dataclasses import replace

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes
from tisfm.runtime import lane_grid
from tisfm.solver.half_quadratic import Effort, HalfQuadratic
from tisfm.solver.smoothness import Smoothness, image_edges_in_lanes
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
