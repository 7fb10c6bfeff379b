"""What storing costs: the figures add up, and a run that is too slow fails."""

import pytest

from bench import writing


def outcome(*times):
    return writing.Outcome(source="x", pairs=4, times=times, size=2_000_000)


def test_report():
    found = outcome((2.0, 2.6, 3.0), (1.0, 1.2, 1.3), (4.0, 5.0, 5.6))
    assert found.ratios(0) == pytest.approx((1.225, 1.25, 1.275))
    text = writing.report(found, {"processor": "y"})
    name = "`tisfm run --no-figures`"
    assert f"| {name} | 4 | 3 | 2.00 | 2.60 | 1.25 | 1.23–1.27 |" in text
    assert f"pass  {name} over interpret_sequence: 1.25 (at most 1.3)" in text
    assert "2 MB were written" in text


@pytest.mark.parametrize(
    ("seconds", "met"), [((1.29, 1.49), [True, True]), ((1.31, 1.51), [False, False])]
)
def test_bars(seconds, met):
    assert [bar.is_met for bar in writing.bars(outcome((1.0, *seconds)))] == met


@pytest.mark.nightly
def test_smoke(capsys):
    assert writing.main(["--smoke", "--preset", "fast"]) == 0
    assert "| 3 | 1 |" in capsys.readouterr().out
