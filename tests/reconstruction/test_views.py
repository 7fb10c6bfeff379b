"""Which frames become views, and whether they are in order."""

import numpy as np

from tests.reconstruction.walks import CAMERA
from tisfm.reconstruction.mapping import View
from tisfm.reconstruction.tracks import Seen
from tisfm.reconstruction.views import Views


def views_with(pairs, count=10):
    views = Views(CAMERA)
    nothing = Seen(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
    views.chosen = [View(frame=k, seen=nothing, detected=np.empty((0, 2))) for k in range(count)]
    views.matches = {pair: np.zeros((30, 2), int) for pair in pairs}
    return views


def test_neighbours_that_match_are_in_order():
    assert not views_with([(k, k + 1) for k in range(9)]).out_of_order()


def test_views_that_match_all_but_their_neighbours_are_out_of_order():
    assert views_with([(k, k + 5) for k in range(5)]).out_of_order()


def test_views_that_match_nothing_may_be_in_order():
    assert not views_with([]).out_of_order()


def test_a_frame_becomes_a_view_where_tracks_have_moved():
    views = views_with([], count=0)
    points, tracks = np.random.default_rng(0).uniform(0, 300, (50, 2)), np.arange(50)
    seen = Seen(points=points, tracks=tracks)
    views.chosen = [View(frame=0, seen=seen, detected=points)]
    assert not views.needs(Seen(points=np.add(points, (7, 0)), tracks=tracks), 320)
    assert views.needs(Seen(points=np.add(points, (9, 0)), tracks=tracks), 320)
    assert views.needs(Seen(points=points[:15], tracks=tracks[:15]), 320)
    assert not views.needs(Seen(points=points[:20], tracks=tracks[:20]), 320)
