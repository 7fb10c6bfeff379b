"""A pair of frames, end to end: motions, scenes with truth, statuses, sizes and threads."""

import hashlib

import numpy as np
import pytest

import tisfm
from tests.noise import moving_noise
from tests.rendered import static_scene, two_blocks
from tisfm.horn_schunck import horn_schunck
from tisfm.metrics import depth_errors, endpoint_error
from tisfm.solver.half_quadratic import MIN_CONFIRMATIONS, remaining_error


@pytest.fixture(scope="module")
def blocks():
    return two_blocks(90, 122, seed=1)


def test_a_change_of_brightness_and_contrast_changes_the_flow_little():
    """Gradient constancy and normalisation: what illumination does between two frames."""
    pair = two_blocks(120, 160, seed=4)
    darker = 0.8 * pair.frame1.astype(np.float32) + 15
    error = {}
    for name, changes in {"ours": {}, "brightness": {"brightness": 1.0, "gradient": 0.0}}.items():
        settings = tisfm.Settings(**changes)
        result = tisfm.interpret(
            pair.frame0.astype(np.float32), darker, camera=pair.camera, settings=settings
        )
        error[name] = endpoint_error(result.flow, pair.flow, mask=pair.visible)
    assert error["ours"] < 0.15
    assert error["ours"] < 0.5 * error["brightness"]


@pytest.mark.parametrize(
    ("preset", "motion"),
    [
        ("fast", (0, -3)),
        ("fast", (13, 9)),
        ("fast", (-18, 6)),
        ("balanced", (1, 0)),
        ("balanced", (-7, 4)),
        ("balanced", (-18, 6)),
        ("accurate", (1, 0)),
        ("accurate", (13, 9)),
    ],
)
def test_motions_of_up_to_twenty_pixels(motion, preset):
    frame0, frame1 = moving_noise(120, 160, motion)
    result = tisfm.interpret(frame0, frame1, settings=tisfm.Settings.preset(preset))
    error = np.linalg.norm(result.flow - np.array(motion), axis=-1)
    stays = np.zeros(error.shape, bool)
    dx, dy = motion
    stays[max(0, -dy) : 120 - max(0, dy), max(0, -dx) : 160 - max(0, dx)] = True
    assert np.median(error[stays]) < 0.05
    assert np.quantile(error[stays], 0.9) < 0.15


def test_sub_pixel_motion_at_a_single_scale():
    """The paper's own setting, within its range: less than a pixel."""
    pair = static_scene("sideways", 120, 160, seed=1)
    assert np.abs(pair.flow).max() < 2.5
    result = tisfm.interpret(
        pair.frame0, pair.frame1, camera=pair.camera, settings=tisfm.Settings.preset("paper")
    )
    assert endpoint_error(result.flow, pair.flow, mask=pair.visible) < 0.15


@pytest.mark.parametrize(("model", "depth_bar"), [("rigid", 0.2), ("translation", 0.1)])
def test_scene_with_truth(model, depth_bar):
    pair = static_scene("sideways", 240, 320, seed=0)
    settings = tisfm.Settings(model=model)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
    assert endpoint_error(result.flow, pair.flow, mask=pair.visible) < 0.05
    # Eq. 24 holds for sideways translation; ω is free in the rigid model and takes its share.
    assert depth_errors(result.depth, pair.depth).abs_rel < depth_bar
    assert result.status == "converged"


def test_better_than_horn_and_schunck_on_two_moving_blocks():
    pair = two_blocks(240, 320, seed=0)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera)
    baseline = horn_schunck(pair.frame0, pair.frame1)
    ours = endpoint_error(result.flow, pair.flow, mask=pair.visible)
    theirs = endpoint_error(baseline, pair.flow, mask=pair.visible)
    assert theirs < 0.15  # a fair baseline
    assert ours < 0.9 * theirs


@pytest.mark.parametrize("preset", ["paper", "fast", "balanced", "accurate"])
@pytest.mark.parametrize("model", ["rigid", "translation"])
def test_zero_motion_gives_exactly_zero(preset, model, blocks):
    settings = tisfm.Settings.preset(preset, model=model)
    result = tisfm.interpret(blocks.frame0, blocks.frame0, settings=settings)
    assert not result.rho.any()
    assert not result.flow.any()
    assert np.isnan(result.depth).all()
    assert result.status == "no_motion"
    assert "farther" in result.status.message


def test_uniform_frames_of_different_levels_have_no_texture():
    """At this size filters round so that a little remains of them."""
    frames = [np.full((376, 1241), level, np.uint8) for level in (0, 128)]
    result = tisfm.interpret(*frames)
    assert result.status == "no_texture"
    assert not result.flow.any() and not result.confidence.any()


def test_uniform_frames_have_no_texture():
    result = tisfm.interpret(np.full((30, 40), 90, np.uint8), np.full((30, 40), 120, np.uint8))
    assert not result.rho.any()
    assert not result.confidence.any()
    assert result.status == "no_texture"


@pytest.mark.parametrize("motion", ["field", "camera", "objects"])
@pytest.mark.parametrize("preset", ["paper", "fast", "balanced"])
def test_a_uniform_frame_has_no_motion(preset, motion, tmp_path):
    settings = tisfm.Settings.preset(preset, motion=motion)
    after = np.random.default_rng(0).normal(90, 4, (30, 40)).astype(np.float32)
    result = tisfm.interpret(
        np.full((30, 40), 90, np.float32), after, camera=tisfm.Camera(40.0), settings=settings
    )
    assert result.status == "no_texture"
    for name in ("rho", "flow", "inverse_depth", "confidence"):
        assert not getattr(result, name).any(), name
    result.save(tmp_path / "result.npz")


