"""The controls of the page."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tisfm.results.fused_scene import KINDS as WHOLES
from tisfm.results.result import Result
from tisfm.view.colors import QUANTITIES
from tisfm.view.pictures import KINDS

if TYPE_CHECKING:
    from viser import ViserServer

NO_WHOLE = "nothing"
ANY_DEVIATION = 100.0  # percent, from which on every deviation passes
_SETTINGS = (
    "speed", "follow", "shape", "size", "most", "min_confidence", "max_deviation", "hidden",
    "path", "frusta", "pictures", "things", "measure",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Controls:
    """Handles of the controls, named after what they are for."""

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
    most: Any
    min_confidence: Any
    max_deviation: Any
    hidden: Any
    whole: Any
    whole_note: Any
    with_frame: Any
    path: Any
    frusta: Any
    pictures: Any
    things: Any
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
    def redrawing(self) -> tuple[Any, ...]:
        """Those whose change draws the frame anew, besides the slider."""
        return (
            self.color, self.shape, self.size, self.most, self.min_confidence,
            self.max_deviation, self.hidden, self.follow, self.box, self.box_low, self.box_high,
            self.whole, self.with_frame,
            *self.kinds,
        )  # fmt: skip


def kind_of(result: Result) -> tuple[object, ...]:
    """Return what decides which controls a result has."""
    return result.quantities, result.has_one_scale, result.has_whole, bool(result.objects)


def take_settings(controls: Controls, before: Controls) -> None:
    """Set controls to what others were set to, where there is such a choice."""
    for name in _SETTINGS:
        getattr(controls, name).value = getattr(before, name).value
    pairs = zip((controls.color, *controls.kinds), (before.color, *before.kinds), strict=True)
    for control, former in pairs:
        if former.value in control.options:
            control.value = former.value


def build_controls(server: "ViserServer", result: Result, *, most_points: int) -> Controls:
    """Make the controls: a window with those of the scene, and one with pictures at the left."""
    gui = server.gui
    gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    gui.main_panel.dock_right()  # beside the scene, not over it
    found: dict[str, Any] = {}
    colors = [q for q in QUANTITIES if q in ("image", "depth", *result.quantities)]
    pictures = [k for k in KINDS if k in ("frame", "depth", "flow", "anaglyph", *result.quantities)]
    with gui.add_folder("Time"):
        last, is_alone = max(1, len(result.names) - 1), len(result.names) < 2
        found["frame"] = gui.add_slider(
            "Frame", min=0, max=last, step=1, initial_value=0, disabled=is_alone
        )
        found["play"] = gui.add_button("Play", disabled=is_alone)
        found["speed"] = gui.add_slider("Frames per second", min=1, max=30, step=1, initial_value=8)
        found["follow"] = gui.add_checkbox("Follow the camera", initial_value=False)
        found["go"] = gui.add_button("Go to the camera")
        found["status"] = gui.add_html("")
    with gui.add_folder("Points"):
        found["color"] = gui.add_dropdown("Colour", colors, initial_value="image")
        found["legend"] = gui.add_html("")
        found["shape"] = gui.add_dropdown("Shape", ("points", "surface"), initial_value="points")
        found["size"] = gui.add_slider("Size", min=0.5, max=4, step=0.1, initial_value=1.2)
        thousands = max(1, round(most_points / 1000))
        found["most"] = gui.add_slider(
            "Thousands, at most",
            min=1,
            max=max(500, thousands),
            step=1,
            initial_value=thousands,
        )
        found["min_confidence"] = gui.add_slider(
            "Least confidence",
            min=0,
            max=1,
            step=0.01,
            initial_value=0,
            visible="confidence" in result.quantities,
        )
        found["max_deviation"] = gui.add_slider(
            "Largest deviation, %",
            min=0.5,
            max=ANY_DEVIATION,
            step=0.5,
            initial_value=ANY_DEVIATION,
            visible="deviation" in result.quantities,
        )
        found["hidden"] = gui.add_checkbox(
            "Hidden in the next frame", True, visible="confidence" in result.quantities
        )
    with gui.add_folder("Whole scene", expand_by_default=False, visible=result.has_whole):
        found["whole"] = gui.add_dropdown("All frames", (NO_WHOLE, *WHOLES), initial_value=NO_WHOLE)
        found["whole_note"] = gui.add_html("")
        found["with_frame"] = gui.add_checkbox("Points of the frame", initial_value=True)
    with gui.add_folder("Path", expand_by_default=False, visible=result.has_one_scale):
        found["path"] = gui.add_checkbox("Path of the camera", initial_value=True)
        found["frusta"] = gui.add_checkbox("Frusta along it", initial_value=True)
        found["pictures"] = gui.add_checkbox("Pictures in them", initial_value=True)
        found["things"] = gui.add_checkbox(
            "Paths of things", initial_value=True, visible=bool(result.objects)
        )
    with gui.add_folder("Clipping box", expand_by_default=False):
        found["box"] = gui.add_checkbox("Clip", initial_value=False)
        found["box_low"] = gui.add_vector3("From X, Y, Z", initial_value=(-1, -1, 0), step=0.05)
        found["box_high"] = gui.add_vector3("To X, Y, Z", initial_value=(1, 1, 2), step=0.05)
    with gui.add_folder("Measure", expand_by_default=False):
        found["measure"] = gui.add_checkbox("Clicks measure", initial_value=False)
        found["distance"] = gui.add_html("")
        found["clear"] = gui.add_button("Clear")
    with gui.add_folder("Save", expand_by_default=False):
        found["screenshot"] = gui.add_button("Screenshot (PNG)")
        found["film"] = gui.add_button("Fly-through (MP4)")
        found["static"] = gui.add_button("Page that plays by itself (HTML)")
        found["progress"] = gui.add_html("")
    panel = gui.add_panel()
    blank = np.full((30, 40, 3), 200, np.uint8)
    with panel.add_tab("Pictures"):
        kinds, images = [], []
        for label, kind in (("Above", "frame"), ("Below", "depth")):
            kinds.append(gui.add_dropdown(label, pictures, initial_value=kind))
            images.append(gui.add_image(blank, jpeg_quality=85))
        found["pixel"] = gui.add_vector2("Column, row", initial_value=(0, 0), min=(0, 0), step=1)
        found["reading"] = gui.add_html("")
    panel.dock_left()
    return Controls(**found, kinds=(kinds[0], kinds[1]), images=(images[0], images[1]))
