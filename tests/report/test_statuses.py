"""Statuses of a report: each is explained, counted, and drawn over the frames."""

import re
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tisfm.report.pictures import choose_slides
from tisfm.report.tables import MEANINGS, count_statuses, status_color, status_spans
from tisfm.status import Status

TRUST = Path(__file__).parents[2] / "docs" / "trust.md"


def test_every_status_has_a_meaning_and_a_colour():
    text = TRUST.read_text(encoding="utf-8").partition("## Statuses")[2].partition("\n## ")[0]
    codes = set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE))
    assert codes == set(MEANINGS)
    assert all(re.fullmatch("#[0-9a-f]{6}", status_color(code)) for code in (*codes, "another"))


def test_a_status_of_another_version_is_doubtful():
    (found,) = count_statuses([Status("brand_new", "do so")], ["f0"])
    assert found.code == "brand_new" and found.advice == "do so"
    assert "doubt" in found.meaning
    assert status_color("brand_new") != status_color("converged")


def test_they_are_counted_with_the_advice_of_the_first():
    statuses = [Status("converged", "as usual")] * 6
    statuses += [Status("aperture", "turn"), Status("aperture", "other")]
    found = count_statuses(statuses, [f"f{k}" for k in range(8)])
    assert [(status.code, status.count, status.advice) for status in found] == [
        ("converged", 6, ""),
        ("aperture", 2, "turn"),
    ]
    assert found[0].names == "f0, f1, f2, f3 and 2 more" and found[1].names == "f6, f7"
    assert count_statuses(statuses[:6], "abcdef")[0].names == "all"
    assert count_statuses([], []) == []


@given(st.lists(st.sampled_from("abc"), max_size=60), st.integers(1, 20))
def test_spans_cover_all_frames_once(codes, most):
    found = status_spans(codes, most)
    ends = [0.0, *(end for _, end, _ in found)]
    assert [begin for begin, _, _ in found] == ends[:-1]
    assert not codes or ends[-1] == 1
    if len(codes) <= most:
        shown = [
            next(code for begin, end, code in found if begin <= (k + 0.5) / len(codes) < end)
            for k in range(len(codes))
        ]
        assert shown == codes


def test_a_rare_status_is_seen_in_a_long_sequence():
    codes = ["converged"] * 100_000
    codes[54_321] = "diverged"
    assert [code for _, _, code in status_spans(codes)] == ["converged", "diverged", "converged"]


@given(st.integers(0, 2000), st.lists(st.integers(0, 1999), max_size=80), st.integers(4, 60))
def test_chosen_frames_are_there_and_spread(count, wanted, most):
    wanted = [frame for frame in wanted if frame < count]
    found = choose_slides(count, wanted, most)
    assert found == sorted(set(found)) and len(found) <= most
    assert set(found) <= set(range(count))
    if count <= most:
        assert found == list(range(count))
    else:
        assert set(list(dict.fromkeys(wanted))[: most // 2]) <= set(found)
        assert found[-1] == count - 1 and found[0] == 0
        assert np.diff(found).max() <= count / (most - most // 2 - 1) + 1