def test_iteration_limit_is_a_status_with_advice(blocks):
    settings = tisfm.Settings(outer_iterations=1, sweeps=1, tolerance=1e-4)
    result = tisfm.interpret(blocks.frame0, blocks.frame1, settings=settings)
    assert result.status == "iteration_limit"
    assert "outer_iterations" in result.status.message


def test_runaway_flow_has_diverged_status():
    """Frames of noise without relation, and next to nothing that holds the flow together."""
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2, 120, 160), dtype=np.uint8)
    result = tisfm.interpret(*frames, settings=tisfm.Settings(data_contrast=None, smoothness=1.0))
    assert np.isfinite(result.flow).all()
    assert result.status == "diverged"
    assert "data_contrast" in result.status.message


def status_of(flow, **options):
    """Return the status of an otherwise converged interpretation with this flow, (2, H, W)."""
    from tisfm.motion.frame_agreement import diverged_status
    from tisfm.visibility.occlusion import leaves_image

    flow = flow.astype(np.float32)
    return diverged_status(flow, leaves_image(flow), **options) or "converged"


@pytest.mark.parametrize(("move", "code"), [(15, "converged"), (19, "diverged")])
def test_flow_that_takes_most_pixels_out_of_the_image_has_diverged_status(move, code):
    """Towards the corner: 15 px leave 56 % of the pixels, 19 px leave 47 %."""
    status = status_of(np.full((2, 60, 60), move))
    assert status == code
    if code == "diverged":
        assert "leave the image" in status.message and "closer in time" in status.message


@pytest.mark.parametrize(("move", "code"), [(19, "converged"), (32, "converged"), (35, "diverged")])
def test_matched_points_confirm_a_large_motion(move, code):
    """Towards the corner: 32 px leave 22 % of the pixels, 35 px leave 17 %."""
    assert status_of(np.full((2, 60, 60), move), is_confirmed=True) == code


def test_matched_points_allow_far_motion_out_of_the_image():
    flow = np.zeros((2, 60, 60))
    flow[0, :, 50:] = 200
    assert status_of(flow) == "diverged" and status_of(flow, is_confirmed=True) == "converged"
    flow[0, 30, 20] = np.nan
    assert status_of(flow, is_confirmed=True) == "diverged"


@pytest.mark.parametrize(("length", "code"), [(29, "converged"), (31, "diverged"), (np.nan, None)])
def test_one_pixel_that_moves_by_half_the_image_will_do(length, code):
    flow = np.zeros((2, 60, 40))
    flow[:, 30, 20] = 0.6 * length, 0.8 * length
    status = status_of(flow)
    assert status == (code or "diverged")


def test_a_single_scale_stops_when_little_error_is_left(blocks):
    settings = tisfm.Settings.preset("paper", tolerance=1e-2)
    history = tisfm.interpret(blocks.frame0, blocks.frame1, settings=settings).history
    changes = list(history.change)
    left = [remaining_error(changes[:count]) for count in range(1, len(changes) + 1)]
    assert len(changes) < settings.outer_iterations
    assert max(left[-MIN_CONFIRMATIONS:]) <= 1e-2 < left[-MIN_CONFIRMATIONS - 1]


def test_coarse_to_fine_stops_when_the_variables_cease_to_evolve(blocks):
    settings = tisfm.Settings(tolerance=1e-2)
    history = tisfm.interpret(blocks.frame0, blocks.frame1, settings=settings).history
    for level, warp in {*zip(history.level, history.warp, strict=True)}:
        changes = history.change[(history.level == level) & (history.warp == warp)]
        assert len(changes) == settings.outer_iterations or changes[-1] <= 1e-2
        assert np.all(changes[1:-1] > 1e-2)


def test_frames_are_not_modified_and_results_repeat(blocks):
    frames = [blocks.frame0.astype(np.float32), blocks.frame1.astype(np.float32)]
    copies = [frame.copy() for frame in frames]
    for frame in frames:
        frame.flags.writeable = False
    first = tisfm.interpret(*frames)
    second = tisfm.interpret(*frames)
    for frame, copy in zip(frames, copies, strict=True):
        np.testing.assert_array_equal(frame, copy)
    for name in ("rho", "flow", "confidence", "occlusion"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    np.testing.assert_array_equal(first.history.energy, second.history.energy)


def bits():
    """Return a digest of the results of all kernels of a pair, for `tests/test_one_thread.py`."""
    pair = two_blocks(150, 203, seed=1)
    digest = hashlib.sha256()
    for changes in ({}, {"model": "translation", "cycles": 1}):
        settings = tisfm.Settings(**changes)
        result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
        arrays = result.rho, result.flow, result.confidence, result.occlusion, result.history.energy
        for array in arrays:
            digest.update(array.tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize(
    ("size", "model"),
    [
        ((4, 4), "rigid"),
        ((4, 4), "translation"),
        ((4, 90), "translation"),
        ((91, 5), "rigid"),
        ((17, 16), "translation"),
        ((33, 129), "rigid"),
    ],
)
def test_odd_and_tiny_sizes(size, model):
    frame0, frame1 = moving_noise(*size, (1, 0))
    result = tisfm.interpret(frame0, frame1, settings=tisfm.Settings(model=model))
    assert result.rho.shape == (6, *size)
    assert result.flow.shape == (*size, 2)
    assert np.isfinite(result.rho).all()
    assert np.isfinite(result.flow).all()
    if min(size) > 15:
        assert abs(np.median(result.flow[..., 0]) - 1) < 0.2


def test_pose_is_refused_until_a_reading_of_motion_uses_it(blocks):
    with pytest.raises(ValueError, match="pose"):
        tisfm.interpret(blocks.frame0, blocks.frame1, pose=np.eye(4))
