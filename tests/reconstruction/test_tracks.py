"""Tracks follow a moving picture, and stay apart."""

import cv2
import numpy as np
import pytest

from tests.noise import moving_noise
from tisfm import Camera
from tisfm.reconstruction.frames.image_motion import (
    TRACKING_SETTINGS,
    FlowCache,
    ImageMotion,
    flow_scale,
    shrink_for_flow,
)
from tisfm.reconstruction.tracks import tracker as point_tracker
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.reconstruction.tracks.tracker import (
    Tracker,
    choose_new_points,
    keep_first_in_squares,
    track_points,
)

CAMERA = Camera(focal=192.0)


def picture(shift):
    random = np.random.default_rng(3)
    large = cv2.GaussianBlur(random.uniform(0, 255, (300, 400)).astype(np.float32), (0, 0), 2.5)
    large = (large - large.mean()) * 4 + 128
    way = np.float32([[1, 0, -40 - shift[0]], [0, 1, -30 - shift[1]]])
    moved = cv2.warpAffine(large, way, (320, 240), flags=cv2.INTER_CUBIC)
    return np.rint(np.clip(moved, 0, 255)).astype(np.uint8)


def test_tracks_follow_a_shift():
    tracker = Tracker(CAMERA, TRACKING_SETTINGS)
    first, second = (tracker.track(picture(shift)) for shift in ((0, 0), (3.25, -1.5)))
    before, after = first.common_tracks(second)
    np.testing.assert_array_equal(first.tracks[before], second.tracks[after])
    there = first.points - (3.25, -1.5)
    inside = there[((there > 5) & (there < (314, 234))).all(axis=1)]
    assert len(before) > 0.95 * len(keep_first_in_squares(inside, 6.0))
    away = second.points[after] - first.points[before] - (-3.25, 1.5)
    assert np.median(np.hypot(*away.T)) < 0.1  # px


def test_tracks_are_the_same_with_precomputed_flow():
    frames = [picture(shift) for shift in ((0, 0), (3.25, -1.5), (6.5, -3.0))]
    asked = []

    def grey(number):
        asked.append(number)
        return frames[number]

    flow = FlowCache(CAMERA, grey)
    found, given = Tracker(CAMERA, TRACKING_SETTINGS), Tracker(CAMERA, TRACKING_SETTINGS)
    for number, frame in enumerate(frames):
        one = found.track(frame)
        two = given.track(frame, flow=flow.flow_to(number) if number else None)
        np.testing.assert_array_equal(one.tracks, two.tracks)
        np.testing.assert_allclose(one.points, two.points, atol=0.02)  # 3 px have 11 bits
    times = len(asked)
    np.testing.assert_array_equal(flow.flow_to(1), flow.flow_to(1))
    assert len(asked) == times
    misled = Tracker(CAMERA, TRACKING_SETTINGS)
    first = misled.track(frames[0])
    here, _ = first.common_tracks(misled.track(frames[1], flow=flow.flow_to(1) + 50))
    assert len(here) < 0.1 * len(first.tracks)


def test_points_follow_the_flow_of_frames_of_half_the_size():
    points = choose_new_points(picture((0, 0)), np.empty((0, 2)), None, 8)
    flow = np.full((120, 160, 2), (-3, 1.5), np.float32)
    moved, is_tracked = track_points(picture((0, 0)), picture((6, -3)), points, flow)
    assert is_tracked.mean() > 0.8
    np.testing.assert_allclose((moved - points)[is_tracked], [(-6, 3)] * is_tracked.sum(), atol=0.2)


def test_points_that_return_beside_their_start_are_lost(monkeypatch):
    points, flow = np.array([[100.0, 80.0], [150.0, 120.0]]), np.zeros((240, 320, 2), np.float32)
    searches = iter([points, np.add(points, [(0.4, 0), (0, 0.6)])])  # there, and back
    monkeypatch.setattr(
        point_tracker, "_search_points", lambda *_: (next(searches), np.ones(2, bool))
    )
    _, is_tracked = track_points(picture((0, 0)), picture((0, 0)), points, flow)
    assert is_tracked.tolist() == [True, False]


def test_first_of_meeting_tracks_continues():
    points = np.array([[10.2, 5.0], [12.9, 5.1], [10.5, 5.3], [40.0, 5.0]])
    assert keep_first_in_squares(points, 6.0).tolist() == [0, 1, 3]


def test_no_track_begins_on_ignored_pixels():
    ignored = np.zeros((240, 320), bool)
    ignored[:, :160] = True
    begun = choose_new_points(picture((0, 0)), np.empty((0, 2)), ignored, TRACKS.cells)
    assert len(begun) > 100
    assert (begun[:, 0] >= 160).all()


def test_tracks_end_on_ignored_pixels():
    tracker, ignored = Tracker(CAMERA, TRACKING_SETTINGS), np.zeros((240, 320), bool)
    ignored[:, :160] = True
    first, flow = tracker.track(picture((0, 0))), np.zeros((240, 320, 2), np.float32)
    second = tracker.track(picture((0, 0)), ignored, flow)
    assert (first.points[:, 0] < 155).sum() > 100
    assert (second.points[:, 0] > 159).all() and len(first.common_tracks(second)[0]) > 100


@pytest.mark.parametrize("width", [1241, 1240])
def test_odd_sides_are_padded_before_halving(width):
    grey = np.zeros((376, width), np.uint8)
    assert flow_scale(shrink_for_flow(grey), grey) == 0.5


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_diverging_flow_is_limited():
    motion = ImageMotion(Camera(focal=0.01), TRACKING_SETTINGS)
    for frame in moving_noise(48, 64, (3, 1)):
        motion.add(np.rint(frame.clip(0, 255)).astype(np.uint8))
    for flow in (motion.forward(0), motion.backward(1)):
        assert np.abs(flow).max() == 48 + 64
