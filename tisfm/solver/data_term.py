"""The data term: constraints of the images on the flow, computed anew at every warp.

Equations are numbered as in the paper (docs/method.md). A lane array holds an image as vertical
strips (`tisfm.kernels.layout.lanes`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tisfm.kernels.data.constraints import constancy_constraints, constraint_count
from tisfm.kernels.data.derivatives import DERIVATIVE_HALO, derivatives
from tisfm.kernels.data.warp import warp
from tisfm.kernels.layout.images import IMAGE_HALO, image_to_lanes, multiply
from tisfm.kernels.layout.lanes import LaneData, LaneGrid
from tisfm.kernels.layout.launch import join_launches
from tisfm.solver.sampling import weight_taps


@dataclass(frozen=True, kw_only=True)
class Constancy:
    """The constancy assumptions about both frames, and their weights."""

    # brightness, gradient: weights of the constancy of brightness (eq. 4) and of its gradient
    brightness: float
    gradient: float
    # ζ as a share of the mean |ΔI| between neighbours of frame 0: squared constraints are divided
    # by |∇I|² + ζ². None for constraints without normalisation.
    normalization: float | None
    # ε, px/frame (grey levels if constraints are not normalised); infinite for a quadratic data
    # term
    contrast: float = math.inf
    derivatives: str = "five_tap"  # scheme of the image derivatives, or "cube"

    @property
    def count(self) -> int:
        """Number of constraints per pixel."""
        return constraint_count(self.brightness, self.gradient)

    @property
    def scales(self) -> tuple[float, ...]:
        """Scale m ε² of each term in use, with m its weight (`tisfm.kernels.model.robust`)."""
        weights = (self.brightness, self.gradient)
        return tuple(weight * self.contrast**2 for weight in weights if weight > 0)


class DataTerm:
    """The constraints of a pair of grey frames."""

    def __init__(
        self,
        grid: LaneGrid,
        # frame0, frame1: (H, W) float32, grey levels
        frame0: np.ndarray,
        frame1: np.ndarray,
        # ((H + 3)·W, 4) float32: spline of frame 1 (`tisfm.solver.sampling.spline_taps`)
        spline1: np.ndarray,
        constancy: Constancy,
        unit: float,  # mean |ΔI| between neighbours of frame 0, grey levels; the unit of ζ
        # tuple of two (H, W) bool: pixels of each frame that are used, by default all. Ignored
        # pixels of frame 0, and pixels that move to an ignored pixel of frame 1, have no
        # constraints.
        valid: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        self.grid, self.constancy, self._unit = grid, constancy, unit
        self.scales = constancy.scales
        self._frame1 = grid.place(frame1)
        self._spline1 = grid.place(spline1, vectors=True)
        # lane array, 1 component, halo `IMAGE_HALO`: frame 0
        self.frame0 = grid.allocate(1, halo=IMAGE_HALO, zeros=False)
        self._warped1 = grid.allocate(1, halo=IMAGE_HALO, zeros=False)
        self._derivatives = grid.allocate(3, halo=DERIVATIVE_HALO, zeros=False)
        # lane array, 1 component: 1 at a used pixel that the flow of the last linearisation moves
        # to a point inside frame 1
        self.mask = grid.allocate(1, zeros=False)
        # lane array, 3 components for each constraint: (p, q, c)
        # (`tisfm.kernels.data.constraints`); each linearisation overwrites them
        self.constraints = grid.allocate(3 * constancy.count, zeros=False)
        image_to_lanes(grid, frame0, self.frame0)
        self._weights = None if valid is None else _PairWeights(grid, *valid)

    @property
    def normalization(self) -> float | None:
        """ζ, grey levels per px; None for constraints without normalisation."""
        share = self.constancy.normalization
        return None if share is None else share * self._unit

    def bind_linearise(
        self,
        flow: LaneData,  # lane array, 2 components: (u, v), px/frame, read at every call
        # lane array, 6 components: overwritten with the sum of the constraints' motion tensors,
        # with the robust weights of this flow
        tensor: LaneData | None = None,
    ) -> Callable[[], None]:
        """Return a function that warps frame 1 by a flow and writes `constraints` for it."""
        grid = self.grid
        weight_launches = [] if self._weights is None else [self._weights.bind(flow, self.mask)]
        return join_launches(
            warp.bind(grid, self._frame1, self._spline1, flow, self._warped1, self.mask),
            *weight_launches,
            self.bind_constraints(
                self.frame0, self._warped1, self._derivatives, flow, self.mask, self.constraints,
                tensor,
            ),
        )  # fmt: skip

    def bind_constraints(
        self,
        # frame0, frame1: lane arrays, 1 component, halo `IMAGE_HALO`: aligned frames
        frame0: LaneData,
        frame1: LaneData,
        # lane array, 3 components, halo `DERIVATIVE_HALO`; overwritten
        frame_derivatives: LaneData,
        flow: LaneData,
        mask: LaneData,  # lane array, 1 component: weight of each pixel
        constraints: LaneData,  # lane array, overwritten
        tensor: LaneData | None = None,  # lane array, 6 components: overwritten
    ) -> Callable[[], None]:
        """Return a function that writes the constraints of two frames that a flow has aligned."""
        grid, constancy = self.grid, self.constancy
        return join_launches(
            derivatives.bind(grid, frame0, frame1, frame_derivatives, scheme=constancy.derivatives),
            constancy_constraints.bind(
                grid,
                frame_derivatives,
                flow,
                mask,
                constraints,
                tensor,
                brightness=constancy.brightness,
                gradient=constancy.gradient,
                normalization=self.normalization,
                scales=constancy.scales,
            ),
        )


class _PairWeights:
    """The weights of pixels that are used in frame 0 and move to used pixels of frame 1."""

    def __init__(self, grid: LaneGrid, valid0: np.ndarray, valid1: np.ndarray) -> None:
        self._grid = grid
        self._weight0, self._weight1, self._inside = (grid.allocate(1) for _ in range(3))
        image_to_lanes(grid, valid0.astype(np.float32), self._weight0)
        image, taps = weight_taps(valid1.astype(np.float32))
        self._image1, self._spline1 = grid.place(image), grid.place(taps, vectors=True)

    def bind(self, flow: LaneData, mask: LaneData) -> Callable[[], None]:
        """Return a function that multiplies a mask by the weights for a flow."""
        grid = self._grid
        return join_launches(
            warp.bind(grid, self._image1, self._spline1, flow, self._weight1, self._inside),
            multiply.bind(grid, self._weight0, mask),
            multiply.bind(grid, self._weight1, mask),
        )
