"""Tracks that last: the few that a path is built from."""

from collections.abc import Sequence

import numpy as np

from tisfm.reconstruction.tracks.tracker import Observations

# Cells along the longer side: each cell of a view keeps the track that most views see. The first
# number with enough tracks is used, since parts of frames may be bare. Set by hand.
CELL_COUNTS = (10, 16, 24)
# Tracks of a view, in the median, that are enough. Set by hand.
MIN_TRACKS = 60


def choose_long_tracks(seen: Sequence[Observations], longer_side: int) -> list[Observations]:
    """Return what views see of the tracks that last longest, of every place in every view.

    A track that few views see adds work, and little else: what it says of the path, those say
    that last. Points that look alike, which do not drift, count for more beside fewer tracks.

    Parameters
    ----------
    seen : sequence of Observations
        Tracks in views.
    longer_side : int
        Of the frames, px.
    """
    if not seen:
        return []
    chosen: list[np.ndarray] = []
    for cells in CELL_COUNTS:
        chosen = _chosen(seen, longer_side / cells)
        if np.median([len(one) for one in chosen]) >= MIN_TRACKS:
            break
    kept = np.unique(np.concatenate(chosen))
    return [_of(one, np.isin(one.tracks, kept)) for one in seen]


def _chosen(seen: Sequence[Observations], side: float) -> list[np.ndarray]:
    """Return, for each view, the track of each cell of a side in px that most views see."""
    tracks, views = np.unique(np.concatenate([one.tracks for one in seen]), return_counts=True)
    chosen = []
    for one in seen:
        count = views[np.searchsorted(tracks, one.tracks)]
        column, row = (one.points // side).astype(np.int64).T
        order = np.lexsort((one.tracks, -count, column, row))
        cell = np.stack([row, column], axis=1)[order]
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(cell, axis=0) != 0).any(axis=1)
        chosen.append(one.tracks[order[first]])
    return chosen


def _of(seen: Observations, kept: np.ndarray) -> Observations:
    return Observations(points=seen.points[kept], tracks=seen.tracks[kept])
