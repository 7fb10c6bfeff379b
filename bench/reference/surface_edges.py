"""Depth edges moved to image edges: a pixel takes the surface whose grey levels it has."""

import numpy as np

RADIUS = 3  # px
FADING = 0.1


def by_look(
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    middle: np.ndarray,
    frame: np.ndarray,
    similar: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse depth and deviation whose edges lie where the frame has edges.

    Parameters
    ----------
    inverse_depth, deviation, frame : (H, W)
    middle : (H, W)
        Inverse depth between the two surfaces nearby; 0 if there is only one surface.
    similar : float
        Grey levels: a pixel that differs by this much from the centre weighs 1/e.
    """
    depth, spread = inverse_depth.copy(), deviation.copy()
    rows, columns = np.indices(frame.shape)
    for y, x in zip(*np.nonzero(middle), strict=True):
        square = (rows - y) ** 2 + (columns - x) ** 2
        votes = np.exp(-np.abs(frame - frame[y, x]) / similar) / (1 + FADING * square)
        votes *= (abs(rows - y) <= RADIUS) & (abs(columns - x) <= RADIUS)
        mine = inverse_depth[y, x] > middle[y, x]
        others = votes * ((inverse_depth > middle[y, x]) != mine)
        if others.sum() > votes.sum() / 2:
            depth[y, x] = (others * inverse_depth).sum() / others.sum()
            spread[y, x] = (others * deviation).sum() / others.sum()
    return depth, spread
