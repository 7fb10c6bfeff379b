"""Causes of missing poses: measures of images and tracks, and the statuses that they lead to."""

from dataclasses import replace
from types import SimpleNamespace
from unittest import mock

import cv2
import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import along
from tests.rendered import room_film
from tisfm.reconstruction.causes import image_measures as measures
from tisfm.reconstruction.causes.cause import explain_images, explain_motion
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.causes.image_measures import ImageMeasures
from tisfm.reconstruction.causes.track_measures import TrackMeasures
from tisfm.reconstruction.path.missing_poses import MissingPoses, split_runs
from tisfm.reconstruction.result.path_check import UNCHECKED, PathCheck
from tisfm.reconstruction.result.statuses import add_piece_note, find_cause, mark_contradicted
from tisfm.reconstruction.stages.checks import find_contradiction_causes
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.report.tables import MEANINGS
from tisfm.status import STATUSES, Status

CAMERA = tisfm.Camera(focal=100.0)
# A sharp film of a room, whose light does not change.
GOOD = dict(
    brightness=120.0,
    contrast=40.0,
    noise=1.5,
    sharpness=0.2,
    texture=0.6,
    light_change=0.01,
    fixed_correlation=0.0,
    coarse_correlation=0.6,
    repetition=0.2,
)


def images(**measures):
    """Return the measures of a good film, some of them changed."""
    found = ImageMeasures(pairs=(), points=())
    vars(found).update(GOOD | measures)
    return found


def tracks(**measures):
    """Return the measures of tracks of a camera that moves, some of them changed."""
    found = TrackMeasures(
        frames=(), observations=(), views=(), matches={}, camera=CAMERA, shape=(120, 160)
    )
    vars(found).update({"survival": 0.7, "motion": 0.1, "homography": 3.0} | measures)
    return found


def texture(seed=0, size=160, blur=1.5):
    noise = np.random.default_rng(seed).normal(0, 1, (size, size)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), blur)
    return np.clip(120 + 40 * smooth / smooth.std(), 0, 255)


def as_bytes(image):
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("changes", "code", "word"),
    [
        ({"fixed_correlation": 0.9}, "fixed_pattern", "sensor"),
        ({"light_change": 0.3}, "changing_light", "30 %"),
        ({"contrast": 2.0, "brightness": 9.0}, "no_texture", "dark"),
        ({"contrast": 2.0}, "no_texture", "bare"),
        ({"contrast": 0.0, "brightness": 0.0, "light_change": 5.0}, "no_texture", "dark"),
        ({"noise": 18.0}, "noise", "18 grey levels"),
        ({"sharpness": 0.02}, "no_texture", "blurred"),
        ({"texture": 0.05}, "no_texture", "5 %"),
        ({"repetition": 0.95}, "repeated_texture", "repeats"),
    ],
)
def test_every_measure_leads_to_its_status(changes, code, word):
    cause = explain_images(images(**changes), tracks(survival=0.1))
    assert cause == code and word in cause.message and code in STATUSES and code in MEANINGS


def test_good_images_are_no_cause():
    assert explain_images(images(), tracks()) is None
    still = images(fixed_correlation=1.0, coarse_correlation=1.0)  # a camera at rest
    assert explain_images(still, tracks()) is None
    assert explain_images(images(noise=18.0), tracks()) is None  # tracks go on all the same


def test_tracks_tell_rest_plane_and_the_rest():
    still = explain_motion(tracks(motion=0.005), is_focal_known=True)
    assert still == "little_parallax" and "hardly moves" in still.message
    plane = explain_motion(tracks(homography=0.2), is_focal_known=False)
    assert plane == "one_plane" and "--focal" in plane.message
    assert explain_motion(tracks(homography=0.2), is_focal_known=True) == "little_parallax"
    stream = explain_motion(tracks(homography=0.2), is_focal_known=True, are_turns_found=False)
    assert stream == "little_parallax" and "only turns" in stream.message
    assert "several motions" in explain_motion(tracks(), is_focal_known=True).message


def test_noise_level_is_that_of_added_noise():
    smooth = texture(blur=5)
    for deviation in (3, 12):
        noise = np.random.default_rng(1).normal(0, deviation, smooth.shape)
        assert measures.measure_noise(as_bytes(smooth + noise)) == pytest.approx(
            deviation, rel=0.15
        )


def test_textured_share_is_that_of_the_textured_half():
    image = texture()
    image[:, 80:] = 120
    noise = np.random.default_rng(1).normal(0, 3, image.shape)
    assert measures.measure_textured_share(as_bytes(image + noise), 3.0) == pytest.approx(
        0.5, abs=0.1
    )


