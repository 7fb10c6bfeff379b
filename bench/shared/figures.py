"""Colours of curves, those of all pictures, which are told apart without one kind of cone, too."""

from tisfm.show.palette import as_hex, category_colors

BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = (
    as_hex(category_colors(8)[k])
    for k in (5, 6, 3, 7, 1, 2)  # dark ones first; the yellow is too faint for a line
)
CURVES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
