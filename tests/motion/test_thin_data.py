"""Frames with little texture, a small patch on a uniform ground, raise no internal error."""

import cv2
import numpy as np
import pytest

import tisfm
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion


def thin_pair(seed):
    """Return two uint8 frames: uniform, with a moving patch of 10 to 40 px."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers((96, 120), (150, 190))
    side = rng.integers(10, 41)
    top, left = rng.integers(0, (height - side, width - side))
    texture = rng.uniform(0, 255, (side, side)).astype(np.float32)
    frame = np.full((height, width), rng.integers(0, 200), np.float32)
    frame[top : top + side, left : left + side] = cv2.GaussianBlur(
        texture, (0, 0), rng.uniform(0.5, 3)
    )
    moved = np.roll(frame, rng.integers(-3, 4, 2), (0, 1))
    return np.rint(frame).astype(np.uint8), np.rint(moved).astype(np.uint8)


# In earlier versions, these patches left fewer samples than an essential matrix needs, or samples
# that do not determine an essential matrix.
SEEDS = ((31, "camera"), (72, "camera"), (8, "objects"), (17, "objects"), (46, "objects"))


@pytest.mark.parametrize(("seed", "motion"), SEEDS)
def test_a_textured_patch_is_interpreted_or_reported_as_too_little(seed, motion):
    frame0, frame1 = thin_pair(seed)
    camera = tisfm.Camera(focal=1.2 * max(frame0.shape))
    settings = tisfm.Settings.preset("fast", motion=motion)
    result = tisfm.interpret(frame0, frame1, camera=camera, settings=settings)
    assert result.status in (
        "converged",
        "iteration_limit",
        "unrelated",
        "little_parallax",
        "pure_rotation",
        "no_motion",
        "no_texture",  # on some processors, too few pixels are confident
        "uncertain",  # so few pixels hardly show the direction of motion
        "two_motions",  # on others, texture that enters at the borders fits as well as the patch
    )
    for array in (result.flow, result.inverse_depth, result.confidence):
        assert np.isfinite(array).all()


def patch_flow(side, *, moves=True):
    """Return a flow with confidence only in a patch of side × side px, and the confidence."""
    rng = np.random.default_rng(0)
    confidence = np.full((120, 160), 0.05, np.float32)
    confidence[40 : 40 + side, 60 : 60 + side] = 0.9
    flow = np.zeros((120, 160, 2), np.float32)
    if moves:
        flow += rng.normal((2, 0), 0.3, flow.shape)
    return flow, confidence


@pytest.mark.parametrize("side", [6, 8, 12, 20])
@pytest.mark.parametrize("moves", [True, False])
def test_a_few_confident_pixels_give_a_motion(side, moves):
    found = camera_motion(*patch_flow(side, moves=moves), tisfm.Camera(focal=200.0))
    assert np.linalg.norm(found.translation) == pytest.approx(1)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-9)


def test_where_opencv_finds_no_essential_matrix_there_is_no_start_from_there(monkeypatch):
    flow, confidence = patch_flow(60)
    expected = camera_motion(flow, confidence, tisfm.Camera(focal=200.0))

    def fails(*arguments):
        raise cv2.error("mergePoints")

    monkeypatch.setattr(cv2, "findEssentialMat", fails)
    found = camera_motion(flow, confidence, tisfm.Camera(focal=200.0))
    assert found.residual <= 1.1 * expected.residual  # by the start along the axes


def test_fewer_than_eight_confident_pixels_are_too_few():
    with pytest.raises(TooFewPixelsError, match=r"only 1 of 4800 sampled pixels.*at least 8"):
        camera_motion(*patch_flow(2), tisfm.Camera(focal=200.0))
    assert issubclass(TooFewPixelsError, ValueError)


def test_other_errors_are_not_reported_as_too_few_pixels(monkeypatch):
    def fails(*arguments, **options):
        raise ValueError("a bug")

    frame0, frame1 = thin_pair(31)
    for motion, module in (("camera", "first_motion"), ("objects", "objects.candidates")):
        with monkeypatch.context() as patch:
            patch.setattr(f"tisfm.motion.{module}.camera_motion", fails)
            with pytest.raises(ValueError, match="a bug"):
                tisfm.interpret(
                    frame0,
                    frame1,
                    camera=tisfm.Camera(focal=200.0),
                    settings=tisfm.Settings.preset("fast", motion=motion),
                )
