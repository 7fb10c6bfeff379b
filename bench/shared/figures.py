"""Colours and axes of the pictures."""

from matplotlib.axes import Axes

from tisfm.show.palette import as_hex, category_colors

# Dark colours first; without yellow, which is too faint for a line. The palette is that of
# `tisfm.show`, whose colours people without one kind of cone can tell apart.
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = (
    as_hex(category_colors(8)[k]) for k in (5, 6, 3, 7, 1, 2)
)
CURVES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)


def tidy(axes: Axes) -> None:
    """Give axes a faint grid and no frame at the top and the right."""
    axes.grid(alpha=0.25, which="major", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
