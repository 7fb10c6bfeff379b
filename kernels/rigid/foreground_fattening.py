"""Matches that belong to the contour of a nearer surface: foreground fattening.

A window beside an outline contains the contour of the nearer surface, whose texture matches at the
depth of that surface. So a strip of the farther surface, half a window wide, matches at the depth
of the nearer one. An occluding contour belongs to the nearer surface: a match is fattened if, along
one of eight directions,

- a contour lies a few cells behind the cell, and is stronger than every edge ahead of it;
- the plane of the depth ahead of it is farther than the match;
- behind the contour, depth is about that of the match.
"""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import check_array
from tisfm.kernels.layout.launch import Kernel

_DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))
_DIAGONAL = 2**0.5


def find_fattened(
    frame: np.ndarray,  # (h, w) float32: grey levels of the cells
    inverse_depth: np.ndarray,  # (h, w) float32: inverse depth of every cell; positive
    matches: np.ndarray,  # (h, w) float32: inverse depth of the matched cells; 0 without a match
    out: np.ndarray,  # (h, w) int32: 1 for a fattened match, otherwise 0
    *,
    contour_distance: int,  # cells: largest distance of the contour
    # cells: distance of the depth behind, and of the edges ahead; depth ahead is taken at this
    # distance and at 1.5 times it; at least 3
    surface_distance: int,
    contrast: float,  # contrast of the contour divided by that of the strongest edge ahead
    min_contrast: float,  # grey levels: smallest difference of the two contrasts, scaled as above
    # differences of inverse depth, as shares of the match: least from the farther surface, and
    # largest from the nearer surface
    min_step: float,
    max_difference: float,
) -> None:
    """Find matches that belong to the contour of a nearer surface.

    Positions beyond the border count as the nearest cell of the border.

    Raises TypeError, ValueError if an array is not of these types and sizes, or if
    `surface_distance` is below 3.
    """
    if surface_distance < 3:
        raise ValueError(f"surface_distance is {surface_distance}: expected at least 3 cells")
    shape = frame.shape
    for name, array in (("frame", frame), ("inverse_depth", inverse_depth), ("matches", matches)):
        check_array(array, shape, name, aligned=False)
    if out.shape != shape or out.dtype != np.int32:
        raise ValueError(f"out is {out.shape} {out.dtype}: expected {shape} int32")
    _find_fattened(
        frame, inverse_depth, matches, contour_distance, surface_distance, float(contrast),
        float(min_contrast), float(min_step), float(max_difference), out,
    )  # fmt: skip


@Kernel
def _find_fattened(
    frame: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (h, w)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (h, w)
    matches: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (h, w)
    contour_distance: ti.i32,
    surface_distance: ti.i32,
    contrast: ti.f32,
    min_contrast: ti.f32,
    min_step: ti.f32,
    max_difference: ti.f32,
    out: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (h, w)
):
    for y, x in ti.ndrange(frame.shape[0], frame.shape[1]):
        match, is_fattened = matches[y, x], 0
        if match > 0.0:
            for n in ti.static(range(len(_DIRECTIONS))):
                dy, dx = ti.static(_DIRECTIONS[n])
                length = ti.static(_DIAGONAL if dy * dx else 1.0)
                near_steps = ti.cast(contour_distance / length + 0.5, ti.i32)
                far_steps = ti.cast(surface_distance / length + 0.5, ti.i32)
                if _is_before_surface(
                    inverse_depth, y, x, dy, dx, near_steps, far_steps, match, min_step,
                    max_difference,
                ):  # fmt: skip
                    behind = _strongest_edge(frame, y, x, -dy, -dx, near_steps + 1)
                    ahead = _strongest_edge(frame, y, x, dy, dx, far_steps)
                    if behind > contrast * ahead + min_contrast:
                        is_fattened = 1
        out[y, x] = is_fattened


@ti.func
def _is_before_surface(
    inverse_depth: ti.template(), y, x, dy, dx, near_steps, far_steps, match, min_step,
    max_difference,
):  # fmt: skip
    """Return whether the surface ahead is farther than a match, and depth behind about the same."""
    # The plane through two points ahead, continued to the cell: a slanted surface is no step.
    beyond = far_steps + far_steps // 2
    first = _at(inverse_depth, y + far_steps * dy, x + far_steps * dx)
    second = _at(inverse_depth, y + beyond * dy, x + beyond * dx)
    ahead = first + (first - second) * (ti.cast(far_steps, ti.f32) / (far_steps // 2))
    behind = ti.max(
        _at(inverse_depth, y - 2 * dy, x - 2 * dx),
        _at(inverse_depth, y - near_steps * dy, x - near_steps * dx),
        _at(inverse_depth, y - far_steps * dy, x - far_steps * dx),
    )
    return ti.max(ahead, first) < match * (1.0 - min_step) and behind > match * (
        1.0 - max_difference
    )


@ti.func
def _strongest_edge(frame: ti.template(), y, x, dy, dx, steps):
    """Return the largest difference of neighbours among some steps from a cell."""
    strongest, last = 0.0, frame[y, x]
    for step in range(1, steps + 1):
        grey = _at(frame, y + step * dy, x + step * dx)
        strongest = ti.max(strongest, grey - last, last - grey)
        last = grey
    return strongest


@ti.func
def _at(image: ti.template(), row, column):
    """Return the value of the cell, or of the nearest cell of the border."""
    row = ti.max(0, ti.min(row, image.shape[0] - 1))
    column = ti.max(0, ti.min(column, image.shape[1] - 1))
    return image[row, column]
