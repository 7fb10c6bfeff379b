"""Depth of the frames of a piece: the deviation of keyframes that contradict others."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import depth_error, walk
from tisfm import Settings
from tisfm.reconstruction.depth import segment_depth as depths
from tisfm.reconstruction.depth.segment_depth import depth_effort
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.view_fusion import (
    Keyframe,
    Projection,
    View,
    add_difference_to_deviation,
    align_edges,
    fill_holes,
    fuse_views,
    relative_difference,
    render_view,
    upsample,
)
from tisfm.rigid import pose_matrix

FAST = Settings.preset("fast", motion="camera")
SHAPE = (60, 80)


PROJECTION = Projection(focal=80.0, center=(39.5, 29.5))
STAY = np.eye(4)[:3]


def keyframe(inverse_depth, deviation, motion=STAY, grey=100.0):
    """Return a keyframe, in which unknown depth, NaN, is 0."""
    return Keyframe(
        inverse_depth=np.nan_to_num(inverse_depth),
        deviation=np.nan_to_num(deviation),
        grey=np.full(SHAPE, grey, np.float32),
        motion=motion,
    )


def view(inverse_depth, deviation):
    """Return a view of a keyframe from its own place."""
    own = keyframe(inverse_depth, deviation)
    return View(inverse_depth=inverse_depth, deviation=deviation, keyframe=own)


def flat(value=0.5):
    return np.full(SHAPE, value, np.float32)


def test_equal_views_have_no_difference():
    np.testing.assert_array_equal(relative_difference(flat(), [flat(), flat()]), 0)


@pytest.mark.parametrize("others", [[], [flat(np.nan)]])
def test_views_without_comparison_have_no_difference(others):
    np.testing.assert_array_equal(relative_difference(flat(), others), 0)


def test_difference_is_the_mean_over_views():
    apart = relative_difference(flat(), [flat(0.55), flat(0.6)])
    np.testing.assert_allclose(apart, 0.15, rtol=1e-5)


def test_difference_is_limited():
    np.testing.assert_allclose(
        relative_difference(flat(), [flat(5.0)]), DEPTH.difference_limit, rtol=1e-6
    )


def test_difference_is_local_or_the_median():
    other = flat()
    other[:, :30] = 0.6
    other[:, 50:] = np.nan
    apart = relative_difference(flat(), [other])
    np.testing.assert_allclose(apart[:, :25], 0.2, rtol=0.05)
    assert (apart[:, 35:48] < 0.02).all()
    np.testing.assert_allclose(apart[:, 55:], 0.2, rtol=1e-5)  # the median over compared pixels
    assert apart.dtype == np.float32


def test_pixels_without_depth_are_not_compared():
    mine = flat()
    mine[:, :40] = np.nan
    apart = relative_difference(mine, [flat(0.55)])
    np.testing.assert_allclose(apart[:, 60:], 0.1, rtol=1e-5)
    assert np.isfinite(apart).all()


def test_deviation_grows_with_the_difference_from_other_views():
    values = [(0.5, 0.01), (0.5, 0.02), (0.4, 0.01)]
    views = [view(flat(depth), flat(deviation)) for depth, deviation in values]
    first, second, third = add_difference_to_deviation(views, 2.0)
    np.testing.assert_array_equal(first.inverse_depth, 0.5)
    np.testing.assert_allclose(first.deviation, np.hypot(0.01, 2 * 0.1 * 0.5), rtol=1e-5)
    np.testing.assert_allclose(second.deviation, np.hypot(0.02, 2 * 0.1 * 0.5), rtol=1e-5)
    np.testing.assert_allclose(third.deviation, np.hypot(0.01, 2 * 0.25 * 0.4), rtol=1e-5)


def test_fused_depth_is_that_of_the_majority():
    one, other = flat(0.5), flat(0.52)
    wrong = flat(0.9)
    one[:, :20] = other[:, :20] = wrong[:, :10] = np.nan
    views = [view(each, 0.1 * each) for each in (wrong, one, other)]
    depth, deviation = fuse_views(views, flat(100), PROJECTION)
    assert np.isnan(depth[:, :10]).all() and np.isnan(deviation[:, :10]).all()
    np.testing.assert_allclose(depth[:, 10:20], 0.9, rtol=1e-6)
    np.testing.assert_allclose(depth[:, 20:], 0.51, rtol=1e-5)
    # The mean has no smaller deviation than its views.
    np.testing.assert_allclose(deviation[:, 20:], 0.051, rtol=1e-5)


@pytest.mark.parametrize("near_share", [0.1, 0.02])
def test_a_keyframe_that_does_not_see_the_near_surface_does_not_outvote_it(near_share):
    """A keyframe to the right sees only the wall; the thing is left of its image."""
    thing, wall = flat(0.2), flat(0.2)
    thing[:, :10] = 1.0
    aside = np.column_stack([np.eye(3), (0.5, 0, 0)])  # the wall moves by 8 px, the thing by 40 px
    sure = render_view(keyframe(wall, 0.01 * wall, aside), PROJECTION)
    unsure = view(thing, near_share * thing)
    depth, _ = fuse_views([unsure, sure], flat(100), PROJECTION)
    np.testing.assert_allclose(depth[:, :10], 1.0, rtol=1e-5)
    np.testing.assert_allclose(depth[:, 12:], 0.2, rtol=1e-4)


def test_a_keyframe_that_looks_through_a_surface_removes_it():
    wrong, wall = flat(0.2), flat(0.2)
    wrong[20:40, 30:50] = 1.0
    views = [view(wrong, 0.1 * wrong), view(wall, 0.01 * wall)]
    depth, _ = fuse_views(views, flat(100), PROJECTION)
    np.testing.assert_allclose(depth, 0.2, rtol=1e-5)


@pytest.mark.parametrize("continued", [False, True])
def test_the_background_is_continued_behind_a_thing(continued):
    depth = flat(0.2)
    depth[:, :30] = 1.0
    aside = np.column_stack([np.eye(3), (-0.2, 0, 0)])  # the thing moves by 16 px, the wall by 3 px
    shown = render_view(keyframe(depth, 0.1 * depth, aside), PROJECTION, continued=continued)
    gap = np.s_[1:-1, 15:25]
    np.testing.assert_allclose(shown.inverse_depth[1:-1, :14], 1.0, rtol=1e-4)
    if continued:
        np.testing.assert_allclose(shown.inverse_depth[gap], 0.2, rtol=1e-4)
        np.testing.assert_allclose(shown.deviation[gap], 0.2 * DEPTH.filled_deviation, rtol=1e-4)
    else:
        assert np.isnan(shown.inverse_depth[gap]).all()


def slanted():
    """Return the inverse depth of a plane."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return (0.5 + 0.002 * x + 0.003 * y).astype(np.float32)


