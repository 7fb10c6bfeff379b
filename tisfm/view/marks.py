"""Pixels that are read, and points that are measured between."""

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from tisfm.results.frame import ViewFrame
from tisfm.results.result import Result
from tisfm.view.controls import Controls
from tisfm.view.frame_cloud import Cloud
from tisfm.view.html_texts import distance_html, outside_html, reading_html, set_html
from tisfm.view.picking import WIDE, picked_pixel, picked_point
from tisfm.view.scene import SceneView


class Marks:
    """What is marked in the frame that is shown; it stays marked in others.

    Parameters
    ----------
    controls : Controls
    scene : SceneView
    result : Result

    Attributes
    ----------
    frame : ViewFrame or None
        The one that is shown.
    pixel : (int, int) or None
        Row and column of what is read.
    measured : list of (3,) float64
        Up to two points of the world.
    """

    def __init__(self, controls: Controls, scene: SceneView, result: Result) -> None:
        self._controls, self._scene, self._result = controls, scene, result
        self.frame: ViewFrame | None = None
        self.pixel: tuple[int, int] | None = None
        self.measured: list[NDArray[np.float64]] = []

    def show_reading(self) -> None:
        """Say what is known of the marked pixel in the frame that is shown, and mark it."""
        frame, reading, outside = self.frame, None, Markup()
        if frame is not None and self.pixel is not None:
            try:
                reading = frame.reading(*self.pixel)
            except IndexError:
                row, column = self.pixel
                outside = outside_html(row, column, frame.shape)
        place = None if reading is None else self._place_of(reading.row, reading.column)
        self._scene.show_marks([] if place is None else [place], "pixel")
        set_html(self._controls.reading, outside or reading_html(reading, self._result.unit))

    def pick(
        self, origin: NDArray[np.float64], direction: NDArray[np.float64], points: Cloud | None
    ) -> None:
        """Mark, or measure from, what a ray in the world hits: a point, or the picture."""
        frame = self.frame
        if frame is None or points is None:
            return
        pose = self._scene.pose_of(frame.number)
        start = pose[:3, :3].T @ (origin - pose[:3, 3])
        along = pose[:3, :3].T @ direction
        between = (
            0.75 * points.step / frame.camera.focal
        )  # what is between two points belongs to one
        hit = None
        if self._controls.with_frame.value:  # what is not seen is not hit
            hit = picked_point(start, along, points.positions, wide=max(WIDE, between))
        pixel = None if hit is None else tuple(map(int, points.pixels[hit]))
        if not self._controls.follow.value:
            distance = self._scene.picture_distance(frame)
            in_picture = picked_pixel(start, along, frame, distance)
            length = np.inf if hit is None else np.linalg.norm(points.positions[hit] - start)
            if in_picture is not None and in_picture[2] < length:
                pixel = in_picture[:2]
        if pixel is None:
            return
        if self._controls.measure.value:
            self._measure(self._place_of(*pixel))
        else:
            self.mark(*pixel)

    def mark(self, row: int, column: int) -> None:
        """Read a pixel."""
        self.pixel = row, column
        self._controls.pixel.value = (column, row)
        self.show_reading()

    def _place_of(self, row: int, column: int) -> NDArray[np.float64] | None:
        """Return where a pixel of the frame is in the world, None if it has no depth."""
        frame = self.frame
        if frame is None or not frame.has_depth[row, column]:
            return None
        ray = frame.rays(np.array([row]), np.array([column]))[0].astype(np.float64)
        pose = self._scene.pose_of(frame.number)
        place: NDArray[np.float64] = (
            pose[:3, :3] @ ray * (frame.scale / frame.inverse_depth[row, column]) + pose[:3, 3]
        )
        return place

    def _measure(self, point: NDArray[np.float64] | None) -> None:
        """Add a point to measure from or to, if there is one."""
        if point is not None:
            self.measured = [*self.measured[: len(self.measured) % 2], point]
        self._show_distance()

    def clear_measured(self) -> None:
        """Begin to measure anew."""
        self.measured = []
        self._show_distance()

    def _show_distance(self) -> None:
        """Show what is measured between, and the distance."""
        self._scene.show_marks(self.measured, "measured")
        scale = 1.0 if self.frame is None else self.frame.scale
        is_shown = bool(self.measured) or self._controls.measure.value
        set_html(
            self._controls.distance,
            distance_html(self.measured, scale, self._result.unit) if is_shown else Markup(),
        )
