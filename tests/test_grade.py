"""Grades say how far depth is expected to be off."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tisfm.grade import GRADES, GradeSummary, depth_error, grade_depth
from tisfm.scenes import static_scene
from tisfm.status import Status

SHAPE = (20, 30)


def errors_of(share_of_deviation, deviation):
    """Return the error and the share of a map whose first rows have a relative deviation."""
    inverse_depth = np.full(SHAPE, 0.5, np.float32)
    relative = np.full(SHAPE, np.inf, np.float32)
    relative[: round(share_of_deviation * SHAPE[0])] = deviation
    inverse_depth[np.isinf(relative)] = np.nan
    return depth_error(inverse_depth, relative * inverse_depth)


def test_error_is_the_median_error_of_a_normal_distribution():
    random = np.random.default_rng(0)
    truth = random.uniform(0.2, 2.0, (150, 200))
    relative = random.uniform(0.01, 0.05, truth.shape)
    found = truth * (1 + relative * random.normal(size=truth.shape))
    expected, share = depth_error(found, relative * found)
    assert expected == pytest.approx(np.median(np.abs(found - truth) / truth), rel=0.2)
    assert share == 1


@pytest.mark.parametrize(
    ("share", "deviation", "error"), [(1, 0.1, 0.06745), (0.6, 0.1, 0.06745), (0.4, 0.1, 1)]
)
def test_a_pixel_without_depth_has_an_infinite_deviation(share, deviation, error):
    found, good = errors_of(share, deviation)
    assert found == pytest.approx(error) and good == pytest.approx(share)


def test_filled_pixels_do_not_count():
    inverse_depth = np.full(SHAPE, 0.5)
    deviation = np.full(SHAPE, np.inf)
    deviation[:4] = 0.01
    assert depth_error(inverse_depth, deviation) == pytest.approx((0.02 * 0.6745, 1))
    assert depth_error(inverse_depth, np.full(SHAPE, np.inf)) == (1, 0)


def test_no_depth_has_no_error():
    error, share = depth_error(np.full(SHAPE, np.nan), np.full(SHAPE, np.inf))
    assert np.isnan(error) and share == 0


def test_a_path_that_fits_badly_multiplies_the_deviations():
    inverse_depth = np.full(SHAPE, 0.5)
    error, share = depth_error(inverse_depth, 0.06 * inverse_depth, residual_factor=2.0)
    assert error == pytest.approx(0.12 * GRADES.median_ratio) and share == 1
    error, share = depth_error(inverse_depth, 0.06 * inverse_depth, residual_factor=3.0)
    assert error == pytest.approx(0.18 * GRADES.median_ratio) and share == 0


def test_an_uncertain_focal_length_adds_an_error():
    inverse_depth = np.full(SHAPE, 0.5)
    sure = depth_error(inverse_depth, 0 * inverse_depth, 0.04)
    assert sure == pytest.approx((0.04 * GRADES.focal_effect, 1))
    guessed, share = depth_error(inverse_depth, 0 * inverse_depth, np.inf)
    assert guessed > GRADES.max_fair and share == 0
    assert np.isnan(depth_error(np.nan * inverse_depth, inverse_depth, np.inf)[0])


@pytest.mark.parametrize(
    ("status", "error", "word"),
    [
        ("converged", 0.01, "good"),
        ("converged", 0.03, "good"),
        ("converged", 0.031, "fair"),
        ("iteration_limit", 0.1, "fair"),
        ("converged", 0.11, "poor"),
        ("converged", np.nan, "no depth"),
        ("uncertain", 0.01, "poor"),
        ("status_of_another_version", 0.01, "poor"),
        ("little_parallax", np.nan, "no depth"),
        ("contradicted", 0.01, "contradicted"),
        ("behind_camera", 0.01, "contradicted"),
        ("contradicted", np.nan, "contradicted"),
        ("pose_mismatch", np.nan, "contradicted"),
        ("diverged", 1.0, "contradicted"),
        ("diverged", np.nan, "no depth"),
        ("unrelated", np.nan, "no depth"),
    ],
)
def test_words(status, error, word):
    grade = grade_depth(Status(status), error)
    assert grade == word and str(grade) == word
    assert grade.is_green == (word in ("good", "fair"))


def test_order_of_grades():
    words = [str(grade) for grade in sorted(tisfm.Grade, key=lambda grade: grade.rank)]
    assert words == ["good", "fair", "poor", "no depth", "no pose", "contradicted"]


def test_summary_of_grades():
    grades = [tisfm.Grade.FAIR, tisfm.Grade.GOOD, tisfm.Grade.FAIR, tisfm.Grade.NO_POSE]
    summary = GradeSummary.of(grades, [0.05, 0.02, 0.07, np.nan])
    assert (summary.median, summary.worst) == ("fair", "no pose")
    assert summary.text == (
        "fair, worst no pose; depth is expected to be off by 5 % (median), 7 % (worst)"
    )
    assert summary.counts_text == "1 good, 2 fair, 1 no pose"
    assert GradeSummary.of(grades[3:]).text == "no pose"
    two = GradeSummary.of([tisfm.Grade.GOOD, tisfm.Grade.FAIR], [0.02, 0.05])
    assert (two.median, two.median_error) == ("fair", 0.05)  # the later one of two in the middle


def test_a_pair_is_graded_by_what_its_focal_length_does(tmp_path):
    scene = static_scene("sideways", 72, 96)
    settings = tisfm.Settings.preset("fast", motion="camera")
    known = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    assert known.focal_deviation == 0 and known.grade.is_green
    assert known.focal_effect < 0.2 and known.focal_spread > 0.1  # depth hardly depends on it
    guessed = replace(known, focal_deviation=np.inf)
    assert guessed.depth_error > known.depth_error and guessed.grade.is_green
    unknown = replace(guessed, focal_effect=np.nan, focal_spread=np.nan)
    assert unknown.grade == "poor" and unknown.depth_error > 0.12
    dependent = replace(guessed, focal_effect=1.0)
    assert dependent.grade == "poor" and dependent.depth_error > 0.1
    for result in (guessed, unknown, dependent):
        result.save(tmp_path / "pair.npz")
        again = tisfm.Interpretation.load(tmp_path / "pair.npz")
        for name in ("focal_deviation", "focal_effect", "focal_spread"):
            np.testing.assert_equal(getattr(again, name), getattr(result, name))
        assert again.grade == result.grade
    frames = [scene.frame0, scene.frame1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (result,) = tisfm.interpret_sequence(frames, settings=settings)
        field = tisfm.interpret(*frames)
    assert result.focal_deviation == np.inf
    assert field.focal_deviation == 0 and field.grade == "poor" and np.isnan(field.depth_error)
