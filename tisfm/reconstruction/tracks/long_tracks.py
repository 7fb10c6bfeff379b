"""Selection of long tracks: the few from which a path is built."""

from collections.abc import Sequence

import numpy as np

from tisfm.reconstruction.tracks.tracker import Observations

# Cells along the longer side: each cell of a view keeps the track that most views see. The first
# number with enough tracks is used, since parts of frames may be bare. Set by hand.
CELL_COUNTS = (10, 16, 24)
# Median number of tracks of a view that is enough. Set by hand.
MIN_TRACKS = 60


def choose_long_tracks(
    seen: Sequence[Observations],  # tracks in views
    longer_side: int,  # longer side of the frames, px
) -> list[Observations]:
    """Return the observations of the longest track in each cell of each view.

    A track that few views see adds work but hardly any information that long tracks do not have.
    With fewer tracks, matches of points by appearance, which do not drift, get more weight.
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
