"""Windows of three frames: the previous frame improves a steady motion, and harms no other."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.rendered import three_blocks, two_blocks
from tisfm.metrics import endpoint_error_map

FAST, SPEED = tisfm.Settings.preset("fast"), 3.0


def triple(make, *, speed=SPEED, speed_before=None, **options):
    """Return three frames of a scene in steady motion, and the pair of the last two."""
    plain = make(8, 12)
    camera = -plain.motions[0]
    own = (plain.motions - plain.motions[0])[2:]
    before = -(speed if speed_before is None else speed_before)
    pair, previous = (
        make(camera_motion=factor * camera, block_motions=factor * own, **options)
        for factor in (speed, before)
    )
    return [previous.frame1, pair.frame0, pair.frame1], pair


def both(frames, pair, settings):
    """Return the last interpretation of a window of three frames, and that of the pair alone."""
    options = {"camera": pair.camera, "settings": settings}
    *_, last = tisfm.interpret_sequence(frames, window=3, **options)
    return last, tisfm.interpret(*frames[1:], **options)


@pytest.mark.parametrize(
    ("make", "preset"),
    [
        (two_blocks, "balanced"),
        pytest.param(three_blocks, "accurate", marks=pytest.mark.nightly),
        pytest.param(two_blocks, "accurate", marks=pytest.mark.nightly),
        pytest.param(three_blocks, "balanced", marks=pytest.mark.nightly),
    ],
)
def test_pixels_hidden_in_the_next_frame_are_seen_in_the_previous_one(make, preset):
    frames, pair = triple(make)
    last, alone = both(frames, pair, tisfm.Settings.preset(preset))
    hidden = ~pair.visible
    errors = [endpoint_error_map(result.flow, pair.flow) for result in (last, alone)]
    assert errors[0][hidden].mean() < 0.75 * errors[1][hidden].mean()
    assert errors[0][~hidden].mean() < errors[1][~hidden].mean()
    # Pixels that are hidden in frame 1 still count as hidden.
    assert last.occlusion[hidden].mean() > 0.7
    assert not last.confidence[last.occlusion].any()
    assert last.status == "converged"


@pytest.mark.parametrize("change", nightly_except(3.0, of=[-1.0, 0.0, 3.0]))
def test_unsteady_motion_is_no_worse_than_a_pair(change):
    frames, pair = triple(two_blocks, height=120, width=160, speed_before=change * SPEED)
    last, alone = both(frames, pair, FAST)
    errors = [endpoint_error_map(result.flow, pair.flow).mean() for result in (last, alone)]
    assert errors[0] < 1.05 * errors[1]


def test_frames_of_another_scene_before_change_nothing():
    frames, pair = triple(two_blocks, height=120, width=160)
    other = np.random.default_rng(0).integers(0, 255, frames[0].shape, dtype=np.uint8)
    last, alone = both([other, *frames[1:]], pair, FAST)
    np.testing.assert_array_equal(last.rho, alone.rho)
    # With a cut after the pair, the status of the last pair says so.
    last, alone = both([*frames[:2], other], pair, FAST)
    assert last.status == alone.status == "unrelated"
    np.testing.assert_array_equal(last.rho, alone.rho)


def test_no_motion_in_three_frames_is_exactly_none():
    _, pair = triple(two_blocks, height=60, width=80)
    last, _ = both([pair.frame0] * 3, pair, FAST)
    assert not last.flow.any() and last.status == "no_motion"


def test_three_frames_with_a_mask_and_distortion():
    frames, pair = triple(two_blocks, height=90, width=120)
    camera = replace(pair.camera, distortion=(0.02, 0.0, 0.0, 0.0, 0.0))
    mask = np.ones(frames[0].shape, bool)
    mask[-20:] = False
    options = {"camera": camera, "settings": FAST, "mask": mask}
    *_, last = tisfm.interpret_sequence(frames, window=3, **options)
    assert last.occlusion[-15:].all() and not last.confidence[-15:].any()
    *_, alone = tisfm.interpret_sequence(frames, **options)
    assert (last.rho != alone.rho).any()
    assert np.abs(last.flow - alone.flow)[:60].mean() < 0.3


@pytest.mark.parametrize(
    "preset", nightly_except("fast", "accurate", of=["paper", "fast", "balanced", "accurate"])
)
def test_every_preset_takes_three_frames_and_keeps_them(preset):
    frames, pair = triple(two_blocks, height=45, width=61, speed=1.0)
    copies = [frame.copy() for frame in frames]
    runs = [both(frames, pair, tisfm.Settings.preset(preset))[0] for _ in range(2)]
    np.testing.assert_array_equal(*(run.rho for run in runs))
    for frame, copy in zip(frames, copies, strict=True):
        np.testing.assert_array_equal(frame, copy)


def test_a_bend_is_fitted_on_every_surface():
    """Two planes side by side have different bends; one plane is partly hidden."""
    from tisfm.motion.previous_frame import fit_bend

    shape = (96, 128)
    near = np.broadcast_to(np.arange(shape[1]) >= 64, shape)
    rng = np.random.default_rng(1)
    back = np.where(near, 6.0, -2.0) + np.array([[[1.0]], [[0.5]]])
    back = (back + rng.normal(scale=0.01, size=back.shape)).astype(np.float32)
    bend = np.where(near, 0.5, -0.1) * np.ones((2, 1, 1))
    seen = np.ones(shape, bool)
    seen[30:60, 50:64] = False
    flow = (bend - back).astype(np.float32)
    flow[:, ~seen] = 100  # hidden pixels must not count
    found, off, steady = fit_bend(flow, back, seen)
    np.testing.assert_allclose(found, bend, atol=0.03)
    assert off[seen].max() < 0.01 and steady.all()


def test_a_bend_that_changes_everywhere_is_none():
    from tisfm.motion.previous_frame import fit_bend

    flow, back = np.random.default_rng(2).normal(scale=4, size=(2, 2, 60, 80)).astype(np.float32)
    seen = np.ones((60, 80), bool)
    assert fit_bend(flow, back, seen) is None
    assert fit_bend(flow, -flow, ~seen) is None
    assert fit_bend(flow, -flow, seen) is not None
    assert fit_bend(flow, flow, seen) is None  # forth and back: not a steady motion


def test_flow_is_inverted_at_its_end_points():
    from tisfm.motion.previous_frame import PreviousPair

    frame = np.zeros((40, 60), np.float32)
    flow = np.zeros((2, 40, 60), np.float32)
    flow[:, 10:20, 10:30] = np.array([7.0, 2.0])[:, None, None]
    hidden = np.zeros(frame.shape, bool)
    hidden[12:22, 30:37] = True  # other columns of the block arrive on pixels of the block itself
    back, seen = PreviousPair(frame0=frame, frame1=frame, flow=flow, hidden=hidden).backward_flow()
    np.testing.assert_array_equal(back[:, 12:22, 30:37], -flow[:, 10:20, 23:30])
    assert seen[12:22, 30:37].all()
    assert not seen[10:12, 10:30].any()  # the block leaves these pixels
    assert not back[:, ~seen].any()
