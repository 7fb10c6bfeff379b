"""The choice of the tracks that a path is built from."""

from dataclasses import replace

import numpy as np
import pytest

from tisfm.reconstruction.tracks import views as module
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import choose_long_tracks

SIDE = 400  # px, of the frames
CELL = SIDE / TRACKS.cell_counts[0]


@pytest.fixture
def any_number(monkeypatch):
    """Accept the first grid of cells, however few tracks it gives."""
    monkeypatch.setattr(module, "TRACKS", replace(TRACKS, min_tracks=0))


def views(seed=0, count=5):
    """Return the tracks that views see, at random."""
    random = np.random.default_rng(seed)
    seen = []
    for _ in range(count):
        tracks = np.sort(random.choice(400, 250, replace=False))
        seen.append(Observations(points=random.uniform(0, SIDE, (250, 2)), tracks=tracks))
    return seen


def expected(seen):
    """Return the same choice of tracks, cell by cell."""
    lives = {track: sum(track in one.tracks for one in seen) for track in range(400)}
    kept = set()
    for one in seen:
        best = {}
        for point, track in zip(one.points, one.tracks.tolist(), strict=True):
            rank = (-lives[track], track)
            cell = tuple((point // CELL).astype(int))
            best[cell] = min(best.get(cell, rank), rank)
        kept |= {track for _, track in best.values()}
    return kept


def test_every_cell_gives_the_track_that_most_views_see(any_number):
    seen = views()
    kept = expected(seen)
    few = choose_long_tracks(seen, SIDE)
    assert len(few) == len(seen)
    for one, before in zip(few, seen, strict=True):
        inside = np.array([track in kept for track in before.tracks.tolist()])
        np.testing.assert_array_equal(one.tracks, before.tracks[inside])
        np.testing.assert_array_equal(one.points, before.points[inside])
    assert sum(len(one.tracks) for one in few) < 0.9 * sum(len(one.tracks) for one in seen)


def test_views_without_tracks_stay():
    nothing = Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
    few = choose_long_tracks([nothing, *views(count=2), nothing], SIDE)
    assert [len(one.tracks) for one in (few[0], few[-1])] == [0, 0]
    assert len(few[1].tracks) > 0
    assert choose_long_tracks([], SIDE) == []


def test_one_track_of_a_cell_is_enough(any_number):
    points = np.array([[3.0, 3.0], [5.0, 4.0], [3.0 + CELL, 3.0]])
    seen = [
        Observations(points=points, tracks=np.array([0, 1, 2])),
        Observations(points=points[1:], tracks=np.array([1, 2])),
    ]
    assert [one.tracks.tolist() for one in choose_long_tracks(seen, SIDE)] == [[1, 2], [1, 2]]


def test_enough_tracks_from_a_part_of_the_frames():
    points = np.stack(np.meshgrid(np.arange(5, SIDE, 10.0), np.arange(5, 100, 10.0)), -1)
    tracks = np.arange(points.size // 2)
    seen = [Observations(points=points.reshape(-1, 2), tracks=tracks)] * 3
    few = choose_long_tracks(seen, SIDE)
    assert TRACKS.min_tracks <= len(few[0].tracks) < len(tracks)
