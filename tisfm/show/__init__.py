"""Pictures of depth and motion, as arrays and as figures.

Here: one visual language, in colours that are told apart with a colour vision deficiency as well.
Arrays in, and one of three out: ``…_to_color`` and the like return uint8 pictures, red, green,
blue; ``draw_…`` draw into given axes of Matplotlib, which are emptied first, with a legend and
units, and return them; ``…_figure`` return figures of several panels. Whatever has a range takes it
as `limit`, so that all pictures of a sequence can share one. Arrays with masked values are refused.

May import: `tisfm.formats`, `tisfm.metrics`, and of the top level `checks`, `frames` and
`status`.
"""

from tisfm.show.anaglyph import anaglyph, dubois
from tisfm.show.confidence import confidence_to_color
from tisfm.show.depth import depth_grey, depth_to_color, inverse_depth_limit
from tisfm.show.depth_error import DEPTH_ERROR_RANGE, depth_error_figure
from tisfm.show.draw_energy import draw_energy
from tisfm.show.draw_errors import draw_calibration, draw_depth_error, draw_flow_error
from tisfm.show.draw_maps import (
    draw_confidence,
    draw_depth,
    draw_flow,
    draw_labels,
    draw_uncertainty,
)
from tisfm.show.draw_paths import draw_object_paths, draw_path
from tisfm.show.error import ERROR_RANGE, error_figure, error_to_color, flow_figure
from tisfm.show.figures import comparison_figure, panel_figure, save_figure
from tisfm.show.flow import (
    Arrows,
    color_wheel,
    flow_radius,
    flow_to_color,
    quiver_points,
    usual_length,
)
from tisfm.show.labels import label_colors, label_overlay
from tisfm.show.palette import UNKNOWN_COLOR, color_ramp
from tisfm.show.rigid_figure import rigid_figure
from tisfm.show.second_view import second_view
from tisfm.show.stereo import stereo_view
from tisfm.show.uncertainty import UNCERTAINTY_RANGE, uncertainty_to_color

__all__ = [
    "DEPTH_ERROR_RANGE",
    "ERROR_RANGE",
    "UNCERTAINTY_RANGE",
    "UNKNOWN_COLOR",
    "Arrows",
    "anaglyph",
    "color_ramp",
    "color_wheel",
    "comparison_figure",
    "confidence_to_color",
    "depth_error_figure",
    "depth_grey",
    "depth_to_color",
    "draw_calibration",
    "draw_confidence",
    "draw_depth",
    "draw_depth_error",
    "draw_energy",
    "draw_flow",
    "draw_flow_error",
    "draw_labels",
    "draw_object_paths",
    "draw_path",
    "draw_uncertainty",
    "dubois",
    "error_figure",
    "error_to_color",
    "flow_figure",
    "flow_radius",
    "flow_to_color",
    "inverse_depth_limit",
    "label_colors",
    "label_overlay",
    "panel_figure",
    "quiver_points",
    "rigid_figure",
    "save_figure",
    "second_view",
    "stereo_view",
    "uncertainty_to_color",
    "usual_length",
]
