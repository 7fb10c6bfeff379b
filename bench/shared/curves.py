"""Colours of curves, those of all pictures, which every kind of colour vision tells apart."""

from tisfm.show.palette import as_hex, category_colors

BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = (
    as_hex(category_colors(8)[k]) for k in (5, 6, 3, 7, 1, 2)
)
CURVES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
