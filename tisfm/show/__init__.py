"""Pictures of depth and motion, as arrays and as figures.

All pictures share one set of colours, which people with a colour vision deficiency can tell apart.
Functions take arrays. ``…_to_color`` and similar functions return uint8 pictures, red, green, blue.
``draw_…`` functions empty axes of Matplotlib, draw into them with a legend and units, and return
the axes. ``…_figure`` functions return a figure: a mosaic of panels drawn by ``draw_…`` functions.
The argument `limit` ends the range of colours, so that all pictures of a sequence can share one
range. Arrays with masked values are refused.

May import: `tisfm.formats`, `tisfm.metrics`, and of the top level `checks`, `frames` and
`status`.
"""

from tisfm.show.anaglyph import anaglyph, dubois
from tisfm.show.color_maps import (
    DEPTH_ERROR_RANGE,
    ERROR_RANGE,
    UNCERTAINTY_RANGE,
    confidence_to_color,
    depth_grey,
    depth_to_color,
    error_to_color,
    inverse_depth_limit,
    uncertainty_to_color,
)
from tisfm.show.draw_energy import draw_energy
from tisfm.show.draw_errors import draw_calibration, draw_depth_error, draw_flow_error
from tisfm.show.draw_flow import draw_arrows, draw_flow
from tisfm.show.draw_maps import (
    draw_confidence,
    draw_depth,
    draw_image,
    draw_labels,
    draw_uncertainty,
)
from tisfm.show.draw_paths import draw_object_paths, draw_path
from tisfm.show.error_figures import depth_error_figure, error_figure, flow_figure
from tisfm.show.figures import comparison_figure, panel_figure, rigid_figure, save_figure
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
from tisfm.show.second_view import second_view
from tisfm.show.stereo import stereo_view

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
    "draw_arrows",
    "draw_calibration",
    "draw_confidence",
    "draw_depth",
    "draw_depth_error",
    "draw_energy",
    "draw_flow",
    "draw_flow_error",
    "draw_image",
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
