"""The record of a run keeps statuses and expected errors of its pairs."""

import pytest

from tisfm.folders.run_record import RunRecord, read_record, summarise_pairs


def entry(number, status, grade, error):
    return {
        "number": number, "status": status, "message": "", "grade": grade, "depth_error": error,
        "frames": "", "times": None,
    }  # fmt: skip


@pytest.fixture
def record(tmp_path):
    record = RunRecord(tmp_path, {"version": "1"})
    record.finish("a", entry(0, "converged", "fair", 0.05), {})
    record.finish("b", entry(1, "uncertain", "poor", 0.2), {})
    record.finish("c", entry(2, "unexplained", "contradicted", 0.01), {})
    record.finish("d", entry(3, "unrelated", "no depth", None), {})
    return record


def test_a_pair_that_is_finished_again_counts_once(record):
    assert record.errors == [0.05, 0.2]  # errors of contradicted depth are left out
    record.finish("b", entry(1, "converged", "good", 0.02), {})
    assert record.errors == [0.02, 0.05] and record.statuses["uncertain"] == 0
    record.finish("a", entry(0, "unexplained", "contradicted", 0.05), {})
    assert record.errors == [0.02]


def test_summary_of_pairs(record, tmp_path):
    summary = record.grade_summary
    assert (summary.median, summary.worst) == ("no depth", "contradicted")
    assert (summary.median_error, summary.worst_error) == (0.2, 0.2)
    record.write()
    assert summarise_pairs(read_record(tmp_path)["pairs"].values()) == summary
    assert summarise_pairs([]) is None
