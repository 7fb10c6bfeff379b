"""The scene in the browser: points or a surface, the path of the camera, objects, marks."""

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.formats.glb import glb_surface
from tisfm.results.frame import ResultFrame
from tisfm.results.fused_scene import FusedScene
from tisfm.results.result_frames import ResultFrames
from tisfm.show import label_colors
from tisfm.view.frame_cloud import FrameCloud, surface_file, triangles_between
from tisfm.view.viewpoint import FOV, USUAL_ASPECT, field_of_view, frustum_scale, overview

if TYPE_CHECKING:
    from viser import ViserServer

PATH_COLOR = (0, 114, 178)
FRAME_COLOR = (213, 94, 0)  # frustum of the frame that is shown
MARK_COLOR = (230, 159, 0)
BOX_COLOR = (120, 120, 120)
# Set by hand.
MAX_FRUSTA = 40  # along a path
_THUMBNAIL_WIDTH = 96  # px, of pictures in frusta along the path
_PICTURE_WIDTH = 480  # px, of the picture in the frustum of the frame
_MAX_FRUSTUM_DIAGONAL = 0.13  # in median depths
_MAX_FRUSTUM_LENGTH = 0.16  # in median depths
_PATH_FRUSTUM_RATIO = 0.35  # size of frusta along the path over the size of the frame's frustum
_MIN_FRUSTUM_DISTANCE = 0.6  # between frusta along the path, over their length
_MARK_RADIUS = 0.008  # in median depths
_BEHIND_OFFSET = (0.12, -0.22, -0.5)  # viewpoint of a film from the camera, in median depths


