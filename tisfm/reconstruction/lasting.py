"""Tracks that last: the few that a path is built from."""

from collections.abc import Sequence

import numpy as np

from tisfm.reconstruction.tracks import Seen

CELLS = 10  # along the longer side: each of a view's cells gives the track that most views see


def lasting(seen: Sequence[Seen], longer_side: int) -> list[Seen]:
    """Return what views see of the tracks that last longest, of every place in every view.

    A track that few views see adds work, and little else: what it says of the path, those say
    that last. Points that look alike, which do not drift, count for more beside fewer tracks.

    Parameters
    ----------
    seen : sequence of Seen
        Tracks in views.
    longer_side : int
        Of the frames, px.
    """
    if not seen:
        return []
    tracks, views = np.unique(np.concatenate([one.tracks for one in seen]), return_counts=True)
    side = longer_side / CELLS
    chosen = [np.empty(0, np.int64)]
    for one in seen:
        count = views[np.searchsorted(tracks, one.tracks)]
        column, row = (one.points // side).astype(np.int64).T
        order = np.lexsort((one.tracks, -count, column, row))
        cell = np.stack([row, column], axis=1)[order]
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(cell, axis=0) != 0).any(axis=1)
        chosen.append(one.tracks[order[first]])
    kept = np.unique(np.concatenate(chosen))
    return [_of(one, np.isin(one.tracks, kept)) for one in seen]


def _of(seen: Seen, kept: np.ndarray) -> Seen:
    return Seen(points=seen.points[kept], tracks=seen.tracks[kept])
