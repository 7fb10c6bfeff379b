"""The controls of the page: sliders, check boxes, buttons and pictures beside the scene."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tisfm.results.fused_scene import KINDS as FUSED_KINDS
from tisfm.results.result_frames import ResultFrames
from tisfm.view.colors import KINDS, QUANTITIES

if TYPE_CHECKING:
    from viser import ViserServer

NOT_FUSED = "nothing"  # choice of the control `fused`: no fused scene
ANY_DEVIATION = 100.0  # percent: end of the slider, where every point is shown
_SETTINGS = (
    "speed", "follow", "shape", "size", "max_thousands", "min_confidence", "max_deviation",
    "with_hidden_points", "path", "frusta", "pictures", "objects", "measure",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Controls:
    """Handles of viser for the controls."""

    frame: Any
    play: Any
    speed: Any
    follow: Any
    go: Any
    status: Any
    color: Any
    legend: Any
    shape: Any
    size: Any
    max_thousands: Any
    min_confidence: Any
    max_deviation: Any
    with_hidden_points: Any
    fused: Any
    fused_note: Any
    with_frame: Any
    path: Any
    frusta: Any
    pictures: Any
    objects: Any
    box: Any
    box_low: Any
    box_high: Any
    measure: Any
    distance: Any
    clear: Any
    screenshot: Any
    film: Any
    static: Any
    progress: Any
    kinds: tuple[Any, Any]
    images: tuple[Any, Any]
    pixel: Any
    reading: Any

    @property
    def redraw_controls(self) -> tuple[Any, ...]:
        """Controls, besides the slider, that redraw the frame when they change."""
        return (
            self.color, self.shape, self.size, self.max_thousands, self.min_confidence,
            self.max_deviation, self.with_hidden_points, self.follow, self.box, self.box_low,
            self.box_high, self.fused, self.with_frame,
            *self.kinds,
        )  # fmt: skip


def control_features(result: ResultFrames) -> tuple[object, ...]:
    """Return the features of a result that determine the controls of the page."""
    return result.quantities, result.has_one_scale, result.can_fuse, bool(result.objects)


def copy_settings(source: Controls, target: Controls) -> None:
    """Copy the values of earlier controls to new controls that have the same choices."""
    for name in _SETTINGS:
        getattr(target, name).value = getattr(source, name).value
    pairs = zip((source.color, *source.kinds), (target.color, *target.kinds), strict=True)
    for earlier, control in pairs:
        if earlier.value in control.options:
            control.value = earlier.value


def build_controls(server: "ViserServer", result: ResultFrames, *, max_points: int) -> Controls:
    """Build the controls: a panel for the scene at the right, and pictures at the left."""
    gui = server.gui
    gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    gui.main_panel.dock_right()  # beside the scene, not over it
    handles: dict[str, Any] = {}
    colors = [q for q in QUANTITIES if q in ("image", "depth", *result.quantities)]
    pictures = [k for k in KINDS if k in ("frame", "depth", "flow", "anaglyph", *result.quantities)]
    with gui.add_folder("Time"):
        last, is_alone = max(1, len(result.names) - 1), len(result.names) < 2
        handles["frame"] = gui.add_slider(
            "Frame", min=0, max=last, step=1, initial_value=0, disabled=is_alone
        )
        handles["play"] = gui.add_button("Play", disabled=is_alone)
        handles["speed"] = gui.add_slider(
            "Frames per second", min=1, max=30, step=1, initial_value=8
        )
        handles["follow"] = gui.add_checkbox("Follow the camera", initial_value=False)
        handles["go"] = gui.add_button("Go to the camera")
        handles["status"] = gui.add_html("")
    with gui.add_folder("Points"):
        handles["color"] = gui.add_dropdown("Colour", colors, initial_value="image")
        handles["legend"] = gui.add_html("")
        handles["shape"] = gui.add_dropdown("Shape", ("points", "surface"), initial_value="points")
        handles["size"] = gui.add_slider("Size", min=0.5, max=4, step=0.1, initial_value=1.2)
        thousands = max(1, round(max_points / 1000))
        handles["max_thousands"] = gui.add_slider(
            "Thousands, at most", min=1, max=max(500, thousands), step=1, initial_value=thousands
        )
        handles["min_confidence"] = gui.add_slider(
            "Least confidence",
            min=0,
            max=1,
            step=0.01,
            initial_value=0,
            visible="confidence" in result.quantities,
        )
        handles["max_deviation"] = gui.add_slider(
            "Largest deviation, %",
            min=0.5,
            max=ANY_DEVIATION,
            step=0.5,
            initial_value=ANY_DEVIATION,
            visible="deviation" in result.quantities,
        )
        handles["with_hidden_points"] = gui.add_checkbox(
            "Hidden in the next frame", True, visible="confidence" in result.quantities
        )
    with gui.add_folder("Whole scene", expand_by_default=False, visible=result.can_fuse):
        handles["fused"] = gui.add_dropdown(
            "All frames", (NOT_FUSED, *FUSED_KINDS), initial_value=NOT_FUSED
        )
        handles["fused_note"] = gui.add_html("")
        handles["with_frame"] = gui.add_checkbox("Points of the frame", initial_value=True)
    with gui.add_folder("Path", expand_by_default=False, visible=result.has_one_scale):
        handles["path"] = gui.add_checkbox("Path of the camera", initial_value=True)
        handles["frusta"] = gui.add_checkbox("Frusta along it", initial_value=True)
        handles["pictures"] = gui.add_checkbox("Pictures in them", initial_value=True)
        handles["objects"] = gui.add_checkbox(
            "Paths of moving objects", initial_value=True, visible=bool(result.objects)
        )
    with gui.add_folder("Clipping box", expand_by_default=False):
        handles["box"] = gui.add_checkbox("Clip", initial_value=False)
        handles["box_low"] = gui.add_vector3("From X, Y, Z", initial_value=(-1, -1, 0), step=0.05)
        handles["box_high"] = gui.add_vector3("To X, Y, Z", initial_value=(1, 1, 2), step=0.05)
    with gui.add_folder("Measure", expand_by_default=False):
        handles["measure"] = gui.add_checkbox("Clicks measure", initial_value=False)
        handles["distance"] = gui.add_html("")
        handles["clear"] = gui.add_button("Clear")
    with gui.add_folder("Save", expand_by_default=False):
        handles["screenshot"] = gui.add_button("Screenshot (PNG)")
        handles["film"] = gui.add_button("Fly-through (MP4)")
        handles["static"] = gui.add_button("Page that plays by itself (HTML)")
        handles["progress"] = gui.add_html("")
    panel = gui.add_panel()
    blank = np.full((30, 40, 3), 200, np.uint8)
    with panel.add_tab("Pictures"):
        kinds, images = [], []
        for label, kind in (("Above", "frame"), ("Below", "depth")):
            kinds.append(gui.add_dropdown(label, pictures, initial_value=kind))
            images.append(gui.add_image(blank, jpeg_quality=85))
        handles["pixel"] = gui.add_vector2("Column, row", initial_value=(0, 0), min=(0, 0), step=1)
        handles["reading"] = gui.add_html("")
    panel.dock_left()
    return Controls(**handles, kinds=(kinds[0], kinds[1]), images=(images[0], images[1]))