@pytest.mark.parametrize("hole", [np.s_[:, :15], np.s_[20:40, 30:50], np.s_[41:, :]])
def test_holes_are_filled_with_planes(hole):
    plane = slanted()
    shown = plane.copy()
    shown[hole] = np.nan
    deviation = 0.01 * shown
    inverse_depth, spread = fill_holes(shown, deviation, flat(100))
    np.testing.assert_allclose(inverse_depth, plane, rtol=0.02)
    known = np.isfinite(shown)
    np.testing.assert_array_equal(inverse_depth[known], plane[known])
    np.testing.assert_array_equal(spread[known], deviation[known])
    np.testing.assert_allclose(
        spread[hole], DEPTH.filled_deviation * inverse_depth[hole], rtol=1e-6
    )


def test_holes_end_at_the_edges_of_the_frame():
    depth, frame = flat(0.5), flat(50)
    depth[:, 40:], frame[:, 40:] = 1.0, 150
    shown = depth.copy()
    shown[:, 30:50] = np.nan
    inverse_depth, _ = fill_holes(shown, 0.01 * shown, frame)
    np.testing.assert_allclose(inverse_depth[:, 30:39], 0.5, rtol=0.05)
    np.testing.assert_allclose(inverse_depth[:, 41:50], 1.0, rtol=0.05)


@pytest.mark.parametrize("beside", [39, 41])
def test_surfaces_end_where_the_frame_has_an_edge(beside):
    column = np.arange(SHAPE[1])
    depth, frame = flat(0.5), flat(50)
    depth[:, column >= beside], frame[:, column >= 40] = 1.0, 150
    found, deviation = align_edges(depth, 0.1 * depth, frame)
    expected = np.where(column < 40, 0.5, 1.0)
    np.testing.assert_allclose(found, np.broadcast_to(expected, SHAPE), rtol=1e-6)
    np.testing.assert_allclose(deviation, 0.1 * found, rtol=1e-6)


def test_planes_have_no_edges():
    plane = slanted()
    frame = flat(50)
    frame[:, 40:] = 150
    found, _ = align_edges(plane, 0.1 * plane, frame)
    np.testing.assert_array_equal(found, plane)


