"""Errors of the depth of one frame, in a scale that a sequence shares."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rendered import static_scene
from tests.trajectory.paths import PATIENT
from tisfm.metrics import certain_error, depth_errors, flicker, limited_error
from tisfm.metrics.depth_sequence import LogMedian, depth_ratios, estimated_share
from tisfm.rigid import pose_matrix

RNG = np.random.default_rng(0)
TRUTH = RNG.uniform(1, 4, (11, 13))
HOLE = np.zeros(TRUTH.shape, bool)
HOLE[2:4, 3:9] = True
INVERSE = 1 / (TRUTH * np.exp(RNG.normal(0, 0.2, TRUTH.shape)))


def with_holes(inverse, truth):
    inverse, truth = inverse.copy(), truth.copy()
    inverse[HOLE], inverse[0, :3] = np.nan, (0, -1, np.inf)
    truth[5, :2] = (np.nan, 0)
    return inverse, truth


@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_it_is_the_error_of_pairs_in_a_given_scale(scale):
    inverse, truth = with_holes(scale * INVERSE, TRUTH)
    with np.errstate(divide="ignore"):
        pair = depth_errors(1 / inverse, truth)
    assert limited_error(inverse, truth, scale=pair.scale) == pytest.approx(pair.abs_rel_all)
    assert estimated_share(inverse, truth) == pytest.approx(pair.density)
    assert np.median(depth_ratios(inverse, truth)) == pytest.approx(pair.scale)
    assert limited_error(inverse, truth, scale=2 * pair.scale) > pair.abs_rel_all


def test_the_limits_are_those_of_the_true_depth():
    truth = np.array([[1.0, 2.0]])
    assert limited_error([[1e-9, 1e9]], truth) == pytest.approx((19 + 0.95) / 2)
    assert limited_error([[1.0, np.nan]], truth) == pytest.approx((0 + 9) / 2)
    assert limited_error([[np.nan, 0.0]], truth) == 1


def test_the_most_certain_are_those_of_the_least_relative_deviation():
    truth = np.full((1, 10), 2.0)
    inverse = 1 / (2 + 0.1 * np.arange(10)[None])
    deviation = inverse * (1 + np.arange(10)[None])
    assert certain_error(inverse, deviation, truth) == pytest.approx(0.05 * np.mean([0, 1, 2, 3]))
    assert certain_error(inverse, deviation[:, ::-1] * inverse, truth) > 0.3
    assert certain_error(inverse, deviation, truth, share=0.1) == pytest.approx(0, abs=1e-12)
    assert certain_error(2 * inverse, deviation, truth, scale=2) == pytest.approx(0.075)
    inverse[0, 0] = np.nan
    assert certain_error(inverse, deviation, truth) == pytest.approx(0.05 * np.mean([1, 2, 3, 4]))
    assert certain_error(1e-9 * inverse, deviation, truth) == 3
    with pytest.raises(ValueError, match="deviation is"):
        certain_error(inverse, deviation[:, 1:], truth)


@pytest.fixture
def pair():
    """A rendered pair whose camera moves forward."""
    return static_scene("forward+rotation", 60, 80)


def second_depth(pair):
    """The depth of frame 1: that of frame 0 moved, the nearest of each pixel."""
    motion = pose_matrix(pair.motions[0])
    height, width = pair.depth.shape
    focal, (cx, cy) = pair.camera.focal, pair.camera.center_for(height, width)
    fine = 8
    rows, columns = np.mgrid[: height * fine, : width * fine] / fine
    depth = np.kron(pair.depth, np.ones((fine, fine)))
    points = np.stack([(columns - cx) / focal, (rows - cy) / focal, np.ones_like(rows)]) * depth
    moved = motion[:3, :3] @ points.reshape(3, -1) + motion[:3, 3:]
    x, y = (np.rint(focal * moved[k] / moved[2] + c).astype(int) for k, c in ((0, cx), (1, cy)))
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    nearest = np.full((height, width), np.inf)
    np.minimum.at(nearest, (y[inside], x[inside]), moved[2, inside])
    return np.where(np.isfinite(nearest), nearest, np.nan), motion


def test_flicker_is_the_change_of_relative_inverse_depth(pair):
    later, motion = second_depth(pair)
    options = {"focal": pair.camera.focal, "center": pair.camera.center_for(60, 80)}
    first, second = (1 / pair.depth, pair.depth), (1 / later, later)
    # Right depth does not flicker, though the camera came nearer.
    assert np.nanmedian(later / pair.depth) < 0.99
    assert flicker(first, second, motion, **options) == pytest.approx(0, abs=1e-12)
    # What is 10 % too near in the second frame does, in whatever unit.
    nearer = (1.1 / later, later)
    assert flicker(first, nearer, motion, **options) == pytest.approx(0.1)
    halves = (0.5 / pair.depth, pair.depth), (0.55 / later, later)
    assert flicker(*halves, motion, scale=0.5, **options) == pytest.approx(0.1)
    # A map that is wrong everywhere and always does not: it is its change that counts.
    assert flicker((2 / pair.depth, pair.depth), (2 / later, later), motion, **options) < 1e-12


def test_nothing_in_common_has_no_flicker(pair):
    options = {"focal": pair.camera.focal, "center": pair.camera.center_for(60, 80)}
    frame = (1 / pair.depth, pair.depth)
    behind = np.diag([-1.0, 1, -1, 1])
    assert flicker(frame, frame, behind, **options) is None
    elsewhere = pose_matrix([0, 0, -0.2 * pair.depth.min(), 0, 0, 0])  # other surfaces there
    assert flicker(frame, (1 / pair.depth, 5 * pair.depth), elsewhere, **options) is None
    with pytest.raises(ValueError, match="expected the same size"):
        flicker(frame, (frame[0][1:], frame[1][1:]), behind, **options)


@PATIENT
@given(powers=st.lists(st.floats(-30, 30), min_size=1, max_size=40), parts=st.integers(1, 4))
def test_the_median_of_many(powers, parts):
    values = np.exp(powers)
    collected = LogMedian()
    for part in np.array_split(values, parts):
        collected.add(part)
    low, high = (
        np.quantile(np.log(values), 0.5, method="lower"),
        np.quantile(np.log(values), 0.5, method="higher"),
    )
    assert low - 1e-4 <= np.log(collected.median()) <= high + 1e-4
    if low == high:
        assert collected.median() == pytest.approx(np.median(values), rel=1e-4)


def test_the_median_of_none():
    assert LogMedian().median() is None


@pytest.mark.parametrize("error", [limited_error, depth_ratios, estimated_share])
def test_wrong_maps_are_refused(error):
    for inverse, truth, words in (
        (INVERSE[1:], TRUTH, "inverse_depth is .10, 13. and truth is .11, 13."),
        (INVERSE[0], TRUTH[0], r"expected the same shape, \(H, W\)"),
        (INVERSE, np.full_like(TRUTH, np.nan), "no pixel of the .11, 13. truth is known"),
        (np.ma.masked_array(INVERSE, HOLE), TRUTH, "masked"),
    ):
        with pytest.raises(ValueError, match=words):
            error(inverse, truth)
