"""Grades of a reconstruction: of frames with good and with rough depth, kept in the record."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tisfm
from tests.exports.made import made
from tisfm.cli.batch import _median_grade
from tisfm.formats import FormatError
from tisfm.grade import GRADES, Grade, depth_error, summarise_grades
from tisfm.reconstruction.result.calibration import GIVEN, Calibration
from tisfm.reconstruction.result.folder import RECORD, read_depth, write_depth, write_mask
from tisfm.reconstruction.result.statuses import add_piece_note, mark_uncertain
from tisfm.reconstruction.stages.writing import _find_depth_errors
from tisfm.report.reconstruction_report import _report
from tisfm.results.sequence_frames import SequenceFrames
from tisfm.status import Status
from tisfm.view.static_page import _caption


def test_grades_of_frames(tmp_path):
    result = made(tmp_path / "made", count=5, piece=[0, 0, 0, -1, 0], with_depth=[0, 1, 4])
    status = list(result.status)
    status[3], status[4] = Status("no_texture"), Status("contradicted", "turn around")
    errors = np.array([0.01, 0.2, np.nan, np.nan, 0.01])
    graded = replace(result, status=tuple(status), depth_error=errors)
    words = ["good", "poor", "no depth", "no pose", "contradicted"]
    assert [str(grade) for grade in graded.grades] == words
    assert graded.grade(1) == "poor" and not graded.grade(1).is_green
    # The depth of frame 2 was not requested.
    assert (graded.median_grade, graded.worst_grade) == ("no pose", "contradicted")
    summary = graded.summary()
    assert "4 of 5 frames have a pose, in 1 piece." in summary
    assert "worst contradicted" in summary and "turn around" in summary
    assert "(median), 20 % (worst)" in summary
    with pytest.raises(IndexError):
        graded.grade(5)
    graded.save(tmp_path / "saved")
    again = tisfm.Reconstruction.load(tmp_path / "saved")
    np.testing.assert_array_equal(again.depth_error, errors)
    np.testing.assert_array_equal(again.depth_share, graded.depth_share)
    assert json.loads((tmp_path / "saved" / RECORD).read_text())["grade"] == words
    assert again.rescaled(0, 1, 3.0).grades == again.grades


@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_expected_errors_grow_with_the_residual_of_the_path(tmp_path, ratio):
    result = made(tmp_path, count=3, piece=[0, 0, -1], with_depth=[0, 1])
    for frame in (0, 1):
        write_depth(tmp_path, frame, np.full(result.shape, 0.5), np.full(result.shape, 0.01))
    depth = SimpleNamespace(
        error=np.array([0.02, 0.02, np.nan]) * GRADES.median_ratio,
        share=np.array([1.0, 1.0, 0.0]),
        piece=result.piece,
    )
    errors, shares = _find_depth_errors(
        SimpleNamespace(folder=tmp_path),
        SimpleNamespace(frames=SimpleNamespace(shape=result.shape)),
        GIVEN,
        depth,
        (SimpleNamespace(residual_factor=ratio),),
        (),
    )
    np.testing.assert_allclose(errors, depth.error * ratio, rtol=1e-3)
    np.testing.assert_array_equal(shares, depth.share)


def test_large_deviations_stay_finite_in_files(tmp_path):
    """An infinite deviation means filled depth, which does not count."""
    inverse_depth = np.full((20, 30), 0.5, np.float32)
    deviation = np.full((20, 30), 0.6, np.float32)
    deviation[:8], deviation[19] = 0.001, np.inf
    (tmp_path / "depth").mkdir(exist_ok=True)
    write_depth(tmp_path, 0, inverse_depth, deviation)
    stored = read_depth(tmp_path, 0, (20, 30))
    np.testing.assert_array_equal(np.isfinite(stored[1]), np.isfinite(deviation))
    assert depth_error(*stored)[1] == depth_error(inverse_depth, deviation)[1]
    assert depth_error(*stored)[0] > GRADES.max_fair


def test_saved_copy_keeps_the_mask_of_fixed_pixels(tmp_path):
    result = made(tmp_path / "made", count=2)
    result.save(tmp_path / "plain")
    assert tisfm.Reconstruction.load(tmp_path / "plain").mask is None
    mask = np.zeros(result.shape, bool)
    mask[-3:] = True
    write_mask(result.folder, mask)
    result.save(tmp_path / "copy")
    np.testing.assert_array_equal(tisfm.Reconstruction.load(tmp_path / "copy").mask, mask)


@pytest.mark.parametrize("values", [[0.1], [0.1, 2.0], [0.1, -1.0], [0.1, "x"]])
def test_damaged_errors_are_refused(tmp_path, values):
    made(tmp_path / "made", count=2)
    file = tmp_path / "made" / RECORD
    file.write_text(json.dumps(json.loads(file.read_text()) | {"depth_error": values}))
    with pytest.raises(FormatError, match="reconstruction"):
        tisfm.Reconstruction.load(tmp_path / "made")


def test_rough_depth_is_uncertain():
    right = Status("converged")
    statuses = [right, right, add_piece_note(right), Status("contradicted")]
    found = mark_uncertain(statuses, np.array([GRADES.max_fair, 0.49, 0.2, 0.3]))
    assert [str(status) for status in found] == [
        "converged", "uncertain", "uncertain", "contradicted",
    ]  # fmt: skip
    assert "49 %" in found[1].message and "new piece" in found[2].message


def test_deviation_of_the_focal_length():
    given, guessed = Calibration(origin="given", focal=100.0), Calibration(origin="guessed")
    assert given.relative_focal_std == 0 and guessed.relative_focal_std == np.inf
    estimated = Calibration(origin="estimated", focal=200.0, focal_std=3.0)
    assert estimated.relative_focal_std == pytest.approx(0.015)


def test_frames_without_requested_depth_count_if_no_frame_has_depth():
    posed, lost = Status("converged"), Status("no_texture")
    grades = [Grade.NO_DEPTH, Grade.NO_DEPTH, Grade.NO_POSE]
    unknown = [np.nan] * 3
    assert summarise_grades(grades, [posed, posed, lost], unknown).median == "no depth"
    grades[0] = Grade.GOOD
    assert summarise_grades(grades, [posed, posed, lost], [0.01, np.nan, np.nan]).counts == {
        Grade.GOOD: 1,
        Grade.NO_POSE: 1,
    }


def test_report_page_batch_and_command_state_one_grade(tmp_path):
    """Depth was requested of frame 0 alone."""
    result = made(tmp_path / "made", count=3, with_depth=[0])
    result = replace(result, depth_error=np.array([0.05, np.nan, np.nan]))
    result.save(tmp_path / "saved")
    result = tisfm.Reconstruction.load(tmp_path / "saved")
    text = result.grade_summary.text
    assert text.startswith("fair; depth")
    assert _caption(SequenceFrames(result), 3, []).endswith(f"Grade {text}")
    report = _report(result, result.folder, None)
    assert ("Grade", text) in report.summary
    assert [row[:2] for row in report.grades] == [("fair", 1)]
    assert _median_grade(result.folder) == "fair" and _median_grade(tmp_path / "none") is None


def test_deviations_of_poses_in_words(tmp_path):
    result = made(tmp_path / "one", count=4, piece=[0] * 4)
    side = 0.02 / np.sqrt(3)
    known = replace(
        result,
        position_deviation=np.full((4, 3), side),
        rotation_deviation=np.tile([0.0, 0.3, 0.4], (4, 1)),
    )
    text = "position ±{} in the unit of the poses, rotation ±0.5°"
    assert known.pose_deviation_text == text.format("0.02")
    assert "Median deviations: position ±0.02 in the unit of the poses" in known.summary()
    with_gap = known.position_deviation.copy()
    with_gap[3] = np.nan
    half = replace(known, position_deviation=with_gap)
    assert half.pose_deviation_text == known.pose_deviation_text
    unit = known.rescaled(0, 3, 5 * np.linalg.norm(known.poses[3, :3, 3] - known.poses[0, :3, 3]))
    np.testing.assert_allclose(unit.position_deviation, 5 * known.position_deviation)
    assert unit.pose_deviation_text == text.format("0.1")
    given = replace(known, position_deviation=np.zeros((4, 3)), rotation_deviation=np.zeros((4, 3)))
    unknown = replace(known, rotation_deviation=np.full((4, 3), np.nan))
    contradicted = replace(known, status=(Status("contradicted"),) * 4)
    for other in (given, unknown, contradicted):
        assert other.pose_deviation_text == "" and "Median deviations" not in other.summary()
