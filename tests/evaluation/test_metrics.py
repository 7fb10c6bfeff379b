"""Errors of flow and depth: cases worked by hand, and what must hold for any input."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tisfm.metrics import (
    angular_error,
    depth_error_map,
    depth_errors,
    endpoint_error,
    endpoint_error_map,
    flow_errors,
    occlusion_scores,
    outlier_rate,
    pose_errors,
    std_coverage,
)
from tisfm.rigid import pose_matrix


def flow_of(*vectors):
    """One row of flow vectors, (1, n, 2)."""
    return np.array([vectors], dtype=np.float64)


flows = arrays(np.float64, (3, 4, 2), elements=st.floats(-50, 50))
depths = arrays(np.float64, (3, 5), elements=st.floats(0.1, 100))

FLOW_METRICS = [endpoint_error, angular_error, outlier_rate]


# --- flow -----------------------------------------------------------------------------------


def test_endpoint_error_by_hand():
    truth, flow = flow_of((0, 0), (1, 1)), flow_of((3, 4), (1, 2))
    np.testing.assert_array_equal(endpoint_error_map(flow, truth), [[5, 1]])
    assert endpoint_error(flow, truth) == 3
    assert endpoint_error(flow, truth, mask=[[0, 1]]) == 1


def test_angular_error_by_hand():
    # (1, 0, 1) and (0, 0, 1) are 45° apart; (1, 0, 1) and (-1, 0, 1), 90°.
    assert angular_error(flow_of((1, 0)), flow_of((0, 0))) == pytest.approx(45, rel=1e-14)
    flow, truth = flow_of((1, 0), (1, 0)), flow_of((0, 0), (-1, 0))
    assert angular_error(flow, truth) == pytest.approx((45 + 90) / 2)
    # (1, 2, 1) · (3, -1, 1) = 2
    expected = math.degrees(math.acos(2 / math.sqrt(6 * 11)))
    assert angular_error(flow_of((1, 2)), flow_of((3, -1))) == pytest.approx(expected)
    # Obtuse angles need the sign of the dot product.
    assert angular_error(flow_of((9, 0)), flow_of((-9, 0))) == pytest.approx(
        2 * math.degrees(math.atan(9))
    )


def test_angular_error_keeps_small_angles():
    assert angular_error(flow_of((1e-9, 0)), flow_of((0, 0))) == pytest.approx(
        math.degrees(1e-9), rel=1e-9
    )


def test_outliers_need_both_conditions():
    truth = flow_of((100, 0), (100, 0), (10, 0), (10, 0), (0, 0))
    flow = flow_of((104.9, 0), (105, 0), (12.9, 0), (13, 0), (0, 3))
    assert outlier_rate(flow, truth) == 3 / 5
    assert outlier_rate(flow, truth, mask=[[1, 1, 1, 0, 0]]) == 1 / 3
    assert outlier_rate(flow, truth, pixels=2.0) == 4 / 5
    assert outlier_rate(flow, truth, fraction=0.04) == 4 / 5


def test_depth_errors_of_all_pixels_by_hand():
    """Half of it right, one beyond ten times the farthest, one nearer than 0.1, one without."""
    truth = np.array([[1.0, 2, 4, 1, 2, 4, np.nan]])
    depth = np.array([[1.0, 2, 4, 1000, 0.001, -1, 5]])
    errors = depth_errors(depth, truth)
    assert errors.scale == 1 and errors.density == 5 / 6
    assert errors.abs_rel_all == pytest.approx((39 / 1 + 1.9 / 2 + 36 / 4) / 6)
    assert depth_errors(3 * depth, truth).abs_rel_all == pytest.approx(errors.abs_rel_all)
    assert depth_errors(truth, truth).abs_rel_all == 0


def test_all_errors_of_a_flow():
    rng = np.random.default_rng(0)
    truth = rng.normal(scale=20, size=(9, 11, 2))
    flow = truth + rng.normal(scale=2, size=truth.shape)
    truth[2, 3] = 1e10
    truth[4, 5, 1] = np.nan
    for mask in (None, rng.random((9, 11)) < 0.5):
        errors = flow_errors(flow, truth, mask=mask)
        assert errors.endpoint == pytest.approx(endpoint_error(flow, truth, mask=mask))
        assert errors.angular == pytest.approx(angular_error(flow, truth, mask=mask))
        assert errors.outliers == outlier_rate(flow, truth, mask=mask)
        error = endpoint_error_map(flow, truth, mask=mask)
        known = error[np.isfinite(error)]
        assert errors.pixels == known.size
        assert errors.over_one == (known >= 1).mean()
        assert 0 < errors.outliers < errors.over_one < 1


@given(truth=flows)
def test_the_truth_has_no_error(truth):
    assert endpoint_error(truth, truth) == 0
    assert angular_error(truth, truth) == 0
    assert outlier_rate(truth, truth) == 0


@given(truth=flows)
def test_the_wrong_sign_doubles_the_flow(truth):
    length = np.linalg.norm(truth, axis=-1)
    assert endpoint_error(-truth, truth) == pytest.approx(2 * length.mean())
    expected = 2 * np.degrees(np.arctan(length)).mean()
    assert angular_error(-truth, truth) == pytest.approx(expected)
    assert outlier_rate(-truth, truth) == (2 * length >= 3).mean()


@given(flow=flows, truth=flows, turn=st.floats(0, 7))
def test_flow_errors_do_not_depend_on_the_axes(flow, truth, turn):
    c, s = math.cos(turn), math.sin(turn)
    R = np.array([[c, s], [-s, c]])
    for metric in (endpoint_error, angular_error):
        assert metric(flow @ R, truth @ R) == pytest.approx(metric(flow, truth), abs=1e-9)
        assert metric(flow, truth) == pytest.approx(metric(truth, flow), abs=1e-12)


@pytest.mark.parametrize("unknown", [1e10, -2e9, np.nan, np.inf])
@pytest.mark.parametrize("metric", FLOW_METRICS)
def test_unknown_truth_is_ignored(metric, unknown):
    truth, flow = flow_of((0, 0), (unknown, 0), (0, unknown)), flow_of((4, 0), (1, 1), (7, 8))
    assert metric(flow, truth) == metric(flow[:, :1], truth[:, :1])
    assert np.isnan(endpoint_error_map(flow, truth)).tolist() == [[False, True, True]]


def test_sums_are_float64():
    truth = np.zeros((500, 500, 2), np.float32)
    flow = np.full((500, 500, 2), 0.1, np.float32)
    assert endpoint_error(flow, truth) == pytest.approx(math.sqrt(2) * np.float32(0.1), rel=1e-12)


def test_flow_that_is_not_finite():
    truth, flow = flow_of((0, 0), (0, 0)), flow_of((1, 0), (np.nan, 0))
    for metric in (endpoint_error, angular_error):
        with pytest.raises(ValueError, match="not finite at 1 of the 2 pixels"):
            metric(flow, truth)
        assert metric(flow, truth, mask=[[1, 0]]) > 0
    assert outlier_rate(flow, truth) == 1 / 2
    np.testing.assert_array_equal(endpoint_error_map(flow, truth), [[1, np.nan]])
    assert outlier_rate(flow_of((np.inf, 0)), truth[:, :1]) == 1


@pytest.mark.parametrize("metric", [*FLOW_METRICS, endpoint_error_map, flow_errors])
def test_flow_errors_name_wrong_arguments(metric):
    with pytest.raises(ValueError, match=r"flow is \(2, 3, 2\) and truth is \(2, 4, 2\)"):
        metric(np.zeros((2, 3, 2)), np.zeros((2, 4, 2)))
    with pytest.raises(ValueError, match=r"expected the same shape, \(H, W, 2\)"):
        metric(np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"mask is \(3, 2\): .* \(2, 3\)"):
        metric(np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), mask=np.ones((3, 2)))
    with pytest.raises(ValueError, match="no pixel"):
        metric(np.zeros((2, 3, 2)), np.full((2, 3, 2), 1e10))
    with pytest.raises(ValueError, match="no pixel"):
        metric(np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), mask=np.zeros((2, 3)))


# --- depth ----------------------------------------------------------------------------------


def test_depth_errors_by_hand():
    truth, depth = [[1.0, 2.0, 4.0, 10.0]], [[1.0, 3.0, 4.0, 5.0]]
    errors = depth_errors(depth, truth, align=None)
    assert errors.abs_rel == pytest.approx((0 + 0.5 + 0 + 0.5) / 4)
    assert errors.rmse == pytest.approx(math.sqrt((1 + 25) / 4))
    logs = np.array([0, math.log(1.5), 0, math.log(0.5)])
    assert errors.rmse_log == pytest.approx(math.sqrt((logs**2).mean()))
    assert errors.silog == pytest.approx(100 * logs.std())
    # Ratios 1, 1.5, 1 and 2 against 1.25, 1.5625 and 1.953.
    assert (errors.delta1, errors.delta2, errors.delta3) == (0.5, 0.75, 0.75)
    assert (errors.scale, errors.density) == (1, 1)


def test_median_alignment_by_hand():
    # Ratios of truth to estimate: 2, 2, 3.
    errors = depth_errors([[1.0, 2.0, 1.0]], [[2.0, 4.0, 3.0]])
    assert errors.scale == 2
    assert errors.abs_rel == pytest.approx(1 / 9)
    assert errors.rmse == pytest.approx(1 / math.sqrt(3))


def test_invalid_estimates_lower_the_density_only():
    truth = [[1.0, 2.0, 3.0, 4.0, 5.0, np.nan, -1.0, 2e9]]
    depth = [[1.0, np.nan, 0.0, -4.0, np.inf, 6.0, 7.0, 8.0]]
    errors = depth_errors(depth, truth, align=None)
    assert errors.density == pytest.approx(1 / 5)
    assert errors.abs_rel == errors.rmse == errors.silog == 0
    masked = depth_errors(depth, truth, mask=[[1, 1, 0, 0, 0, 0, 0, 0]], align=None)
    assert masked.density == pytest.approx(1 / 2)


@given(truth=depths)
def test_true_depth_has_no_error(truth):
    errors = depth_errors(truth, truth)
    assert errors.abs_rel == errors.rmse == errors.rmse_log == errors.silog == 0
    assert errors.delta1 == errors.delta2 == errors.delta3 == errors.scale == errors.density == 1


@given(depth=depths, truth=depths, factor=st.floats(1e-3, 1e3))
def test_median_alignment_forgets_the_scale(depth, truth, factor):
    usual, scaled = depth_errors(depth, truth), depth_errors(factor * depth, truth)
    for name in ("abs_rel", "rmse", "rmse_log", "silog"):
        assert getattr(scaled, name) == pytest.approx(getattr(usual, name), rel=1e-6, abs=1e-9)
    assert scaled.scale * factor == pytest.approx(usual.scale)
    absolute = depth_errors(factor * depth, truth, align=None)
    assert absolute.silog == pytest.approx(usual.silog, rel=1e-6, abs=1e-9)


@given(depth=depths, truth=depths)
def test_depth_errors_are_in_their_ranges(depth, truth):
    errors = depth_errors(depth, truth, align=None)
    assert 0 <= errors.delta1 <= errors.delta2 <= errors.delta3 <= 1
    assert errors.silog <= 100 * errors.rmse_log * (1 + 1e-12)


def test_depth_errors_name_wrong_arguments():
    with pytest.raises(ValueError, match=r"depth is \(2, 3\) and truth is \(3, 2\)"):
        depth_errors(np.ones((2, 3)), np.ones((3, 2)))
    with pytest.raises(ValueError, match=r"depth is \(3,\)"):
        depth_errors(np.ones(3), np.ones(3))
    with pytest.raises(ValueError, match=r"mask is \(3, 2\): .* \(2, 3\)"):
        depth_errors(np.ones((2, 3)), np.ones((2, 3)), mask=np.ones((3, 2)))
    with pytest.raises(ValueError, match="align is 'mean': expected 'median' or None"):
        depth_errors(np.ones((2, 3)), np.ones((2, 3)), align="mean")
    with pytest.raises(ValueError, match=r"\(2, 3\) truth is known"):
        depth_errors(np.ones((2, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"\(2, 3\) depth is finite and positive .* 6 pixels"):
        depth_errors(np.zeros((2, 3)), np.ones((2, 3)))


def test_depth_error_map_by_hand():
    depth, truth = [[1.0, 2.0, 1.0, np.nan, 4.0, 1.0]], [[2.0, 4.0, 3.0, 1.0, np.nan, 0.0]]
    error = depth_error_map(depth, truth)
    np.testing.assert_allclose(error, [[0, 0, 1 / 3, np.nan, np.nan, np.nan]])
    assert np.nanmean(error) == pytest.approx(depth_errors(depth, truth).abs_rel)
    unaligned = depth_error_map(depth, truth, mask=[[0, 1, 1, 1, 1, 1]], align=None)
    np.testing.assert_allclose(unaligned, [[np.nan, 0.5, 2 / 3, np.nan, np.nan, np.nan]])
    with pytest.raises(ValueError, match=r"depth is \(2, 3\) and truth is \(3, 2\)"):
        depth_error_map(np.ones((2, 3)), np.ones((3, 2)))


# Pose


twists = arrays(np.float64, (6,), elements=st.floats(-1, 1)).filter(
    lambda twist: np.linalg.norm(twist[:3]) > 1e-3
)


def test_pose_errors_by_hand():
    still = pose_matrix([1, 0, 0, 0, 0, 0])
    for motion, direction, rotation in (
        ([2, 0, 0, 0, 0, 0], 0, 0),  # the length does not count
        ([-1, 0, 0, 0, 0, 0], 180, 0),  # the sign does
        ([0, 3, 0, 0, 0, 0], 90, 0),
        ([1, 0, 1, 0, 0, 0], 45, 0),
        ([1, 0, 0, math.radians(30), 0, 0], 0, 30),
    ):
        errors = pose_errors(pose_matrix(motion), still)
        assert errors.direction == pytest.approx(direction, abs=1e-12)
        assert errors.rotation == pytest.approx(rotation, abs=1e-12)
    half = np.diag([1.0, -1.0, -1.0, 1.0])  # half a turn
    assert pose_errors(half, np.eye(4)).rotation == pytest.approx(180)


def test_pose_errors_keep_small_angles():
    errors = pose_errors(pose_matrix([1, 1e-9, 0, 0, 0, 2e-9]), pose_matrix([1, 0, 0, 0, 0, 0]))
    assert errors.rotation == pytest.approx(math.degrees(2e-9), rel=1e-6)
    assert errors.direction == pytest.approx(math.degrees(2e-9), rel=1e-6)  # half of ω adds to t


def test_without_translation_there_is_no_direction():
    turn = pose_matrix([0, 0, 0, 0.1, 0, 0])
    for pose, truth in ((turn, pose_matrix([1, 0, 0, 0, 0, 0])), (np.eye(4), turn), (turn, turn)):
        errors = pose_errors(pose, truth)
        assert errors.direction is None
        assert errors.rotation == pytest.approx(0 if pose is truth else math.degrees(0.1))


@given(twist=twists, other=twists, turn=twists)
def test_pose_errors_do_not_depend_on_the_axes_of_the_world(twist, other, turn):
    pose, truth, world = pose_matrix(twist), pose_matrix(other), pose_matrix(turn)
    errors = pose_errors(pose, truth)
    assert 0 <= errors.direction <= 180 and 0 <= errors.rotation <= 180
    swapped = pose_errors(truth, pose)
    assert swapped.direction == errors.direction
    assert swapped.rotation == pytest.approx(errors.rotation, abs=1e-6)
    world[:3, 3] = 0  # other axes of the second camera
    turned = pose_errors(world @ pose, world @ truth)
    assert turned.direction == pytest.approx(errors.direction, abs=1e-5)
    assert turned.rotation == pytest.approx(errors.rotation, abs=1e-5)


@given(twist=twists)
def test_the_true_pose_has_no_error(twist):
    errors = pose_errors(pose_matrix(twist), pose_matrix(twist))
    assert errors.direction == 0 and errors.rotation == pytest.approx(0, abs=1e-12)


def test_pose_errors_name_wrong_arguments():
    with pytest.raises(ValueError, match=r"pose is \(3, 4\) .* finite \(4, 4\) matrix"):
        pose_errors(np.eye(4)[:3], np.eye(4))
    with pytest.raises(ValueError, match=r"truth is \(4, 4\) .*nan.* finite \(4, 4\)"):
        pose_errors(np.eye(4), np.full((4, 4), np.nan))
    for wrong in (2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.zeros((4, 4))):
        with pytest.raises(ValueError, match=r"pose is .* expected a rotation"):
            pose_errors(wrong, np.eye(4))


# Occlusion


def test_occlusion_scores_by_hand():
    found = np.array([[1, 1, 1, 0, 0]])
    truth = np.array([[1, 1, 0, 1, 1]])
    scores = occlusion_scores(found, truth)
    assert (scores.precision, scores.recall) == (2 / 3, 1 / 2)
    assert scores.f1 == pytest.approx(2 * (2 / 3) * (1 / 2) / (2 / 3 + 1 / 2))
    assert scores.pixels == 5
    masked = occlusion_scores(found, truth, mask=[[1, 0, 1, 1, 0]])
    assert (masked.precision, masked.recall, masked.pixels) == (1 / 2, 1 / 2, 3)


def test_occlusion_scores_of_empty_maps_are_numbers():
    nothing, everything = np.zeros((3, 4), bool), np.ones((3, 4), bool)
    for found, truth in ((nothing, everything), (everything, nothing), (nothing, nothing)):
        scores = occlusion_scores(found, truth)
        assert (scores.precision, scores.recall, scores.f1) == (0, 0, 0)
    assert occlusion_scores(everything, everything).f1 == 1


def test_occlusion_scores_name_wrong_arguments():
    with pytest.raises(ValueError, match=r"occlusion is \(3, 4\) and truth is \(3, 5\)"):
        occlusion_scores(np.zeros((3, 4)), np.zeros((3, 5)))
    with pytest.raises(ValueError, match="no pixel counts"):
        occlusion_scores(np.zeros((3, 4)), np.zeros((3, 4)), mask=np.zeros((3, 4)))


# Standard deviations


def test_std_coverage_by_hand():
    truth = np.array([[1.0, 2.0, 4.0, 8.0, 0.0, np.nan]])
    # In another unit: 1/truth is 0.2 of it. The third is off by 0.1, the fourth by 0.2.
    found = 5 * np.array([[1.0, 0.5, 0.35, 0.325, 9.0, 9.0]])
    deviation = np.array([[0.1, 0.1, 0.6, 0.4, 0.0, 0.0]])
    scaled = np.median(found[0, :4] * truth[0, :4])
    expected = np.abs(found - scaled / np.array([[1, 2, 4, 8, 1, 1]]))[0, :4] <= deviation[0, :4]
    assert std_coverage(found, deviation, truth) == expected.mean()
    assert std_coverage(found, np.full_like(found, np.inf), truth) == 1
    assert std_coverage(found, np.full_like(found, np.nan), truth) == 0
    assert std_coverage(found, deviation, truth, mask=[[1, 1, 0, 0, 1, 1]]) == 1


def test_std_coverage_of_gaussian_errors():
    rng = np.random.default_rng(0)
    truth = rng.uniform(2, 9, (200, 250))
    deviation = rng.uniform(0.001, 0.01, truth.shape)
    found = 3 * (1 / truth + rng.normal(scale=deviation))
    assert std_coverage(found, 3 * deviation, truth) == pytest.approx(0.683, abs=0.01)
    assert std_coverage(found, 6 * deviation, truth) == pytest.approx(0.954, abs=0.01)


def test_std_coverage_names_wrong_arguments():
    good = np.ones((2, 3))
    with pytest.raises(ValueError, match=r"inverse_depth is \(2, 3\) and truth is \(2, 4\)"):
        std_coverage(good, good, np.ones((2, 4)))
    with pytest.raises(ValueError, match=r"mask is \(3, 2\)"):
        std_coverage(good, good, good, mask=np.ones((3, 2)))
    for found, mask in ((-good, None), (good, 0 * good)):
        with pytest.raises(ValueError, match="no pixel of the"):
            std_coverage(found, good, good, mask=mask)
