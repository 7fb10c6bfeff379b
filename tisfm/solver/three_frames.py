"""The data term of a frame with its next and its previous frame: one set of constraints.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Callable

import numpy as np

from tisfm.kernels.data.derivatives import DERIVATIVE_HALO
from tisfm.kernels.data.three_frames import backward_flow, join_constraints
from tisfm.kernels.data.warp import warp
from tisfm.kernels.layout.images import IMAGE_HALO, image_to_lanes
from tisfm.kernels.layout.lanes import LaneData
from tisfm.kernels.layout.launch import join_launches
from tisfm.solver.data_term import DataTerm


class ThreeFrameData:
    """The constraints of a pair, joined with the constraints of the previous frame.

    Let w be the flow to the next frame, and the bend the sum of the flows to the next and to the
    previous frame. Then the flow to the previous frame is bend − w. A constraint on this flow is
    therefore a constraint on w, and no unknowns are added.
    """

    def __init__(
        self,
        # data term of the pair; the joint constraints overwrite its constraints
        data_term: DataTerm,
        # (H, W) float32: the previous frame, grey levels, smoothed like the frames of the pair
        previous: np.ndarray,
        # ((H + 3)·W, 4) float32: `tisfm.solver.sampling.spline_taps` of the previous frame
        taps: np.ndarray,
        bend: np.ndarray,  # (2, H, W) float32: px/frame
        # two (H, W) float32, in [0, 1]: visibility of each pixel in the next frame, and in the
        # previous frame
        trust: tuple[np.ndarray, np.ndarray],
    ) -> None:
        grid = data_term.grid
        self._pair = data_term
        self._frame, self._taps = grid.place(previous), grid.place(taps, vectors=True)
        self._warped = grid.allocate(1, halo=IMAGE_HALO, zeros=False)
        self._derivatives = grid.allocate(3, halo=DERIVATIVE_HALO, zeros=False)
        self._mask = grid.allocate(1, zeros=False)
        self._constraints = grid.allocate(3 * data_term.constancy.count, zeros=False)
        self._flow, self._bend, self._trust = (grid.allocate(2, zeros=False) for _ in range(3))
        for component in range(2):
            image_to_lanes(grid, bend[component], self._bend, component=component)
            image_to_lanes(grid, trust[component], self._trust, component=component)

    def bind_linearise(
        self,
        # lane array, 2 components: (u, v) to the next frame, px/frame, read at every call
        flow: LaneData,
        # lane array, 6 components: overwritten with the sum of the constraints' motion tensors,
        # with the robust weights of this flow
        tensor: LaneData,
    ) -> Callable[[], None]:
        """Return a function that warps both frames by a flow and writes the joint constraints."""
        pair = self._pair
        grid = pair.grid
        return join_launches(
            pair.bind_linearise(flow),
            backward_flow.bind(grid, flow, self._bend, self._flow),
            warp.bind(grid, self._frame, self._taps, self._flow, self._warped, self._mask),
            # The previous frame takes the part of frame 0 here, since it is earlier: so I_t has the
            # sign that belongs to w.
            pair.bind_constraints(
                self._warped, pair.frame0, self._derivatives, flow, self._mask, self._constraints
            ),
            join_constraints.bind(
                grid,
                self._constraints,
                self._trust,
                pair.mask,
                self._mask,
                flow,
                pair.constancy.scales,
                pair.constraints,
                tensor,
            ),
        )