def test_light_is_compared_along_tracks_and_in_rows():
    image, points = texture(), np.random.default_rng(0).uniform(20, 130, (40, 2))
    moved, brighter = as_bytes(np.roll(image, 7, 1)), as_bytes(1.2 * image)
    image = as_bytes(image)
    along_tracks = measures.compare_light_of_points
    assert along_tracks(image, moved, points, points + np.array([7, 0])) < 0.03
    assert along_tracks(image, brighter, points, points) == pytest.approx(np.log(1.2), abs=0.03)
    assert measures.compare_light_of_rows(image, moved) < 0.03
    assert measures.compare_light_of_rows(image, brighter) == pytest.approx(np.log(1.2), abs=0.03)


def test_fixed_pattern_correlates_at_the_same_pixel():
    pattern = np.random.default_rng(1).normal(0, 10, (160, 160))
    frames = [as_bytes(np.roll(texture(blur=3), 9 * k, 1) + pattern) for k in range(2)]
    assert measures.correlate_details(*frames) > 0.8 > measures.correlate_coarse(*frames)
    moved = [as_bytes(np.roll(texture(), 9 * k, 1)) for k in range(2)]
    assert abs(measures.correlate_details(*moved)) < 0.1


def test_tiles_repeat_themselves_and_noise_does_not():
    y, x = np.mgrid[:120, :160]
    tiles = as_bytes(120 + 50 * np.sign(np.sin(x / 4) * np.sin(y / 4)))
    assert (
        measures.measure_repetition(tiles)
        > 0.9
        > 0.3
        > measures.measure_repetition(as_bytes(texture()))
    )
    assert measures.measure_repetition(np.full((60, 80), 7, np.uint8)) == 0


def test_blur_lowers_sharpness():
    image = as_bytes(texture(blur=1))
    fine = measures.measure_sharpness(image)
    assert fine > 0.5 > 5 * measures.measure_sharpness(cv2.GaussianBlur(image, (0, 0), 8))


def test_measures_of_one_pair_are_finite():
    pair = as_bytes(texture()), as_bytes(np.roll(texture(), 3, 1))
    found = ImageMeasures(pairs=[pair], points=[(np.zeros((0, 2)), np.zeros((0, 2)))])
    assert all(np.isfinite(getattr(found, name)) for name in GOOD)
    assert explain_images(found, tracks()) is None


def frames_with_tracks(counts):
    """Return tracks of frames: each frame shows as many of the points 0, 1, 2, …"""
    random = np.random.default_rng(0)
    return [
        Observations(points=random.uniform(10, 100, (count, 2)), tracks=first + np.arange(count))
        for first, count in counts
    ]


def search_in(observations, grey=None):
    return CauseSearch(
        observations=observations,
        views=[],
        matches={},
        camera=CAMERA,
        shape=(120, 160),
        grey=grey,
    )


def missing_poses(frames, search, *, has_pieces=True):
    return MissingPoses(
        frames=frames, search=search, has_pieces=has_pieces, distinct_count=4, is_focal_known=True
    )


def test_frames_beside_a_path_tell_a_cut_from_another_view():
    search = search_in(frames_with_tracks([(0, 50), (1000, 50), (1020, 50), (1022, 5)]))
    statuses = missing_poses([1, 2, 3], search)
    assert [str(status) for status in statuses.values()] == ["unrelated", "unrelated", "no_texture"]
    assert "a cut" in statuses[1].message and "another part" in statuses[2].message


def scenes():
    """Return a film of two scenes of four frames, one of them twice as bright, and its tracks."""
    shows = [
        as_bytes(scale * texture(seed)[:120])
        for seed, scale in ((0, 0.6), (1, 1.2))
        for _ in "1234"
    ]
    return shows, frames_with_tracks([(0, 50)] * 4 + [(1000, 50)] * 4)


