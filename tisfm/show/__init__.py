"""Pictures of depth and motion, as arrays and as figures.

Arrays in, arrays out: uint8 pictures, grey or red, green, blue. Whatever has a range takes it as
`limit`, so that all pictures of a sequence can share one. Arrays with masked values are refused.

May import: `tisfm.formats`, `tisfm.metrics`, and of the top level `checks` and `frames`.
"""

from tisfm.show.anaglyph import anaglyph, dubois, second_view
from tisfm.show.depth_error import DEPTH_ERROR_RANGE, depth_error_figure
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
from tisfm.show.grey import depth_grey, inverse_depth_limit
from tisfm.show.labels import label_colors, label_overlay
from tisfm.show.rigid_figure import rigid_figure
from tisfm.show.uncertainty import UNCERTAINTY_RANGE, uncertainty_to_color

__all__ = [
    "DEPTH_ERROR_RANGE",
    "ERROR_RANGE",
    "UNCERTAINTY_RANGE",
    "Arrows",
    "anaglyph",
    "color_wheel",
    "comparison_figure",
    "depth_error_figure",
    "depth_grey",
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
    "uncertainty_to_color",
    "usual_length",
]
