"""What storing costs: the figures add up, and a run that is too slow fails."""

import pytest

from bench.sequences import writing


def outcome(*times):
    return writing.Outcome(source="x", pairs=4, times=times, size=2_000_000)


def test_report():
    found = outcome((2.0, 3.0), (1.0, 1.2), (4.0, 5.6))
    assert found.ratios == pytest.approx((1.3, 1.4, 1.45))
    text = writing.report(found, {"processor": "y"})
    assert "| 4 | 3 | 2.00 | 3.00 | 1.40 | 1.30–1.45 | 2 |" in text
    assert "pass  tisfm run --no-figures over interpret_sequence: 1.40 (at most 1.6)" in text


@pytest.mark.parametrize(("seconds", "met"), [(1.59, True), (1.61, False)])
def test_bar(seconds, met):
    assert [bar.met for bar in writing.bars(outcome((1.0, seconds)))] == [met]


def test_smoke(capsys):
    assert writing.main(["--smoke", "--preset", "fast"]) == 0
    assert "| 3 | 1 |" in capsys.readouterr().out
