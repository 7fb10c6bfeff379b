"""Where the browsers that show a page look from."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from tisfm.results.frame import ViewFrame
from tisfm.view.frame_cloud import Cloud
from tisfm.view.picking import following_fov
from tisfm.view.scene import SceneView, quaternion
from tisfm.view.viewpoint import FOV, USUAL_ASPECT

if TYPE_CHECKING:
    from viser import CameraHandle, ClientHandle, ViserServer

_OTHER_SHAPE = 0.1  # of the logarithm of width over height: a window that shows other parts
_TOUCHED = 1e-3  # of the depth: a view that was moved since


class Browsers:
    """Brings browsers to where the frame that is shown is in sight.

    Parameters
    ----------
    server : ViserServer
    scene : SceneView
    is_followed : callable
        Whether they are to look from where the camera was.

    Attributes
    ----------
    frame, points : ViewFrame, Cloud or None
        What is shown.
    """

    def __init__(
        self, server: "ViserServer", scene: SceneView, is_followed: Callable[[], bool]
    ) -> None:
        self.frame: ViewFrame | None = None
        self.points: Cloud | None = None
        self._server, self._scene, self._is_followed = server, scene, is_followed

    def go_all(self) -> None:
        """Bring all to where the frame and its points are in sight."""
        for client in self._server.get_clients().values():
            self.go(client)

    def follow_all(self) -> None:
        """Let all look from where the camera was."""
        for client in self._server.get_clients().values():
            self._follow(client)

    def go(self, client: "ClientHandle") -> None:
        """Bring one to where the frame and its points are in sight."""
        if self.frame is None:
            return
        pose, distance = self._scene.overview(self.frame, self.points, client.camera.aspect)
        with client.atomic():
            client.camera.up_direction = self._scene.up
            client.camera.wxyz = quaternion(pose)
            client.camera.position = pose[:3, 3]
            client.camera.look_at = pose[:3, 3] + distance * pose[:3, 2]
            client.camera.fov = FOV

    def welcome(self, client: "ClientHandle") -> None:
        """Let all be in sight in the window of a browser, until somebody moves the view.

        Where the camera is followed, that is all of the frame, whatever happens to the window.
        """
        fitted, has_come, is_touched = USUAL_ASPECT, False, False
        followed = 0.0  # the shape of the window that the field of view was fitted to
        home = np.asarray(self._server.initial_camera.position)

        def fit(camera: "CameraHandle") -> None:
            nonlocal fitted, home, has_come, is_touched, followed
            is_home = bool(np.linalg.norm(camera.position - home) <= _TOUCHED * self._scene.depth)
            is_due = camera.aspect != followed or (is_home and not has_come)
            if self._is_followed() and is_due:
                followed = camera.aspect
                self._follow(client)
            has_come |= is_home  # before that, it has not been told yet where to begin
            is_touched |= has_come and not is_home
            if self._is_followed():
                return
            if is_home and not is_touched and abs(np.log(camera.aspect / fitted)) > _OTHER_SHAPE:
                fitted = camera.aspect
                self.go(client)
                home = np.array(camera.position)

        client.camera.on_update(fit)
        fit(client.camera)

    def _follow(self, client: "ClientHandle") -> None:
        """Let one look from where the camera was, all of the frame in sight."""
        frame = self.frame
        if frame is None:
            return
        pose = self._scene.pose_of(frame.number)
        with client.atomic():
            client.camera.wxyz = quaternion(pose)
            client.camera.position = pose[:3, 3]
            client.camera.fov = following_fov(frame, client.camera.aspect)
