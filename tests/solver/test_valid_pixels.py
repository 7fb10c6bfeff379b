"""Pixels that are ignored: what fills them, and that they contribute no data."""

import numpy as np
import pytest

import tisfm
from tests.noise import moving_noise
from tests.rendered import static_scene
from tisfm.motion.matched_planes import noise_deviation
from tisfm.motion.problems import flow_problem, pyramid_of
from tisfm.motion.sparse_matches import sparse_matches
from tisfm.solver.pixel_masks import filled
from tisfm.solver.smoothness import mean_step

SIZE = (96, 128)
SETTINGS = tisfm.Settings()
RNG = np.random.default_rng(0)


def half():
    """What counts: all but a logo in the left half."""
    counted = np.ones(SIZE, bool)
    counted[20:70, 10:60] = False
    return counted


def frames(motion=(3, 0)):
    return moving_noise(*SIZE, motion)


def pyramid(counted, motion=(3, 0)):
    return pyramid_of(*frames(motion), tisfm.Camera(focal=100.0), SETTINGS, counted)


def test_valid_pixels_stay_and_others_are_not_read():
    frame, counted = frames()[0], half()
    found = filled(frame, ~counted)
    np.testing.assert_array_equal(found[counted], frame[counted])
    assert frame[counted].min() <= found.min() and found.max() <= frame[counted].max()
    other = frame.copy()
    other[~counted] = RNG.uniform(0, 255, (~counted).sum())
    np.testing.assert_array_equal(filled(other, ~counted), found)


def test_a_ramp_is_about_continued():
    frame = np.broadcast_to(np.arange(128, dtype=np.float32), SIZE).copy()
    found = filled(frame, ~half())
    assert np.abs(found - frame).max() < 8
    ignored = np.zeros(SIZE, bool)
    ignored[40, 50] = True
    assert abs(filled(frame, ignored)[40, 50] - 50) < 1


@pytest.mark.parametrize("level", [7.0, 0.1, 1e8])
def test_a_uniform_frame_stays_uniform(level):
    frame = np.full((33, 47), level, np.float32)
    frame[5:20, 6:31] = 3
    np.testing.assert_array_equal(filled(frame, frame == 3), np.float32(level))


def test_all_but_one_pixel():
    ignored = np.ones(SIZE, bool)
    ignored[3, 4] = False
    frame = frames()[0]
    np.testing.assert_array_equal(filled(frame, ignored), frame[3, 4])
    assert not filled(frame, np.ones(SIZE, bool)).any()


def test_statistics_are_those_of_valid_pixels():
    frame = 100 + RNG.normal(0, 3, SIZE).astype(np.float32)
    frame[:, :64] = 100
    counted = np.zeros(SIZE, bool)
    counted[:, 64:] = True
    assert mean_step(frame, counted) == pytest.approx(mean_step(frame[:, 64:]), rel=1e-5)
    assert mean_step(frame) < 0.6 * mean_step(frame, counted)
    assert mean_step(frame, np.ones(SIZE, bool)) == pytest.approx(mean_step(frame), rel=1e-5)
    assert mean_step(frame, np.zeros(SIZE, bool)) == 0
    assert noise_deviation(frame, counted=counted) == pytest.approx(3, rel=0.15)
    assert noise_deviation(frame) < 1


def test_levels_avoid_ignored_pixels():
    counted = pyramid((half(), np.ones(SIZE, bool))).counted
    within, everywhere = counted.levels[0]
    assert not within[19:71, 9:61].any() and within.sum() == within.size - 52**2
    assert everywhere.all()
    for (first, _), frame in zip(counted.levels, pyramid(None).frames0, strict=True):
        assert first.shape == frame.shape and first.any() and not first.all()
    # A pixel here and there is no reason to leave out those of coarse levels.
    scattered = RNG.random(SIZE) > 0.02
    assert pyramid((scattered, scattered)).counted.levels[2][0].all()


def test_pixels_that_move_to_ignored_pixels_are_missing():
    everything = np.ones(SIZE, bool)
    counted = pyramid((everything, half())).counted
    flow = np.zeros((2, *SIZE), np.float32)
    flow[0] = 3.4
    expected = ~np.roll(half(), -3, axis=1)
    np.testing.assert_array_equal(counted.missing(flow), expected)
    np.testing.assert_array_equal(counted.reversed().missing(flow), ~half())
    flow[:, 50, 100] = np.nan  # where it diverged
    assert counted.missing(flow).shape == SIZE


