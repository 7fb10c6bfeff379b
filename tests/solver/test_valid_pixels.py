"""Pixels that are ignored: what fills them, and that they contribute no data."""

import numpy as np
import pytest

import tisfm
from tests.noise import moving_noise
from tests.rendered import static_scene
from tisfm.motion.matched_planes import noise_deviation
from tisfm.motion.problems import flow_problem, pyramid_of
from tisfm.motion.sparse_matches import sparse_matches
from tisfm.solver.pixel_masks import fill_ignored
from tisfm.solver.smoothness import mean_step

SIZE = (96, 128)
SETTINGS = tisfm.Settings()
RNG = np.random.default_rng(0)


def half():
    """What counts: all but a logo in the left half."""
    valid = np.ones(SIZE, bool)
    valid[20:70, 10:60] = False
    return valid


def frames(motion=(3, 0)):
    return moving_noise(*SIZE, motion)


def pyramid(valid, motion=(3, 0)):
    return pyramid_of(*frames(motion), tisfm.Camera(focal=100.0), SETTINGS, valid)


def test_valid_pixels_stay_and_others_are_not_read():
    frame, valid = frames()[0], half()
    found = fill_ignored(frame, ~valid)
    np.testing.assert_array_equal(found[valid], frame[valid])
    assert frame[valid].min() <= found.min() and found.max() <= frame[valid].max()
    other = frame.copy()
    other[~valid] = RNG.uniform(0, 255, (~valid).sum())
    np.testing.assert_array_equal(fill_ignored(other, ~valid), found)


def test_a_ramp_is_about_continued():
    frame = np.broadcast_to(np.arange(128, dtype=np.float32), SIZE).copy()
    found = fill_ignored(frame, ~half())
    assert np.abs(found - frame).max() < 8
    ignored = np.zeros(SIZE, bool)
    ignored[40, 50] = True
    assert abs(fill_ignored(frame, ignored)[40, 50] - 50) < 1


@pytest.mark.parametrize("level", [7.0, 0.1, 1e8])
def test_a_uniform_frame_stays_uniform(level):
    frame = np.full((33, 47), level, np.float32)
    frame[5:20, 6:31] = 3
    np.testing.assert_array_equal(fill_ignored(frame, frame == 3), np.float32(level))


def test_all_but_one_pixel():
    ignored = np.ones(SIZE, bool)
    ignored[3, 4] = False
    frame = frames()[0]
    np.testing.assert_array_equal(fill_ignored(frame, ignored), frame[3, 4])
    assert not fill_ignored(frame, np.ones(SIZE, bool)).any()


def test_statistics_are_those_of_valid_pixels():
    frame = 100 + RNG.normal(0, 3, SIZE).astype(np.float32)
    frame[:, :64] = 100
    valid = np.zeros(SIZE, bool)
    valid[:, 64:] = True
    assert mean_step(frame, valid) == pytest.approx(mean_step(frame[:, 64:]), rel=1e-5)
    assert mean_step(frame) < 0.6 * mean_step(frame, valid)
    assert mean_step(frame, np.ones(SIZE, bool)) == pytest.approx(mean_step(frame), rel=1e-5)
    assert mean_step(frame, np.zeros(SIZE, bool)) == 0
    assert noise_deviation(frame, valid=valid) == pytest.approx(3, rel=0.15)
    assert noise_deviation(frame) < 1


def test_levels_avoid_ignored_pixels():
    valid = pyramid((half(), np.ones(SIZE, bool))).masks
    within, everywhere = valid.levels[0]
    assert not within[19:71, 9:61].any() and within.sum() == within.size - 52**2
    assert everywhere.all()
    for (first, _), frame in zip(valid.levels, pyramid(None).frames0, strict=True):
        assert first.shape == frame.shape and first.any() and not first.all()
    # A pixel here and there is no reason to leave out those of coarse levels.
    scattered = RNG.random(SIZE) > 0.02
    assert pyramid((scattered, scattered)).masks.levels[2][0].all()


def test_pixels_that_move_to_ignored_pixels_are_missing():
    everything = np.ones(SIZE, bool)
    valid = pyramid((everything, half())).masks
    flow = np.zeros((2, *SIZE), np.float32)
    flow[0] = 3.4
    expected = ~np.roll(half(), -3, axis=1)
    np.testing.assert_array_equal(valid.ignored_pixels(flow), expected)
    np.testing.assert_array_equal(valid.reversed().ignored_pixels(flow), ~half())
    flow[:, 50, 100] = np.nan  # where it diverged
    assert valid.ignored_pixels(flow).shape == SIZE


def constraints(valid):
    """The constraints of the finest level under the true motion, (3·count, H, W)."""
    from tisfm.solver.coarse_to_fine import data_term_on, unknowns_on

    found = pyramid(valid)
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
    valid = (half(), everything) if frame == 0 else (everything, half())
    found, usual = constraints(valid), constraints(None)
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
    valid = np.ones((240, 320), bool)
    valid[100:] = False
    usual = sparse_matches(*grey)
    for masks in ((valid, np.ones_like(valid)), (np.ones_like(valid), valid)):
        found = sparse_matches(*grey, masks)
        places = found.points0 if masks[0] is valid else found.points1
        assert 20 < len(places) < 0.8 * len(usual.points0)
        assert places[:, 1].max() < 100
    assert len(sparse_matches(*grey, (valid, ~valid)).points0) < 3


def test_planes_of_ignored_pixels_are_not_believed():
    from tests.motion.test_matched_planes import scaled_motion
    from tisfm.motion.matched_planes import matched_planes

    scene = static_scene("sideways", 240, 320)
    grey = [frame.astype(np.float32) for frame in (scene.frame0, scene.frame1)]
    valid = np.ones((240, 320), bool)
    valid[60:180, 100:200] = False
    motion, _ = scaled_motion(scene)
    everything = np.ones_like(valid)
    assert np.abs(scene.flow).max() < 30
    usual = matched_planes(pyramid_of(*grey, scene.camera, SETTINGS), motion)
    assert usual.is_reliable[60:180, 100:200].mean() > 0.4
    for masks in ((valid, everything), (everything, valid)):
        found = matched_planes(pyramid_of(*grey, scene.camera, SETTINGS, masks), motion)
        inner = np.s_[60:180, 130:170]  # by no more than 30 px, it goes to what is ignored
        assert not found.is_reliable[inner].any()
        assert found.is_reliable[:50].mean() > 0.4


def test_windows_of_ignored_pixels_are_not_compared():
    from tisfm.kernels.rigid.windows import UNTEXTURED
    from tisfm.motion.matched_windows import WindowSearch

    everything = np.ones(SIZE, bool)
    flow = np.zeros((*SIZE, 2), np.float32)
    flow[..., 0] = 3
    for masks, before in (((half(), everything), 0), ((everything, half()), 3)):
        windows = WindowSearch(pyramid(masks), 0).windows(0)
        state, back = windows.score_flow(flow), windows.swap_frames().score_flow(-flow)
        assert (state[~np.roll(half(), -before, axis=1), 2] == UNTEXTURED).all()
        assert (back[~np.roll(half(), 3 - before, axis=1), 2] == UNTEXTURED).all()
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
    valid = half()
    depth = sweep_depth(*usual, valid=(valid, valid))
    assert np.abs(depth[30:60, 20:50] - 6).max() < 1