def test_cut_is_no_change_of_light():
    shows, observations = scenes()
    for k, tracked in enumerate(observations):
        tracked.points[:] = observations[k // 4 * 4].points
    search = search_in(observations, grey=lambda frame: shows[frame])
    for run in ([3], [4], [7], [3, 4], [2, 3, 4, 5]):
        assert search.find_image_cause(run) is None
    assert "a cut" in missing_poses([4], search)[4].message


def test_light_that_ends_all_tracks_is_a_change_of_light():
    shows = [as_bytes((0.6, 1.2)[k % 2] * texture()[:120]) for k in range(6)]
    observations = frames_with_tracks([(1000 * k, 50) for k in range(6)])
    search = search_in(observations, grey=lambda frame: shows[frame])
    assert search.find_image_cause(range(6)) == "changing_light"


def test_images_are_read_when_a_status_is_asked_for():
    shows, observations = scenes()
    asked = []
    search = search_in(observations, grey=lambda frame: asked.append(frame) or shows[frame])
    missing = missing_poses([2, 3, 6], search)
    assert list(missing) == [2, 3, 6] and len(missing) == 3 and not asked
    assert missing[2] and missing[3] and set(asked) <= {1, 2, 3, 4} and asked
    count = len(asked)
    assert missing[3] and len(asked) == count  # a run is measured once


def test_large_frames_are_shrunk_before_they_are_measured():
    large = [as_bytes(cv2.resize(np.roll(texture(), 3 * k, 1), (1280, 1280))) for k in range(2)]
    search = search_in(frames_with_tracks([(0, 50)] * 2), grey=lambda frame: large[frame])
    started = []
    original = measures.measure_repetition

    def measure(grey):
        started.append(grey.size)
        return original(grey)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measures, "measure_repetition", measure)
        search.find_image_cause([0, 1])
    assert max(started, default=0) < 2**18


def test_contradiction_names_what_hides_the_motion():
    check = replace(UNCHECKED, fixed_share=0.5, infinity_motion=9.0)
    assert check.contradicts
    first, second = mark_contradicted(
        [Status("converged")] * 2, [0, 1], [check, check], causes={1: "the brightness changes"}
    )
    assert first == second == "contradicted" and first.message == check.message
    assert second.message == f"{check.message}. Probable cause: the brightness changes"
    assert find_cause(first) == "" and find_cause(second) == "the brightness changes"
    assert find_cause(add_piece_note(second)) == "the brightness changes"


class DoubtedCheck(PathCheck):
    """A check whose only objection is the order of depth, as beside a fixed pattern."""

    objections = ("rank",)

    def median(self, name):
        return {"rank": 0.44}[name]


@pytest.mark.parametrize(
    ("cause", "contradicted"),
    [
        (Status("fixed_pattern", "a pattern is fixed on the sensor"), True),
        (Status("noise", "noise hides the motion"), True),
        (Status("repeated_texture", "the texture repeats itself"), False),
        (None, False),
    ],
)
def test_doubt_beside_what_misleads_tracks_is_a_contradiction(cause, contradicted):
    check = DoubtedCheck(pairs=(), fixed_share=0.0, infinity_motion=0.0)
    assert not check.contradicts and check.doubt
    path = SimpleNamespace(observations=(), pieces=[SimpleNamespace(poses={0: None, 1: None})])
    frames = SimpleNamespace(camera=CAMERA, shape=(60, 80), tracker_input=None)
    with mock.patch.object(CauseSearch, "find_image_cause", return_value=cause):
        causes = find_contradiction_causes(frames, path, [check])
    (status,) = mark_contradicted([Status("converged")], [0], [check], causes)
    assert (status == "contradicted") == contradicted
    if contradicted:
        assert status.message == f"{check.doubt}. Probable cause: {cause.message}"
        assert "rank correlation 0.44" in status.message


def test_doubt_of_a_chunk():
    part = DoubtedCheck(pairs=(), fixed_share=0.0, infinity_motion=0.0)
    joined = PathCheck.joined([UNCHECKED, part])
    assert "a part of the frames" in joined.doubt and part.doubt in joined.doubt
    assert UNCHECKED.doubt == ""


def test_runs_of_frames():
    assert split_runs([]) == [] and split_runs([3]) == [[3]]
    assert split_runs([0, 1, 4, 5, 6, 9]) == [[0, 1], [4, 5, 6], [9]]


def spoiled(kind):
    """Return a film of a room with strong noise, or with a strong fixed pattern."""
    film = room_film(along(5), 120, 160, samples=1)
    random = np.random.default_rng(0)
    shape = film.frames.shape[1:] if kind == "fixed_pattern" else film.frames.shape
    noise = np.broadcast_to(random.normal(0, 40, shape), film.frames.shape)
    return [as_bytes(frame + off) for frame, off in zip(film.frames, noise, strict=True)], film


@pytest.mark.parametrize("kind", ["noise", "fixed_pattern"])
def test_spoiled_film_has_the_status_of_its_cause(kind):
    frames, film = spoiled(kind)
    fast = tisfm.Settings.preset("fast", motion="camera")
    result = tisfm.reconstruct(frames, camera=film.camera, settings=fast)
    assert set(map(str, result.status)) == {kind}
