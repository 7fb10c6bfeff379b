"""The viewpoints of the browsers that show a page."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from tisfm.results.frame import ResultFrame
from tisfm.view.frame_cloud import FrameCloud
from tisfm.view.scene import ViewerScene, quaternion
from tisfm.view.viewpoint import FOV, USUAL_ASPECT, following_fov

if TYPE_CHECKING:
    from viser import CameraHandle, ClientHandle, ViserServer

# Set by hand.
# change of log(width / height) of a window from which the view is fitted again
_MIN_ASPECT_CHANGE = 0.1
_MIN_MOVE = 1e-3  # median depths: with a larger distance, a user has moved the view


class Browsers:
    """Moves browsers to viewpoints that show the current frame.

    Parameters
    ----------
    server : ViserServer
    scene : ViewerScene
    is_followed : callable
        Returns whether browsers look from the position of the camera.

    Attributes
    ----------
    frame, points : ResultFrame, FrameCloud or None
        The current frame and its points.
    """

    def __init__(
        self, server: "ViserServer", scene: ViewerScene, is_following: Callable[[], bool]
    ) -> None:
        self.frame: ResultFrame | None = None
        self.points: FrameCloud | None = None
        self._server, self._scene, self._is_following = server, scene, is_following

    def move_all_to_overview(self) -> None:
        """Move all browsers to a viewpoint that shows the frame and its points."""
        for client in self._server.get_clients().values():
            self.move_to_overview(client)

    def follow_all(self) -> None:
        """Move all browsers to the position of the camera."""
        for client in self._server.get_clients().values():
            self._follow(client)

    def move_to_overview(self, client: "ClientHandle") -> None:
        """Move a browser to a viewpoint that shows the frame and its points."""
        if self.frame is None:
            return
        pose, distance = self._scene.overview(self.frame, self.points, client.camera.aspect)
        with client.atomic():
            client.camera.up_direction = self._scene.up
            client.camera.wxyz = quaternion(pose)
            client.camera.position = pose[:3, 3]
            client.camera.look_at = pose[:3, 3] + distance * pose[:3, 2]
            client.camera.fov = FOV

    def add(self, client: "ClientHandle") -> None:
        """Fit the view of a new browser to its window, until its user moves the view.

        A browser that follows the camera is always fitted, so that the whole frame is visible.
        """
        fitted_aspect, is_placed, was_moved = USUAL_ASPECT, False, False
        # width over height of the window that the field of view was fitted to
        followed_aspect = 0.0
        home = np.asarray(self._server.initial_camera.position)

        def fit(camera: "CameraHandle") -> None:
            nonlocal fitted_aspect, home, is_placed, was_moved, followed_aspect
            is_home = bool(np.linalg.norm(camera.position - home) <= _MIN_MOVE * self._scene.depth)
            is_due = camera.aspect != followed_aspect or (is_home and not is_placed)
            if self._is_following() and is_due:
                followed_aspect = camera.aspect
                self._follow(client)
            is_placed |= is_home  # until then, the browser has not received its first viewpoint
            was_moved |= is_placed and not is_home
            if self._is_following():
                return
            if (
                is_home
                and not was_moved
                and abs(np.log(camera.aspect / fitted_aspect)) > _MIN_ASPECT_CHANGE
            ):
                fitted_aspect = camera.aspect
                self.move_to_overview(client)
                home = np.array(camera.position)

        client.camera.on_update(fit)
        fit(client.camera)

    def _follow(self, client: "ClientHandle") -> None:
        """Move a browser to the position of the camera, with the whole frame visible."""
        frame = self.frame
        if frame is None:
            return
        pose = self._scene.pose_of(frame.number)
        with client.atomic():
            client.camera.wxyz = quaternion(pose)
            client.camera.position = pose[:3, 3]
            client.camera.fov = following_fov(frame, client.camera.aspect)
