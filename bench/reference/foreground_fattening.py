"""Matches that belong to the contour of a nearer surface."""

import numpy as np

Array = np.ndarray  # of float64

STEPS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # rows, columns


def find_fattened(
    # frame, inverse_depth, matches: (h, w); 0 without a match
    frame: Array,
    inverse_depth: Array,
    matches: Array,
    *,
    # as for `tisfm.kernels.rigid.foreground_fattening.find_fattened`
    contour_distance: int,
    surface_distance: int,
    contrast: float,
    min_contrast: float,
    min_step: float,
    max_difference: float,
) -> Array:  # (h, w) bool
    """Return the matches with a contour behind them that belongs to a nearer surface."""
    is_fattened = np.zeros(frame.shape, bool)
    for step in STEPS:
        length = np.hypot(*step)
        near = int(contour_distance / length + 0.5)
        far = int(surface_distance / length + 0.5)
        first, second = (_shifted(inverse_depth, step, k) for k in (far, far + far // 2))
        ahead = first + (first - second) * (far / (far // 2))  # the plane at the cell
        behind = [_shifted(inverse_depth, step, -k) for k in (2, near, far)]
        is_between = (np.maximum(ahead, first) < matches * (1 - min_step)) & (
            np.max(behind, axis=0) > matches * (1 - max_difference)
        )
        contour = _strongest_edge(frame, step, range(0, -near - 2, -1))
        other = _strongest_edge(frame, step, range(far + 1))
        is_fattened |= is_between & (contour > contrast * other + min_contrast)
    return is_fattened & (matches > 0)


def _strongest_edge(frame: Array, step: tuple[int, int], positions: range) -> Array:
    greys = np.array([_shifted(frame, step, k) for k in positions])
    return np.abs(np.diff(greys, axis=0)).max(axis=0)


def _shifted(image: Array, step: tuple[int, int], count: int) -> Array:
    """Return the image `count` steps ahead; beyond the border it repeats."""
    rows, columns = (
        (np.arange(length) + count * change).clip(0, length - 1)
        for length, change in zip(image.shape, step, strict=True)
    )
    return image[np.ix_(rows, columns)]