class ViewerScene:
    """The nodes of viser that the browsers show.

    Parameters
    ----------
    server : ViserServer
    result : ResultFrames

    Attributes
    ----------
    depth : float
        Median depth of the scene: sizes of frusta and marks are in proportion to it.
    up : (3,) float64
        Upward direction of the world: cameras are usually held upright.
    """

    def __init__(self, server: "ViserServer", result: ResultFrames) -> None:
        self._server, self._result = server, result
        self._nodes: dict[str, Any] = {}
        self.frusta: dict[int, Any] = {}
        self.set_depth(1.0)
        # All nodes have colours of their own: lights would cost time and change nothing.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)

    def set_depth(self, depth: float) -> None:
        """Set the median depth, and the upward direction from the poses."""
        self.depth, self.up = depth, _mean_up(self._result.poses)
        self._server.scene.set_up_direction(tuple(self.up))

    def pose_of(self, number: int) -> NDArray[np.float64]:
        """Return the pose of a frame; the origin for a frame without a pose."""
        pose = self._result.poses[number]
        return pose if np.isfinite(pose).all() else np.eye(4)

    def set_first_viewpoint(self, frame: ResultFrame, points: FrameCloud) -> None:
        """Let new browsers begin at a viewpoint that shows a frame and its points."""
        pose, distance = self.overview(frame, points)
        start = self._server.initial_camera
        start.position = pose[:3, 3]
        start.look_at = pose[:3, 3] + distance * pose[:3, 2]
        start.up = self.up
        start.near, start.far = 1e-3 * self.depth, 1e3 * self.depth
        start.fov = FOV

    def overview(
        self,
        frame: ResultFrame,
        points: FrameCloud | None,
        aspect: float = USUAL_ASPECT,  # width over height of the view
    ) -> tuple[NDArray[np.float64], float]:
        """Return a viewpoint in the world that shows a frame, and the distance of its points."""
        pose = self.pose_of(frame.number)
        height, width = frame.shape
        corners = frame.rays(np.array([0, 0, height, height]), np.array([0, width, 0, width]))
        frustum = np.concatenate([np.zeros((1, 3)), self.picture_distance(frame) * corners])
        positions = np.zeros((0, 3)) if points is None else points.positions
        viewpoint, distance = overview(
            positions, frustum, up=pose[:3, :3].T @ self.up, aspect=aspect
        )
        return pose @ viewpoint, distance

    def show_surface(
        self,
        points: FrameCloud,
        frame: ResultFrame,
        colors: NDArray[np.uint8],  # (H, W, 3) uint8: of all pixels of the frame
    ) -> None:
        """Show the surface between the points of a frame."""
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

    def show_points(self, points: FrameCloud, frame: ResultFrame, *, size: float) -> None:
        """Show the points of a frame."""
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

    def show_fused(
        self,
        fused: FusedScene | None,
        *,
        size: float,  # of points, in the unit of the scene
    ) -> None:
        """Show the points or the surface of several frames; None removes them."""
        if fused is None or not len(fused.positions):
            self.remove("fused")
        elif fused.faces is None:
            self._nodes["fused"] = self._server.scene.add_point_cloud(
                "/fused",
                fused.positions,
                fused.colors,
                point_size=size / fused.point_share**0.5,
                point_shape="square",
                point_shading="flat",
                precision="float32",
            )
        else:
            self._nodes["fused"] = self._server.scene.add_glb(
                "/fused",
                glb_surface(fused.positions, fused.faces, fused.colors),
                cast_shadow=False,
                receive_shadow=False,
            )

    def show_frustum(self, frame: ResultFrame, *, visible: bool) -> None:
        """Show the frustum of a frame, with its picture."""
        pose = self.pose_of(frame.number)
        fov, aspect = field_of_view(frame)
        self._nodes["here"] = self._server.scene.add_camera_frustum(
            "/here",
            fov,
            aspect,
            scale=frustum_scale(fov, aspect, self.picture_distance(frame)),
            color=FRAME_COLOR,
            thickness=2.0,
            thickness_units="screen",
            image=thumbnail(frame.picture, _PICTURE_WIDTH),
            wxyz=quaternion(pose),
            position=pose[:3, 3],
            visible=visible,
            cast_shadow=False,
            receive_shadow=False,
        )

    def picture_distance(self, frame: ResultFrame) -> float:
        """Return the distance from the camera to the picture in its frustum."""
        diagonal = float(np.hypot(*frame.shape)) / frame.camera.focal
        return self.depth * min(_MAX_FRUSTUM_LENGTH, _MAX_FRUSTUM_DIAGONAL / diagonal)

    def show_path(self, number: int, frame: ResultFrame, *, path: bool, frusta: bool) -> None:
        """Show the path of the piece that a frame belongs to, and frusta along it."""
        self.remove("path")
        for handle in self.frusta.values():
            handle.remove()
        self.frusta.clear()
        piece = self._result.piece
        if piece[number] < 0:
            return
        posed_frames = np.flatnonzero(piece == piece[number])
        centers = self._result.poses[posed_frames, :3, 3]
        if path and len(posed_frames) > 1:
            self._nodes["path"] = self._server.scene.add_line_segments(
                "/path",
                np.stack([centers[:-1], centers[1:]], axis=1).astype(np.float32),
                PATH_COLOR,
                thickness=3.0,
                thickness_units="screen",
            )
        if frusta and len(posed_frames) > 1:
            fov, aspect = field_of_view(frame)
            length = _PATH_FRUSTUM_RATIO * self.picture_distance(frame)
            for k in posed_frames[_spaced_indices(centers, _MIN_FRUSTUM_DISTANCE * length)]:
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

    def show_objects(self, number: int, *, visible: bool) -> None:
        """Show the paths of moving objects, and a name at each position in a frame."""
        for name in [name for name in self._nodes if name.startswith("object")]:
            self.remove(name)
        objects = self._result.objects if visible else ()
        colors = label_colors(max((moving_object.id for moving_object in objects), default=0) + 1)
        for moving_object in objects:
            is_known = np.isfinite(moving_object.poses).all(axis=(1, 2))
            is_known &= self._result.piece[list(moving_object.frames)] == self._result.piece[number]
            centers = moving_object.poses[is_known, :3, 3].astype(np.float32)
            if len(centers) > 1:
                self._nodes[f"object{moving_object.id}"] = self._server.scene.add_line_segments(
                    f"/objects/{moving_object.id}",
                    np.stack([centers[:-1], centers[1:]], axis=1),
                    colors[moving_object.id],
                    thickness=4.0,
                    thickness_units="screen",
                )
            if number in moving_object.frames and is_known[moving_object.frames.index(number)]:
                self._nodes[f"object{moving_object.id}here"] = self._server.scene.add_label(
                    f"/names/{moving_object.id}",
                    f"object {moving_object.id}",
                    position=moving_object.poses[moving_object.frames.index(number), :3, 3],
                )

    def show_marks(self, points: list[NDArray[np.float64]], name: str) -> None:
        """Show marked points of the world, with a line between two; an empty list removes them."""
        for k in range(2):
            self.remove(f"{name}{k}")
        self.remove(f"{name}line")
        for k, point in enumerate(points):
            self._nodes[f"{name}{k}"] = self._server.scene.add_icosphere(
                f"/marks/{name}{k}",
                radius=_MARK_RADIUS * self.depth,
                color=MARK_COLOR,
                position=point,
                cast_shadow=False,
                receive_shadow=False,
            )
        if len(points) == 2:
            self._nodes[f"{name}line"] = self._server.scene.add_line_segments(
                f"/marks/{name}line",
                np.stack(points)[None].astype(np.float32),
                MARK_COLOR,
                thickness=3.0,
                thickness_units="screen",
            )

    def show_box(self, box: tuple[NDArray[np.float64], NDArray[np.float64]] | None) -> None:
        """Show the edges of the clipping box; None removes them."""
        self.remove("box")
        if box is not None:
            self._nodes["box"] = self._server.scene.add_line_segments(
                "/box", box_edges(*box), BOX_COLOR, thickness=1.0, thickness_units="screen"
            )

    def set_visible(self, name: str, visible: bool) -> None:
        """Make a node visible or not, if it exists."""
        node = self._nodes.get(name)
        if node is not None and node.visible != visible:
            node.visible = visible

    def remove(self, name: str) -> None:
        """Remove a node, if it exists."""
        node = self._nodes.pop(name, None)
        if node is not None:
            node.remove()


