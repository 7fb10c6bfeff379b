"""The scene in the browser: points or a surface, the camera's path, things, marks."""

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.formats.glb import glb_surface
from tisfm.results.frame import ViewFrame
from tisfm.results.fused_scene import Whole
from tisfm.results.result import Result
from tisfm.show import label_colors
from tisfm.view.frame_cloud import Cloud
from tisfm.view.picking import field_of_view, frustum_scale
from tisfm.view.surface import surface_file, triangles_between
from tisfm.view.viewpoint import FOV, USUAL_ASPECT, overview

if TYPE_CHECKING:
    from viser import ViserServer

PATH_COLOR, HERE, MARK = (0, 114, 178), (213, 94, 0), (230, 159, 0)
MOST_FRUSTA = 40
_THUMB, _PICTURE = 96, 480  # px, of pictures in frusta
_WIDE, _LONG = 0.13, 0.16  # diagonal and length of the frustum at most, over the median depth
_ALONG = 0.35  # size of frusta along the path, over that of the frame that is looked at
_APART = 0.6  # of their length, or they are left out


class SceneView:
    """What the browsers show, drawn node by node.

    Parameters
    ----------
    server : ViserServer
    result : Result

    Attributes
    ----------
    depth : float
        A usual depth in the scene, which sizes of frusta and marks follow.
    up : (3,) float64
        What points upwards in the world, as cameras are mostly held.
    """

    def __init__(self, server: "ViserServer", result: Result) -> None:
        self._server, self._result = server, result
        self._nodes: dict[str, Any] = {}
        self.frusta: dict[int, Any] = {}
        self.begin(1.0)
        # What is shown has its own light: these would cost, and show nothing.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)

    def begin(self, depth: float) -> None:
        """Take the direction up from the poses, and a usual depth; what is drawn next has them."""
        self.depth, self.up = depth, _usual_up(self._result.poses)
        self._server.scene.set_up_direction(tuple(self.up))

    def pose_of(self, number: int) -> NDArray[np.float64]:
        """Return the pose of a frame, that of the origin where it has none."""
        pose = self._result.poses[number]
        return pose if np.isfinite(pose).all() else np.eye(4)

    def place_browsers(self, frame: ViewFrame, points: Cloud) -> None:
        """Let browsers begin where a frame and its points are in sight."""
        pose, distance = self.overview(frame, points)
        start = self._server.initial_camera
        start.position = pose[:3, 3]
        start.look_at = pose[:3, 3] + distance * pose[:3, 2]
        start.up = self.up
        start.near, start.far = 1e-3 * self.depth, 1e3 * self.depth
        start.fov = FOV

    def overview(
        self, frame: ViewFrame, points: Cloud | None, aspect: float = USUAL_ASPECT
    ) -> tuple[NDArray[np.float64], float]:
        """Return the pose in the world that a frame is looked at from, and how far its points are.

        Parameters
        ----------
        frame : ViewFrame
        points : Cloud or None
        aspect : float
            Width over height of what the browser shows.
        """
        pose = self.pose_of(frame.number)
        height, width = frame.shape
        corners = frame.rays(np.array([0, 0, height, height]), np.array([0, width, 0, width]))
        frustum = np.concatenate([np.zeros((1, 3)), self.picture_distance(frame) * corners])
        positions = np.zeros((0, 3)) if points is None else points.positions
        seen, distance = overview(positions, frustum, up=pose[:3, :3].T @ self.up, aspect=aspect)
        return pose @ seen, distance

    def show_surface(self, points: Cloud, frame: ViewFrame, colors: NDArray[np.uint8]) -> None:
        """Show the surface between points in place of what was shown last.

        Parameters
        ----------
        points : Cloud
        frame : ViewFrame
            Theirs.
        colors : (H, W, 3) uint8
            Of all its pixels.
        """
        triangles = triangles_between(points, frame.shape)
        if not len(triangles):
            self.remove("points")
            return
        pose = self.pose_of(frame.number)
        self._nodes["points"] = self._server.scene.add_glb(
            "/points",
            surface_file(points, triangles, colors),
            wxyz=quaternion(pose),
            position=pose[:3, 3],
            cast_shadow=False,
            receive_shadow=False,
        )

    def show_points(self, points: Cloud, frame: ViewFrame, *, size: float) -> None:
        """Show the points of a frame in place of what was shown last."""
        pose = self.pose_of(frame.number)
        self._nodes["points"] = self._server.scene.add_point_cloud(
            "/points",
            points.positions,
            points.colors,
            point_size=size * points.size,
            point_shape="square",
            point_shading="flat",
            precision="float32",
            wxyz=quaternion(pose),
            position=pose[:3, 3],
        )

    def show_whole(self, whole: Whole | None, *, size: float) -> None:
        """Show points or the surface of several frames, None to remove them.

        Parameters
        ----------
        whole : Whole or None
        size : float
            Of points, in the unit of the scene.
        """
        if whole is None or not len(whole.positions):
            self.remove("whole")
        elif whole.faces is None:
            self._nodes["whole"] = self._server.scene.add_point_cloud(
                "/whole",
                whole.positions,
                whole.colors,
                point_size=size / whole.left**0.5,
                point_shape="square",
                point_shading="flat",
                precision="float32",
            )
        else:
            self._nodes["whole"] = self._server.scene.add_glb(
                "/whole",
                glb_surface(whole.positions, whole.faces, whole.colors),
                cast_shadow=False,
                receive_shadow=False,
            )

    def show_here(self, frame: ViewFrame, *, visible: bool) -> None:
        """Show the frustum of a frame, with its picture."""
        pose = self.pose_of(frame.number)
        fov, aspect = field_of_view(frame)
        self._nodes["here"] = self._server.scene.add_camera_frustum(
            "/here",
            fov,
            aspect,
            scale=frustum_scale(fov, aspect, self.picture_distance(frame)),
            color=HERE,
            thickness=2.0,
            thickness_units="screen",
            image=thumbnail(frame.picture, _PICTURE),
            wxyz=quaternion(pose),
            position=pose[:3, 3],
            visible=visible,
            cast_shadow=False,
            receive_shadow=False,
        )

    def picture_distance(self, frame: ViewFrame) -> float:
        """Return how far before the camera the picture in the frustum is."""
        diagonal = float(np.hypot(*frame.shape)) / frame.camera.focal
        return self.depth * min(_LONG, _WIDE / diagonal)

    def show_path(self, number: int, frame: ViewFrame, *, path: bool, frusta: bool) -> None:
        """Show the path of the piece that a frame belongs to, and frusta along it."""
        self.remove("path")
        for handle in self.frusta.values():
            handle.remove()
        self.frusta.clear()
        piece = self._result.piece
        if piece[number] < 0:
            return
        placed = np.flatnonzero(piece == piece[number])
        centers = self._result.poses[placed, :3, 3]
        if path and len(placed) > 1:
            self._nodes["path"] = self._server.scene.add_line_segments(
                "/path",
                np.stack([centers[:-1], centers[1:]], axis=1).astype(np.float32),
                PATH_COLOR,
                thickness=3.0,
                thickness_units="screen",
            )
        if frusta and len(placed) > 1:
            fov, aspect = field_of_view(frame)
            length = _ALONG * self.picture_distance(frame)
            for k in placed[_spread(centers, _APART * length)]:
                pose = self._result.poses[k]
                self.frusta[int(k)] = self._server.scene.add_camera_frustum(
                    f"/frusta/{k}",
                    fov,
                    aspect,
                    scale=frustum_scale(fov, aspect, length),
                    color=PATH_COLOR,
                    thickness=1.0,
                    thickness_units="screen",
                    wxyz=quaternion(pose),
                    position=pose[:3, 3],
                    cast_shadow=False,
                    receive_shadow=False,
                )

    def show_things(self, number: int, *, visible: bool) -> None:
        """Show the paths of things that move on their own, and where they are in a frame."""
        for name in [name for name in self._nodes if name.startswith("thing")]:
            self.remove(name)
        things = self._result.objects if visible else ()
        colors = label_colors(max((thing.id for thing in things), default=0) + 1)
        for thing in things:
            known = np.isfinite(thing.poses).all(axis=(1, 2))
            known &= self._result.piece[list(thing.frames)] == self._result.piece[number]
            centers = thing.poses[known, :3, 3].astype(np.float32)
            if len(centers) > 1:
                self._nodes[f"thing{thing.id}"] = self._server.scene.add_line_segments(
                    f"/things/{thing.id}",
                    np.stack([centers[:-1], centers[1:]], axis=1),
                    colors[thing.id],
                    thickness=4.0,
                    thickness_units="screen",
                )
            if number in thing.frames and known[thing.frames.index(number)]:
                self._nodes[f"thing{thing.id}here"] = self._server.scene.add_label(
                    f"/names/{thing.id}",
                    f"thing {thing.id}",
                    position=thing.poses[thing.frames.index(number), :3, 3],
                )

    def show_marks(self, points: list[NDArray[np.float64]], name: str) -> None:
        """Show marked points of the world, with a line between two; none to remove them."""
        for k in range(2):
            self.remove(f"{name}{k}")
        self.remove(f"{name}line")
        for k, point in enumerate(points):
            self._nodes[f"{name}{k}"] = self._server.scene.add_icosphere(
                f"/marks/{name}{k}",
                radius=0.008 * self.depth,
                color=MARK,
                position=point,
                cast_shadow=False,
                receive_shadow=False,
            )
        if len(points) == 2:
            self._nodes[f"{name}line"] = self._server.scene.add_line_segments(
                f"/marks/{name}line",
                np.stack(points)[None].astype(np.float32),
                MARK,
                thickness=3.0,
                thickness_units="screen",
            )

    def show_box(self, box: tuple[NDArray[np.float64], NDArray[np.float64]] | None) -> None:
        """Show the edges of the clipping box, None to remove it."""
        self.remove("box")
        if box is not None:
            self._nodes["box"] = self._server.scene.add_line_segments(
                "/box", box_edges(*box), (120, 120, 120), thickness=1.0, thickness_units="screen"
            )

    def set_visible(self, name: str, visible: bool) -> None:
        """Let a node be seen or not, if it is there."""
        node = self._nodes.get(name)
        if node is not None and node.visible != visible:
            node.visible = visible

    def remove(self, name: str) -> None:
        """Remove a node if it is there."""
        node = self._nodes.pop(name, None)
        if node is not None:
            node.remove()


