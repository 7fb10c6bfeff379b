"""Contests: turns, failures, what the tables say. No timing."""

import json

import numpy as np
import pytest

from bench.shared import contest_report
from bench.shared.contest_report import busy_cores, measured_columns, relative_time, standard_time
from tests.bench.shared.fakes import SIZE, Fake, contest, flow_pair


def test_methods_take_turns_in_every_round():
    log = []
    slow = {"seconds": 1.0}  # not so quick that calls are doubled
    held = contest([Fake("a", log, **slow), Fake("b", log, **slow)], [flow_pair()], rounds=1)
    on_pair = [name for name, pair in log if pair == "Grove2"]
    assert on_pair == ["a", "b", "a", "b"]
    assert [len(m.timings) for m in held.measurements] == [1, 1]


def test_first_calls_and_those_before_quick_ones_are_not_timed():
    held = contest([Fake("a", [])], [flow_pair()], rounds=2)
    # Calls 1 and 2 warm up, 3 is the pair's first, 4 and 6 come before those timed.
    assert [round(t.seconds * 1e3) for t in held.measurement("a", "Grove2").timings] == [5, 7]
    assert busy_cores(held, "a") == pytest.approx(2)


def test_a_slow_method_has_fewer_rounds_and_no_warm_up_of_each_pair():
    log = []
    methods = [Fake("a", log), Fake("slow", log, seconds=100.0)]
    held = contest(methods, [flow_pair()], rounds=5)
    assert [t.round for t in held.measurement("slow", "Grove2").timings] == [1, 2, 3]
    assert [t.round for t in held.measurement("a", "Grove2").timings] == [1, 2, 3, 4, 5]
    assert relative_time(held, "slow").median > 1e4


def test_a_failure_costs_one_pair_and_is_reported(tmp_path):
    log = []
    pairs = [flow_pair(), flow_pair("Urban2"), flow_pair("kitti", "kitti")]
    held = contest([Fake("a", log), Fake("b", log, fails_on="Urban2")], pairs)
    assert held.failures() == {"b on Urban2": "broken"}
    middlebury, kitti = measured_columns(held)
    assert middlebury.value(held, "a") == pytest.approx(1)
    assert middlebury.value(held, "b") is None
    assert kitti.value(held, "b") == 0
    assert relative_time(held, "b") is None
    contest_report.write(held, tmp_path / "out", title="title")
    text = (tmp_path / "out.md").read_text(encoding="utf-8")
    assert "- b on Urban2: broken" in text
    assert json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["methods"] == ["a", "b"]


def test_a_method_that_cannot_start_is_missing():
    held = contest([Fake("a", []), Fake("b", [], fails_on="Grove2-crop")], [flow_pair()])
    assert held.methods == ("a",)
    assert held.missing == {"b": "broken"}


def test_flow_that_is_not_finite_is_a_failure():
    held = contest([Fake("a", []), Fake("b", [], error=np.nan)], [flow_pair()])
    assert "not finite" in held.failures()["b on Grove2"]


def test_time_of_a_standard_pair_and_change_of_the_error():
    def methods():
        return [Fake("a", [], seconds=1e-5), Fake("b", [], seconds=1e-5, error=1.5)]

    small = contest(methods(), [flow_pair()], rounds=1)
    scale = 480 * 640 / (SIZE[0] * SIZE[1])
    assert standard_time(small, "a").median == pytest.approx(5e-5 * scale)
    both = [flow_pair(), flow_pair("Urban2", size=(480, 640))]
    held = contest(methods(), both, rounds=1)
    assert standard_time(held, "a").median == pytest.approx(8e-5)  # of Urban2 alone
    rows = contest_report.summary(held, changes=True).rows
    assert [row[1] for row in rows] == ["1.000", "1.500 (+50.0%)"]
