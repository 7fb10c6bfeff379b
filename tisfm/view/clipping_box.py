"""The clipping box of the scene, set by numbers or by handles at two of its corners."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ResultFrame
from tisfm.view.controls import Controls
from tisfm.view.frame_cloud import FrameCloud
from tisfm.view.scene import ViewerScene
from tisfm.view.viewpoint import are_visible

if TYPE_CHECKING:
    from viser import ViserServer

Box = tuple[NDArray[np.float64], NDArray[np.float64]]
# Set by hand.
_HANDLE_LENGTH = 0.2  # of the arrows of a handle, in median depths
_MAX_DEPTH = 1.5  # in median depths: the first box does not contain farther points
_OUTSIDE_PERCENT = 2.0  # percent of the points beyond each side of the first box
_SIZE_SHARES = np.linspace(1.0, 0.2, 33)  # shares of the size of the first box that are tried
_STEPS = 50  # steps of the number fields in a median depth


class ClippingBox:
    """The box that the controls choose."""

    def __init__(
        self,
        server: "ViserServer",
        controls: Controls,  # a handle that is dragged changes their numbers
        scene: ViewerScene,
    ) -> None:
        self._server, self._scene = server, scene
        self._switch, self._corners = controls.box, (controls.box_low, controls.box_high)
        self._handles: list[Any] = []
        self._drag_positions: list[tuple[float, ...]] = [(), ()]
        self._decimals = 3

    @property
    def ends(self) -> Box | None:
        """Least and greatest coordinates, (3,) each; None if the box is off."""
        if not self._switch.value:
            return None
        corners = np.array([corner.value for corner in self._corners], np.float64)
        return corners.min(axis=0), corners.max(axis=0)

    def fit(self, points: FrameCloud, frame: ResultFrame) -> None:
        """Put the first box around points of a frame, with both handles visible."""
        depth, pose = self._scene.depth, self._scene.pose_of(frame.number)
        step = float(f"{depth / _STEPS:.0e}")
        self._decimals = max(0, 1 - math.floor(math.log10(step)))
        if len(points):
            depths = points.positions[:, 2]
            near_points = points.positions[depths <= _MAX_DEPTH * np.median(depths)]
            world_points = near_points @ pose[:3, :3].T + pose[:3, 3]
            ends = np.percentile(world_points, (_OUTSIDE_PERCENT, 100 - _OUTSIDE_PERCENT), axis=0)
        else:
            ends = pose[:3, 3] + depth * pose[:3, 2] + np.array([[-depth], [depth]])
        viewpoint, _ = self._scene.overview(frame, points)
        middle, half_size = ends.mean(axis=0), np.diff(ends, axis=0)[0] / 2
        for share in _SIZE_SHARES:
            ends = middle + share * np.stack([-half_size, half_size])
            if are_visible(ends, viewpoint).all():
                break
        for corner, end in zip(self._corners, ends, strict=True):
            corner.step, corner.precision = step, self._decimals
            corner.value = tuple(np.round(end, self._decimals))

    def remove_handles(self) -> None:
        """Remove the handles; `show` makes new ones."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def show(self) -> None:
        """Show the edges and handles of the box, if it is on."""
        self._scene.show_box(self.ends)
        if not self._switch.value:
            self.remove_handles()
            return
        if not self._handles:
            self._handles = [self._make_handle(k) for k in range(2)]
        for k, (handle, corner) in enumerate(zip(self._handles, self._corners, strict=True)):
            # If a drag set the corner, its handle is there already, or farther along the drag.
            if tuple(corner.value) != self._drag_positions[k]:
                handle.position = corner.value

    def _make_handle(self, k: int) -> Any:
        """Return arrows that drag a corner."""
        handle = self._server.scene.add_transform_controls(
            f"/handles/corner{k}",
            scale=_HANDLE_LENGTH * self._scene.depth,
            disable_rotations=True,
            depth_test=False,
            position=self._corners[k].value,
        )
        handle.on_update(lambda event: self._drag(k, event.target.position))
        return handle

    def _drag(self, k: int, position: NDArray[np.float64]) -> None:
        self._drag_positions[k] = tuple(round(float(part), self._decimals) for part in position)
        self._corners[k].value = self._drag_positions[k]
