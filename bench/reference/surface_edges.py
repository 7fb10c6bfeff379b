"""Which of two surfaces a pixel beside their edge shows, by which of them looks like it."""

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
        Between the two surfaces nearby; 0 where there is one alone.
    similar : float
        Levels: a pixel that differs by so much weighs 1/e.
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