def _spaced_indices(centers: NDArray[np.float64], min_distance: float) -> NDArray[np.int_]:
    """Return indices of positions that get a frustum, with at least `min_distance` between them."""
    candidates = np.unique(np.linspace(0, len(centers) - 1, MAX_FRUSTA).astype(int))
    indices = [int(candidates[0])]
    for k in candidates[1:]:
        if np.linalg.norm(centers[k] - centers[indices[-1]]) >= min_distance:
            indices.append(int(k))
    return np.array(indices)


def _mean_up(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean upward direction of the frames, (3,); −Y without poses."""
    finite_poses = poses[np.isfinite(poses).all(axis=(1, 2))]
    mean = -finite_poses[:, :3, 1].mean(axis=0) if len(finite_poses) else np.zeros(3)
    length = float(np.linalg.norm(mean))
    return mean / length if length > 1e-3 else np.array((0.0, -1.0, 0.0))


def quaternion(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a pose, (4, 4), as w, x, y, z."""
    from viser.transforms import SO3

    return np.asarray(SO3.from_matrix(pose[:3, :3]).wxyz)


def thumbnail(picture: NDArray[np.uint8], width: int = _THUMBNAIL_WIDTH) -> NDArray[np.uint8]:
    """Return a picture of at most a width, px."""
    height, original_width = picture.shape[:2]
    if original_width <= width:
        return picture
    size = (width, max(1, round(height * width / original_width)))
    resized: NDArray[np.uint8] = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    return resized


def box_edges(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the twelve edges of a box, (12, 2, 3)."""
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    pairs = [(k, k | 1 << axis) for axis in range(3) for k in range(8) if not k >> axis & 1]
    return corners[np.array(pairs)].astype(np.float32)


def pose_behind(pose: NDArray[np.float64], depth: float) -> NDArray[np.float64]:
    """Return a pose behind, above and beside another, with the same direction."""
    shifted_pose = pose.copy()
    shifted_pose[:3, 3] += pose[:3, :3] @ np.array(_BEHIND_OFFSET) * depth
    return shifted_pose
