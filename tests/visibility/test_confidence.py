"""Confidence, and motion carried into parts without texture (the paper's remark (a))."""

import numpy as np
import pytest

import tisfm
from bench.untextured import bare_pixels
from tests.draws import nightly_except
from tests.noise import moving_noise
from tests.rendered import bare_patches, two_blocks


def test_confidence_ranks_errors():
    """The more confident half of the pixels has less than half of the mean error."""
    pair = two_blocks(240, 320, seed=0)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera)
    error = np.linalg.norm(result.flow - pair.flow, axis=-1)
    assert result.confidence.min() >= 0
    assert result.confidence.max() <= 1
    trusted = result.confidence >= np.median(result.confidence)
    assert error[trusted].mean() < 0.5 * error.mean()


def test_confidence_follows_texture_and_ends_at_the_border():
    frame0, frame1 = moving_noise(96, 128, (6, 0))
    frame0[:, :50] = frame1[:, :50] = 128
    confidence = tisfm.interpret(frame0, frame1).confidence
    assert np.median(confidence[10:-10, 70:110]) > 0.5
    assert confidence[10:-10, 10:30].max() < 0.01
    assert not confidence[:, -5:].any()  # leaves the image


@pytest.mark.parametrize("level", [0, 37, 128])
def test_confidence_in_textured_parts_does_not_depend_on_how_much_is_uniform(level):
    pair = two_blocks(120, 160, seed=0)
    medians = []
    for width in (0, 96, 128):  # none, 60 % and 80 %
        frames = pair.frame0.copy(), pair.frame1.copy()
        for frame in frames:
            frame[:, :width] = level
        confidence = tisfm.interpret(*frames, camera=pair.camera).confidence
        medians.append(np.median(confidence[:, 136:]))
        if width:
            assert np.median(confidence[:, : width - 16]) < 0.05
    assert min(medians) > 0.7 * medians[0] > 0.3


def test_confidence_is_the_share_of_the_data(make_problem):
    """½ tr[J M (I + J M)⁻¹], by dense inverses, on a constant patch."""
    from tisfm.visibility.confidence import confidence

    j = np.array([[50.0, 20.0], [20.0, 30.0]])
    m = np.array([[0.02, 0.005], [0.005, 0.01]])
    precision = np.zeros((7, 40, 40), np.float32)
    for k, value in enumerate((j[0, 0], j[0, 1], j[1, 1], 0.0, m[0, 0], m[0, 1], m[1, 1])):
        precision[k] = value
    window = 15 * 15 * j @ m
    expected = 0.5 * np.trace(window @ np.linalg.inv(np.eye(2) + window))
    result = confidence(precision, np.zeros((40, 40), bool), normalized=True)
    np.testing.assert_allclose(result, expected, rtol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 9, 100])
def test_median(count):
    from tisfm.visibility.confidence import median

    values = np.random.default_rng(count).normal(size=count).astype(np.float32)
    assert median(values) == pytest.approx(np.median(values), rel=1e-6)


@pytest.fixture(scope="module", params=nightly_except(0, of=[0, 1, 2]))
def bare(request):
    """A scene with bare parts, and what is more than 8 px inside them."""
    pair = bare_patches(seed=request.param)
    return pair, bare_pixels(pair)


@pytest.mark.parametrize("preset", ["balanced", "accurate"])
def test_motion_extends_into_untextured_parts_but_not_across_their_boundary(bare, preset):
    pair, inside = bare
    result = tisfm.interpret(
        pair.frame0, pair.frame1, camera=pair.camera, settings=tisfm.Settings.preset(preset)
    )
    error = np.linalg.norm(result.flow - pair.flow, axis=-1)
    on_block = inside & (pair.labels == 1)
    # The bare wall beside it moves 1.9 px less: at most 4% of that gets in.
    assert error[on_block].mean() < 0.04 * 1.9
    in_wall = inside & (pair.labels == 0)
    left = np.arange(pair.labels.shape[1]) < pair.labels.shape[1] // 2
    assert error[in_wall & left].mean() < 0.3
    # Behind the block, its own edge is all that is seen on one side.
    assert error[in_wall & ~left].mean() < 0.7


def test_confidence_is_low_without_texture(bare):
    pair, inside = bare
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera)
    seen = pair.textured & pair.visible
    bare_most = np.quantile(result.confidence[inside], 0.99)
    assert bare_most < 0.3
    assert bare_most < np.quantile(result.confidence[seen], 0.05)


def test_coarser_levels_extend_motion_farther_into_untextured_parts(bare):
    pair, inside = bare
    mean = {}
    for warps in (1, 8):
        settings = tisfm.Settings(coarse_warps=warps)
        result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
        mean[warps] = np.linalg.norm(result.flow - pair.flow, axis=-1)[inside].mean()
    assert mean[8] < 0.9 * mean[1]