def test_frames_without_depth_stay_without_depth():
    inverse_depth, deviation = fill_holes(flat(np.nan), flat(np.nan), flat(100))
    assert np.isnan(inverse_depth).all() and np.isposinf(deviation).all()
    assert np.isnan(align_edges(inverse_depth, deviation, flat(100))[0]).all()


@pytest.mark.parametrize("stride", [1, 2, 4])
def test_upsampled_planes_stay(stride):
    plane = slanted()
    found = upsample(plane[::stride, ::stride], stride, SHAPE)
    assert found.shape == SHAPE and found.flags.c_contiguous
    inside = np.s_[: 1 - stride or None, : 1 - stride or None]  # beyond, the last pixel is repeated
    np.testing.assert_allclose(found[inside], plane[inside], rtol=1e-6)


def test_upsampling_does_not_mix_two_surfaces():
    depth = flat(0.5)
    depth[:, 41:], depth[:20, :10] = 1.0, np.nan
    found = upsample(depth[::2, ::2], 2, SHAPE)
    assert set(np.unique(found[np.isfinite(found)])) == {np.float32(0.5), np.float32(1.0)}
    np.testing.assert_array_equal(np.isnan(found), np.isnan(depth))
    np.testing.assert_array_equal(
        found[30:], np.where(np.arange(80) < 42, 0.5, 1.0)[None] + 0 * found[30:]
    )


def within_one(film, poses):
    found = tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, poses=poses,
                             depth_of="keyframes")  # fmt: skip
    shares = []
    for k in found.keyframes:
        off = np.abs(found.inverse_depth(k) - 1 / film.depth[k])
        shares.append((off <= found.inverse_depth_std(k)).mean())
    return np.mean(shares)


@pytest.mark.nightly  # test_window_depth.py compares errors with the deviation as well
@pytest.mark.parametrize("draws", [3, 6])
def test_errors_of_poses_are_in_the_deviation(monkeypatch, draws):
    film = walk(height=120, width=160)
    with_comparison, without = [], []
    # Three keyframes agree by chance: with a single draw the share may be anything above 0.5.
    for seed in range(draws):
        random = np.random.default_rng(seed)
        twists = random.normal(0, 1, (len(film.poses), 6)) * np.repeat((0.02, 0.004), 3)
        shaken = film.poses @ np.array([pose_matrix(twist) for twist in twists])
        with_comparison.append(within_one(film, shaken))
        with monkeypatch.context() as patched:
            patched.setattr(depths, "DEPTH", replace(DEPTH, deviation_per_difference=0.0))
            without.append(within_one(film, shaken))
    # About 0.8: rounding on a processor decides which keyframes agree.
    assert 0.6 < np.mean(with_comparison) < 0.9
    assert np.mean(without) < 0.6 * np.mean(with_comparison)


@pytest.mark.parametrize("preset", ["fast", "balanced", "accurate"])
def test_presets_have_the_effort_of_their_name(preset):
    assert depth_effort(Settings.preset(preset, motion="camera")) == preset


def test_effort_follows_the_settings_of_pairs():
    balanced = Settings.preset("balanced", motion="camera")
    assert depth_effort(replace(balanced, warps=3)) == "accurate"
    assert depth_effort(replace(balanced, warps=1, tolerance=0.01)) == "balanced"
    assert depth_effort(replace(balanced, finest_level=1, tolerance=0.01)) == "fast"


def test_fusion_of_keyframes_reduces_the_error(monkeypatch):
    film = walk()

    def error():
        found = tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, poses=film.poses,
                                 depth_of="keyframes")  # fmt: skip
        return np.mean([depth_error(found.depth(k), film.depth[k]) for k in found.keyframes])

    both = error()
    monkeypatch.setattr(
        depths, "fuse_views", lambda views, *_: (views[0].inverse_depth, views[0].deviation)
    )
    assert both < 0.96 * error()


def test_a_first_frame_whose_tracks_have_no_points_has_depth(monkeypatch):
    """Its neighbours are chosen with the median depth of the tracks of the next keyframe."""
    film = walk()
    track_depths = depths.track_depths

    def without_first(observations, points, pose):
        is_first = np.array_equal(pose, film.poses[0])
        found = track_depths(observations, points, pose)
        return tuple(values[:0] for values in found) if is_first else found

    monkeypatch.setattr(depths, "track_depths", without_first)
    found = tisfm.reconstruct(
        film.frames, camera=film.camera, settings=FAST, poses=film.poses, depth_of="keyframes"
    )
    assert found.keyframes[0] == 0
    assert depth_error(found.depth(0), film.depth[0]) < 0.1
