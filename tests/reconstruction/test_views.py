"""The choice of frames as views, and the check of their order."""

import numpy as np

from tests.noise import moving_noise
from tests.reconstruction.films import walk
from tisfm.camera import Camera
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS
from tisfm.reconstruction.tracks import retrieval as loops
from tisfm.reconstruction.tracks.retrieval import ImageDescriptors, find_similar_views
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.views import View, ViewSelection, _detect_features

CAMERA = Camera(focal=144.0)


def views_with(pairs, count=10):
    views = ViewSelection(CAMERA)
    nothing = Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
    views.views = [
        View(frame=k, observations=nothing, detected=np.empty((0, 2))) for k in range(count)
    ]
    views.matches = {pair: np.zeros((30, 2), int) for pair in pairs}
    return views


def test_neighbours_that_match_are_in_order():
    assert not views_with([(k, k + 1) for k in range(9)]).is_out_of_order()


def test_views_that_match_all_but_their_neighbours_are_out_of_order():
    assert views_with([(k, k + 5) for k in range(5)]).is_out_of_order()


def test_views_that_match_nothing_may_be_in_order():
    assert not views_with([]).is_out_of_order()


def test_frame_becomes_a_view_after_tracks_moved():
    views = views_with([], count=0)
    points, tracks = np.random.default_rng(0).uniform(0, 300, (50, 2)), np.arange(50)
    seen = Observations(points=points, tracks=tracks)
    views.views = [View(frame=0, observations=seen, detected=points)]
    assert not views.needs_view(Observations(points=np.add(points, (7, 0)), tracks=tracks), 320)
    assert views.needs_view(Observations(points=np.add(points, (9, 0)), tracks=tracks), 320)
    assert views.needs_view(Observations(points=points[:15], tracks=tracks[:15]), 320)
    assert not views.needs_view(Observations(points=points[:20], tracks=tracks[:20]), 320)


def test_points_found_on_the_halved_frame_are_in_px_of_the_frame():
    half = np.rint(moving_noise(256, 256, (0, 0))[0].clip(0, 255)).astype(np.uint8)
    found = _detect_features(half.repeat(2, axis=0).repeat(2, axis=1), None).points
    assert len(found) > 100
    np.testing.assert_allclose(found, 2 * _detect_features(half, None).points + 0.5)


def test_ignored_pixels_have_no_points():
    grey = np.rint(moving_noise(256, 256, (0, 0))[0].clip(0, 255)).astype(np.uint8)
    ignored = np.zeros(grey.shape, bool)
    ignored[:128] = True
    whole, found = _detect_features(grey, None).points, _detect_features(grey, ignored).points
    np.testing.assert_array_equal(found, whole[np.rint(whole[:, 1]) >= 128])


def test_views_on_disk_are_those_in_memory():
    images = walk().frames[:6]
    found = []
    for on_disk in (False, True):
        views, tracker = ViewSelection(CAMERA, on_disk=on_disk), Tracker(CAMERA, TRACKING_SETTINGS)
        for k, image in enumerate(images):
            views.add(k, image, tracker.track(image), None)
        views.close_loops(images[0].shape)
        found.append((list(views.views), views.matches))
    for one, other in zip(*(views for views, _ in found), strict=True):
        assert one.frame == other.frame
        np.testing.assert_array_equal(one.detected, other.detected)
    assert list(found[0][1]) == list(found[1][1])


def test_similar_views_are_the_same_in_blocks(monkeypatch):
    random = np.random.default_rng(0)
    places = random.integers(0, 120, (30, 60, 128)).astype(np.uint8)
    noisy = [np.clip(places[k % 15] + random.integers(0, 9, (60, 128)), 0, 255) for k in range(30)]
    looks = [
        ImageDescriptors(points=np.zeros((60, 2)), quantised_roots=one.astype(np.uint8))
        for one in noisy
    ]
    whole = find_similar_views(looks, min_distance=4)
    monkeypatch.setattr(loops, "BLOCK_VIEWS", 7)
    assert find_similar_views(looks, min_distance=4) == whole
    assert {(k, k + 15) for k in range(15)} <= set(whole)