def _spread(centers: NDArray[np.float64], apart: float) -> NDArray[np.int_]:
    """Return which of the places of a path get a frustum: not too many, and none too near.

    The first one does.
    """
    every = np.unique(np.linspace(0, len(centers) - 1, MOST_FRUSTA).astype(int))
    taken = [int(every[0])]
    for k in every[1:]:
        if np.linalg.norm(centers[k] - centers[taken[-1]]) >= apart:
            taken.append(int(k))
    return np.array(taken)


def _usual_up(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean direction that points upwards in frames, (3,); −Y if there is none."""
    placed = poses[np.isfinite(poses).all(axis=(1, 2))]
    mean = -placed[:, :3, 1].mean(axis=0) if len(placed) else np.zeros(3)
    length = float(np.linalg.norm(mean))
    return mean / length if length > 1e-3 else np.array((0.0, -1.0, 0.0))


def quaternion(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a pose, (4, 4), as w, x, y, z."""
    from viser.transforms import SO3

    return np.asarray(SO3.from_matrix(pose[:3, :3]).wxyz)


def thumbnail(picture: NDArray[np.uint8], width: int = _THUMB) -> NDArray[np.uint8]:
    """Return a picture that is at most so wide."""
    height, full = picture.shape[:2]
    if full <= width:
        return picture
    size = (width, max(1, round(height * width / full)))
    shrunk: NDArray[np.uint8] = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    return shrunk


def box_edges(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the twelve edges of a box, (12, 2, 3)."""
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    pairs = [(k, k | 1 << axis) for axis in range(3) for k in range(8) if not k >> axis & 1]
    return corners[np.array(pairs)].astype(np.float32)


def behind(pose: NDArray[np.float64], depth: float) -> NDArray[np.float64]:
    """Return a pose a little behind, above and beside another that looks the same way."""
    moved = pose.copy()
    moved[:3, 3] += pose[:3, :3] @ np.array((0.12, -0.22, -0.5)) * depth
    return moved
