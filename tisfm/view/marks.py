"""The pixel whose values are shown, and the points of a measured distance."""

import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ResultFrame
from tisfm.results.result_frames import ResultFrames
from tisfm.view.controls import Controls
from tisfm.view.frame_cloud import FrameCloud
from tisfm.view.html_texts import NOTHING, distance_html, outside_html, reading_html, set_html
from tisfm.view.scene import ViewerScene
from tisfm.view.viewpoint import CLICK_ANGLE, find_clicked_pixel, find_clicked_point

_CLICK_STEPS = 0.75  # distance of a click to a point, in steps of the points; set by hand


class Marks:
    """Marks in the current frame, which stay in other frames."""

    def __init__(self, controls: Controls, scene: ViewerScene, result: ResultFrames) -> None:
        self._controls, self._scene, self._result = controls, scene, result
        self.frame: ResultFrame | None = None  # the current frame
        # row and column of the marked pixel
        self.pixel: tuple[int, int] | None = None
        # list of (3,) float64: up to two points of the world
        self.measured_points: list[NDArray[np.float64]] = []

    def show_reading(self) -> None:
        """Show the values of the marked pixel in the current frame, and its mark."""
        frame, reading, outside_note = self.frame, None, NOTHING
        if frame is not None and self.pixel is not None:
            try:
                reading = frame.reading(*self.pixel)
            except IndexError:
                row, column = self.pixel
                outside_note = outside_html(row, column, frame.shape)
        point = None if reading is None else self._point_of(reading.row, reading.column)
        self._scene.show_marks([] if point is None else [point], "pixel")
        set_html(self._controls.reading, outside_note or reading_html(reading, self._result.unit))

    def pick(
        self, origin: NDArray[np.float64], direction: NDArray[np.float64], points: FrameCloud | None
    ) -> None:
        """Mark or measure the point, or the pixel of the picture, that a ray in the world hits."""
        frame = self.frame
        if frame is None or points is None:
            return
        pose = self._scene.pose_of(frame.number)
        ray_start = pose[:3, :3].T @ (origin - pose[:3, 3])
        ray_direction = pose[:3, :3].T @ direction
        click_angle = _CLICK_STEPS * points.step / frame.camera.focal
        point_index = None
        if self._controls.with_frame.value:  # invisible points cannot be hit
            point_index = find_clicked_point(
                ray_start, ray_direction, points.positions, max_angle=max(CLICK_ANGLE, click_angle)
            )
        pixel = None if point_index is None else tuple(map(int, points.pixels[point_index]))
        if not self._controls.follow.value:
            distance = self._scene.picture_distance(frame)
            picture_hit = find_clicked_pixel(ray_start, ray_direction, frame, distance)
            length = (
                np.inf
                if point_index is None
                else np.linalg.norm(points.positions[point_index] - ray_start)
            )
            if picture_hit is not None and picture_hit[2] < length:
                pixel = picture_hit[:2]
        if pixel is None:
            return
        if self._controls.measure.value:
            self._measure(self._point_of(*pixel))
        else:
            self.mark(*pixel)

    def mark(self, row: int, column: int) -> None:
        """Mark a pixel, and show its values."""
        self.pixel = row, column
        self._controls.pixel.value = (column, row)
        self.show_reading()

    def _point_of(self, row: int, column: int) -> NDArray[np.float64] | None:
        """Return the point of the world at a pixel of the frame; None without depth."""
        frame = self.frame
        if frame is None or not frame.has_depth[row, column]:
            return None
        ray = frame.rays(np.array([row]), np.array([column]))[0].astype(np.float64)
        pose = self._scene.pose_of(frame.number)
        point: NDArray[np.float64] = (
            pose[:3, :3] @ ray * (frame.scale / frame.inverse_depth[row, column]) + pose[:3, 3]
        )
        return point

    def _measure(self, point: NDArray[np.float64] | None) -> None:
        """Add an end of the measured distance, if there is a point."""
        if point is not None:
            self.measured_points = [*self.measured_points[: len(self.measured_points) % 2], point]
        self._show_distance()

    def clear_measured_points(self) -> None:
        """Remove both ends of the measured distance."""
        self.measured_points = []
        self._show_distance()

    def _show_distance(self) -> None:
        """Show the ends of the measured distance, and the distance."""
        self._scene.show_marks(self.measured_points, "measured")
        scale = 1.0 if self.frame is None else self.frame.scale
        is_shown = bool(self.measured_points) or self._controls.measure.value
        set_html(
            self._controls.distance,
            distance_html(self.measured_points, scale, self._result.unit) if is_shown else NOTHING,
        )