def constraints(counted):
    """The constraints of the finest level under the true motion, (3·count, H, W)."""
    from tisfm.solver.coarse_to_fine import data_term_on, unknowns_on

    found = pyramid(counted)
    problem = flow_problem(SETTINGS, 100.0, stiffness=(1.0, 1.0))
    unknowns = unknowns_on(found, 0, problem)
    flow = np.zeros((2, *SIZE), np.float32)
    flow[0] = 3
    unknowns.set_images(flow)
    term = data_term_on(found, 0, problem, unknowns)
    term.bind_linearise(unknowns.rho)()
    return unknowns.to_images(term.constraints)


@pytest.mark.parametrize("frame", [0, 1])
def test_ignored_pixels_have_no_constraints(frame):
    everything = np.ones(SIZE, bool)
    counted = (half(), everything) if frame == 0 else (everything, half())
    found, usual = constraints(counted), constraints(None)
    missing = ~np.roll(half(), -3 * frame, axis=1)
    assert not found[:, missing].any()
    assert usual[:, missing].any(axis=0).mean() > 0.9
    # As far as the spline of the weights reaches, there is less; the mean step is another.
    ratio = np.hypot(found[0], found[1]) / np.hypot(usual[0], usual[1]).clip(1e-6)
    far = np.ones(SIZE, bool)
    far[16:74, :66] = False
    assert np.median(ratio[far]) == pytest.approx(1, abs=0.02)
    assert (ratio < 1.5)[far].mean() > 0.99


def test_points_on_ignored_pixels_are_not_matched():
    scene = static_scene("sideways", 240, 320)
    grey = [frame.astype(np.float32) for frame in (scene.frame0, scene.frame1)]
    counted = np.ones((240, 320), bool)
    counted[100:] = False
    usual = sparse_matches(*grey)
    for masks in ((counted, np.ones_like(counted)), (np.ones_like(counted), counted)):
        found = sparse_matches(*grey, masks)
        places = found.before if masks[0] is counted else found.after
        assert 20 < len(places) < 0.8 * len(usual.before)
        assert places[:, 1].max() < 100
    assert len(sparse_matches(*grey, (counted, ~counted)).before) < 3


def test_planes_of_ignored_pixels_are_not_believed():
    from tests.motion.test_matched_planes import scaled_motion
    from tisfm.motion.matched_planes import matched_planes

    scene = static_scene("sideways", 240, 320)
    grey = [frame.astype(np.float32) for frame in (scene.frame0, scene.frame1)]
    counted = np.ones((240, 320), bool)
    counted[60:180, 100:200] = False
    motion, _ = scaled_motion(scene)
    everything = np.ones_like(counted)
    assert np.abs(scene.flow).max() < 30
    usual = matched_planes(pyramid_of(*grey, scene.camera, SETTINGS), motion)
    assert usual.is_reliable[60:180, 100:200].mean() > 0.4
    for masks in ((counted, everything), (everything, counted)):
        found = matched_planes(pyramid_of(*grey, scene.camera, SETTINGS, masks), motion)
        inner = np.s_[60:180, 130:170]  # by no more than 30 px, it goes to what is ignored
        assert not found.is_reliable[inner].any()
        assert found.is_reliable[:50].mean() > 0.4


def test_windows_of_ignored_pixels_are_not_compared():
    from tisfm.kernels.rigid.windows import UNSEEN
    from tisfm.motion.matched_windows import WindowSearch

    everything = np.ones(SIZE, bool)
    flow = np.zeros((*SIZE, 2), np.float32)
    flow[..., 0] = 3
    for masks, before in (((half(), everything), 0), ((everything, half()), 3)):
        windows = WindowSearch(pyramid(masks), 0).windows(0)
        state, back = windows.score_flow(flow), windows.swap_frames().score_flow(-flow)
        assert (state[~np.roll(half(), -before, axis=1), 2] == UNSEEN).all()
        assert (back[~np.roll(half(), 3 - before, axis=1), 2] == UNSEEN).all()
        for one in (state, back):
            assert (one[75:, 10:-10, 2] < 0.3).mean() > 0.8


def test_the_sweep_continues_the_surroundings():
    from tisfm.motion.plane_sweep import sweep_depth

    frame0, frame1 = frames(motion=(6, 0))
    frame1[20:70, 10:60] = frame0[20:70, 10:60]  # a logo
    frame0[20:70, 10:60] = frame1[20:70, 10:60]
    motion = np.column_stack([np.eye(3), [1.0, 0, 0]])
    camera = tisfm.Camera(focal=100.0)
    nothing = np.zeros(SIZE, np.float32)
    usual = (frame0, frame1, motion, camera, np.arange(12.0), nothing + 6, nothing)
    depth = sweep_depth(*usual)
    assert np.median(depth[30:60, 20:50]) < 1
    counted = half()
    depth = sweep_depth(*usual, counted=(counted, counted))
    assert np.abs(depth[30:60, 20:50] - 6).max() < 1
