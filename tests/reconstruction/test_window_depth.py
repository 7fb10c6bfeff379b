"""Inverse depth of a keyframe from several frames whose poses are known."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from tests.one_thread import bits_on_one_thread, several_threads
from tests.reconstruction.views import views
from tisfm import Settings

SETTINGS = Settings.preset("balanced")


def found_in(arguments, **options):
    from tisfm.reconstruction.depth.window_depth import window_depth

    return window_depth(*arguments, SETTINGS, **options)


def bits():
    found = found_in(views("room").first(3))
    return hashlib.sha256(found.inverse_depth.tobytes() + found.deviation.tobytes()).hexdigest()


@pytest.mark.parametrize(
    ("kind", "limit"),
    [
        ("sideways", 0.01),
        pytest.param("forward+rotation", 0.014, marks=pytest.mark.nightly),
        ("room", 0.032),
    ],
)
def test_depth_of_rendered_scenes(kind, limit):
    scene = views(kind, 240, 320)
    found = found_in(scene.first(4))
    errors = scene.errors(found)
    assert errors.mean() < limit
    assert (found.inverse_depth > 0).all()
    assert found.inverse_depth.dtype == found.deviation.dtype == np.float32
    relative = found.deviation / found.inverse_depth
    surest = relative <= np.quantile(relative, 0.4)
    assert errors[surest].mean() < 0.5 * errors.mean()
    off = np.abs(found.inverse_depth - 1 / scene.depth)
    assert 0.6 < (off <= found.deviation).mean() < 0.85


@pytest.mark.parametrize(
    ("kind", "share"),
    [("sideways", 0.55), pytest.param("forward+rotation", 0.5, marks=pytest.mark.nightly)],
)
def test_error_falls_with_frames(kind, share):
    scene = views(kind, 120, 160, 8)
    errors = [scene.errors(found_in(scene.first(count))).mean() for count in (1, 2, 4, 8)]
    assert (np.diff(errors) < 0).all()
    assert errors[-1] < share * errors[0]


def test_unit_is_that_of_the_motions():
    key, others, motions, camera = views("sideways").first(2)
    found = found_in((key, others, motions, camera))
    longer = motions.copy()
    longer[:, :, 3] *= 100
    same = found_in((key, others, longer, camera))
    np.testing.assert_allclose(100 * same.inverse_depth, found.inverse_depth, rtol=1e-3)
    np.testing.assert_allclose(100 * same.deviation, found.deviation, rtol=1e-2)


def test_effort_sets_the_density_of_cells():
    scene = views("sideways", 240, 320)
    found = {effort: found_in(scene.first(2), effort=effort) for effort in ("fast", "balanced")}
    assert [found[effort].level for effort in found] == [1, 0]
    assert found["fast"].is_reliable.shape == (120, 160)
    assert scene.errors(found["balanced"]).mean() < scene.errors(found["fast"]).mean() < 0.03


def test_sizes_may_be_odd():
    key, others, motions, camera = views("sideways", 121, 163, 2).first(2)
    found = found_in((key, others, motions, camera))
    assert found.inverse_depth.shape == (121, 163)


def test_masked_pixels_are_ignored():
    scene = views("room")
    key, others, motions, camera = scene.first(3)
    spoilt = [frame.copy() for frame in others]
    rng = np.random.default_rng(0)
    mask = np.ones(key.shape, bool)
    mask[:, 100:] = False
    for frame in spoilt:
        frame[:, 100:] = key[:, 100:]  # it does not move, like a bonnet
    hidden = found_in((key, spoilt, motions, camera), masks=[mask] * 3)
    clean = scene.errors(found_in((key, others, motions, camera)))
    believed = scene.errors(found_in((key, spoilt, motions, camera)))
    inside = np.s_[:, 110:]
    errors = scene.errors(hidden)
    assert errors[inside].mean() < min(0.95 * believed[inside].mean(), 0.7)
    assert errors[:, :90].mean() < 1.5 * clean[:, :90].mean()
    noise = key.copy()
    noise[:, 100:] = rng.uniform(0, 255, noise[:, 100:].shape)
    found = found_in((noise, others, motions, camera), key_mask=mask)
    assert not found.is_reliable[:, 100:].any()
    assert found.is_reliable[:, :100].mean() > 0.3


def test_uniform_frames_have_no_depth():
    key, _, motions, camera = views("sideways").first(2)
    bare = np.full_like(key, 100)
    assert found_in((bare, [bare, bare], motions, camera)) is None


def half_seen_views():
    """Return six views of a scene, and masks: the first three views show the left half only."""
    scene = views("sideways", 120, 160, 6)
    masks = [np.ones(scene.key.shape, bool) for _ in scene.others]
    for mask in masks[:3]:
        mask[:, 80:] = False
    return scene, masks


def further_frames(scene, masks, indices, kept=()):
    from tisfm.reconstruction.depth.window_matching import FurtherFrames, OtherFrames

    frames = OtherFrames(
        grey=[scene.others[k] for k in indices],
        motions=scene.motions[list(indices)],
        masks=[masks[k] for k in indices],
    )
    return FurtherFrames(kept=kept, frames=frames)


def test_part_without_matches_is_matched_in_further_frames():
    scene, masks = half_seen_views()
    asked = []

    def choose_further(is_unmatched):
        asked.append(is_unmatched)
        return further_frames(scene, masks, (3, 4, 5))

    first = (scene.key, scene.others[:3], scene.motions[:3], scene.camera)
    once = found_in(first, masks=masks[:3])
    again = found_in(first, masks=masks[:3], choose_further=choose_further)
    assert len(asked) == 1 and asked[0][:, 90:].mean() > 0.9 > 0.1 > asked[0][:, :70].mean()
    right, left = np.s_[:, 90:], np.s_[:, :70]
    assert once.is_reliable[right].mean() < 0.1 < 0.8 < again.is_reliable[right].mean()
    assert scene.errors(again)[right].mean() < 0.5 * scene.errors(once)[right].mean()
    assert scene.errors(again)[left].mean() < 1.05 * scene.errors(once)[left].mean()


def test_second_matches_have_the_weight_and_the_frames_of_their_own_window():
    from tisfm.reconstruction.depth.match_deviation import match_weights
    from tisfm.reconstruction.depth.window_matching import OtherFrames, match_keyframe
    from tisfm.reconstruction.depth.window_planes import Window, window_planes

    scene, masks = half_seen_views()
    made = []

    def make_window(frames):
        arguments = scene.key, frames.grey, frames.motions, scene.camera
        made.append(Window(*arguments, cells=2**15, masks=frames.masks))
        return made[-1]

    further = further_frames(scene, masks, (4, 5), kept=(1,))
    frames = OtherFrames(grey=scene.others[:2], motions=scene.motions[:2], masks=masks[:2])
    matches = match_keyframe(frames, make_window, lambda unmatched: further)
    first, second, whole = made
    np.testing.assert_array_equal(matches.frames.motions, scene.motions[[0, 1, 4, 5]])
    for window, indices in ((second, (1, 4, 5)), (whole, (0, 1, 4, 5))):
        lengths = np.linalg.norm(scene.motions[list(indices), :, 3], axis=1) / window.unit
        np.testing.assert_allclose(np.linalg.norm(window.motions[:, :, 3], axis=1), lengths)
    first_planes, second_planes = window_planes(first), window_planes(second)
    is_second = second_planes.is_reliable & ~first_planes.is_reliable
    assert 0.1 < is_second.mean() < 1
    weights = match_weights(second, second_planes)[0]
    np.testing.assert_array_equal(matches.anchors[0][is_second], weights[is_second])
    np.testing.assert_allclose(
        matches.anchors[1][is_second] / whole.unit,
        (weights > 0)[is_second] * second_planes.inverse_depth[is_second] / second.unit,
        rtol=1e-5,
    )


def test_a_part_without_texture_is_not_matched_again():
    scene, masks = half_seen_views()
    bare = scene.key.copy()
    bare[:, 80:] = 120  # the part without matches shows nothing
    asked = []
    arguments = (bare, scene.others[:3], scene.motions[:3], scene.camera)
    found_in(arguments, masks=masks[:3], choose_further=lambda unmatched: asked.append(1))
    assert not asked


def test_a_small_part_without_matches_is_not_matched_again(monkeypatch):
    from tisfm.reconstruction.depth import window_matching

    scene, masks = half_seen_views()
    first = (scene.key, scene.others[:3], scene.motions[:3], scene.camera)
    asked = []
    for share in (0.4, 0.6):
        settings = replace(window_matching.DEPTH, min_unmatched_share=share)
        monkeypatch.setattr(window_matching, "DEPTH", settings)
        found_in(first, masks=masks[:3], choose_further=lambda unmatched: asked.append(1))
        assert len(asked) == 1


def test_depth_is_unchanged_if_no_further_frames_are_chosen():
    arguments = views("room").first(3)
    once, again = found_in(arguments), found_in(arguments, choose_further=lambda unmatched: None)
    np.testing.assert_array_equal(once.inverse_depth, again.inverse_depth)
    np.testing.assert_array_equal(once.deviation, again.deviation)


def test_arguments_are_left_alone_and_bits_stay():
    scene = views("room")
    arguments = scene.first(3)
    copies = arguments[0].copy(), [frame.copy() for frame in arguments[1]], arguments[2].copy()
    assert bits() == bits()
    np.testing.assert_array_equal(arguments[0], copies[0])
    np.testing.assert_array_equal(arguments[2], copies[2])
    for frame, copy in zip(arguments[1], copies[1], strict=True):
        np.testing.assert_array_equal(frame, copy)


@pytest.mark.nightly
@several_threads
def test_same_bits_with_one_thread_and_with_all():
    assert bits_on_one_thread(__name__) == bits()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: (a[0], [], a[2], a[3]), "others is empty"),
        (lambda a: (a[0], a[1], a[2][:1], a[3]), r"motions is \(1, 3, 4\) for 2 frames"),
        (lambda a: (a[0], [a[1][0], a[1][1][1:]], a[2], a[3]), r"others\[1\] is \(119, 160\)"),
        (lambda a: (a[0], a[1], a[2] * np.nan, a[3]), "not finite"),
        (lambda a: (a[0], a[1], a[2] * [1, 1, 1, 0], a[3]), "has no translation"),
    ],
)
def test_arguments_are_checked(change, message):
    with pytest.raises(ValueError, match=message):
        found_in(change(views("sideways").first(2)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"masks": [None]}, "masks has 1 for 2 frames"),
        ({"key_mask": np.ones((3, 4), bool)}, r"key_mask is \(3, 4\)"),
        ({"effort": "slow"}, "effort is 'slow': expected one of 'fast', 'balanced', 'accurate'"),
    ],
)
def test_options_are_checked(options, message):
    with pytest.raises(ValueError, match=message):
        found_in(views("sideways").first(2), **options)


def test_search_range_of_converging_cameras_exceeds_their_crossing():
    from tisfm.reconstruction.depth.window_planes import Window

    key, others, _, camera = views("sideways").first(1)
    turn = np.arctan(0.5)  # from 1 beside the key frame, at a point 2 ahead
    rotation = np.array(
        [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
    )
    parallel = np.column_stack([np.eye(3), [-1.0, 0, 0]])
    converging = np.column_stack([rotation, rotation @ [1.0, 0, 0]])
    reach = [
        Window(key, others, motion[None], camera, cells=2**17) for motion in (parallel, converging)
    ]
    met = 0.5 * camera.focal * reach[1].unit  # D of that point
    assert reach[1].max_depth > met > 0
    np.testing.assert_allclose(reach[1].max_depth - reach[0].max_depth, met, rtol=1e-6)


def test_propagated_depth_that_bends_is_uncertain():
    from tisfm.reconstruction.depth.window_depth import find_bend_share

    rows, columns = np.mgrid[:40, :50].astype(np.float32)
    distance = np.full((40, 50), 12, np.float32)
    plane = 20 + 0.1 * columns - 0.2 * rows
    bent = plane + 0.003 * (columns - 25) ** 2  # between objects that lie in no plane
    inner = np.s_[8:-8, 8:-8]  # without the border of the smoothing
    used = np.zeros((40, 50), bool)
    used[inner] = True
    assert find_bend_share(plane, distance, used)[inner].max() < 1e-3
    assert find_bend_share(plane, 3 * distance, used)[inner].max() < 1e-3  # also farther away
    assert find_bend_share(bent, distance, used)[inner].min() > 0.2
    assert find_bend_share(bent, 0 * distance, used).max() == 0  # at matches


def test_matches_are_uncertain_if_most_of_the_keyframe_bends():
    from tisfm.reconstruction.depth.window_depth import find_bend_share

    columns = np.arange(80)
    bent = (20 + 0.003 * (columns - 40) ** 2 * np.ones((40, 1))).astype(np.float32)
    used = np.ones((40, 80), bool)

    def at_match(matched):
        distance = np.where(columns < matched, 0, 12) * np.ones((40, 1), np.float32)
        return find_bend_share(bent, distance.astype(np.float32), used)[20, 10]

    assert 0.1 < at_match(matched=30) < 0.4 and at_match(matched=70) < 0.01
    used[:, 30:] = False  # masked cells do not count
    assert at_match(matched=30) == 0


def test_a_jump_is_a_bend_in_a_narrow_strip(monkeypatch):
    from tisfm.reconstruction.depth import window_depth

    jump = np.where(np.arange(60) < 30, 20, 22) * np.ones((40, 1))
    distance = np.full((40, 60), 12, np.float32)
    settings = replace(window_depth.DEPTH, deviation_of_bent_frame=0.0)
    monkeypatch.setattr(window_depth, "DEPTH", settings)

    def width():
        jumps = jump.astype(np.float32)
        share = window_depth.find_bend_share(jumps, distance, np.ones((40, 60), bool))
        return int((share[20] > 0.05).sum())

    narrow = width()
    monkeypatch.setattr(window_depth, "DEPTH", replace(settings, bend_window=1))
    assert 1.5 * narrow < width() < 24
