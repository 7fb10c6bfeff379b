"""The box that the scene is clipped to, by numbers and by handles at two of its corners."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ViewFrame
from tisfm.view.controls import Controls
from tisfm.view.frame_cloud import Cloud
from tisfm.view.scene import SceneView
from tisfm.view.viewpoint import in_sight

if TYPE_CHECKING:
    from viser import ViserServer

Box = tuple[NDArray[np.float64], NDArray[np.float64]]
_HANDLE = 0.2  # length of the arrows, over the median depth
_NEAR = 1.5  # median depths: it does not begin around what is farther
_OUTSIDE = 2.0  # percent of the points that are beyond each side at first
_SHARES = np.linspace(1.0, 0.2, 33)  # of what is around the points, largest first
_STEPS = 50  # of the fields, in the median depth


class ClippingBox:
    """The box as the controls have it.

    Parameters
    ----------
    server : ViserServer
    controls : Controls
        A handle that is dragged changes their numbers.
    scene : SceneView
    """

    def __init__(self, server: "ViserServer", controls: Controls, scene: SceneView) -> None:
        self._server, self._scene = server, scene
        self._is_on, self._corners = controls.box, (controls.box_low, controls.box_high)
        self._handles: list[Any] = []
        self._dragged_to: list[tuple[float, ...]] = [(), ()]
        self._decimals = 3

    @property
    def ends(self) -> Box | None:
        """Least and greatest coordinates, (3,) each; None if nothing is clipped."""
        if not self._is_on.value:
            return None
        corners = np.array([corner.value for corner in self._corners], np.float64)
        return corners.min(axis=0), corners.max(axis=0)

    def begin_around(self, points: Cloud, frame: ViewFrame) -> None:
        """Let it begin around points of a frame, so small that its handles are in sight."""
        depth, pose = self._scene.depth, self._scene.pose_of(frame.number)
        step = float(f"{depth / _STEPS:.0e}")
        self._decimals = max(0, 1 - math.floor(math.log10(step)))
        if len(points):
            depths = points.positions[:, 2]
            near = points.positions[depths <= _NEAR * np.median(depths)]
            world = near @ pose[:3, :3].T + pose[:3, 3]
            ends = np.percentile(world, (_OUTSIDE, 100 - _OUTSIDE), axis=0)
        else:
            ends = pose[:3, 3] + depth * pose[:3, 2] + np.array([[-depth], [depth]])
        seen_from, _ = self._scene.overview(frame, points)
        middle, half = ends.mean(axis=0), np.diff(ends, axis=0)[0] / 2
        for share in _SHARES:
            ends = middle + share * np.stack([-half, half])
            if in_sight(ends, seen_from).all():
                break
        for corner, end in zip(self._corners, ends, strict=True):
            corner.step, corner.precision = step, self._decimals
            corner.value = tuple(np.round(end, self._decimals))

    def forget(self) -> None:
        """Remove its handles; the next time that it is shown it has others."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def show(self) -> None:
        """Show its edges and handles; nothing if it is off."""
        self._scene.show_box(self.ends)
        if not self._is_on.value:
            self.forget()
            return
        if not self._handles:
            self._handles = [self._handle(k) for k in range(2)]
        for k, (handle, corner) in enumerate(zip(self._handles, self._corners, strict=True)):
            # What is being dragged is where the hand is, ahead of what is drawn.
            if tuple(corner.value) != self._dragged_to[k]:
                handle.position = corner.value

    def _handle(self, k: int) -> Any:
        """Return arrows by which a corner is dragged."""
        handle = self._server.scene.add_transform_controls(
            f"/handles/corner{k}",
            scale=_HANDLE * self._scene.depth,
            disable_rotations=True,
            depth_test=False,
            position=self._corners[k].value,
        )
        handle.on_update(lambda event: self._drag(k, event.target.position))
        return handle

    def _drag(self, k: int, position: NDArray[np.float64]) -> None:
        self._dragged_to[k] = tuple(round(float(part), self._decimals) for part in position)
        self._corners[k].value = self._dragged_to[k]
