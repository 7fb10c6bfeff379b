"""Long runs: the figures add up, and what misses a bar fails."""

import pytest

from bench.sequences import long_runs


def found(two, last, slower, other):
    return long_runs.Results(
        workers=[(10.0, two), (10.0, two), (5.0, 20.0)],
        frames={
            "pairs": 9999,
            "memory early, MB": 100.0,
            "memory at the end, MB": last,
            "pairs/s early": 50.0,
            "pairs/s at the end": slower,
        },
        kills={"a run": {"killed": 20, "ended before": 3, "other bytes": other}},
    )


@pytest.mark.parametrize(
    ("values", "met"), [((17.1, 104.0, 48.0, 0), [True] * 4), ((16.9, 106.0, 47.0, 1), [False] * 4)]
)
def test_bars(values, met):
    assert [bar.is_met for bar in long_runs.bars(found(*values))] == met


def test_report():
    text = long_runs.report(found(17.5, 104.0, 48.0, 0), {"processor": "y"})
    assert "| 1 | 10.00 | 17.50 | 1.75 |" in text
    assert "| a run | 20 | 3 | 0 |" in text
    assert "pass  two workers over one: 1.75 (at least 1.7)" in text


def test_speed():
    assert long_runs.speed([0.0, 1.0, 1.5, 2.0], 2, 4) == pytest.approx(2.0)


@pytest.mark.nightly
def test_smoke(capsys):
    pytest.importorskip("distributed")
    assert long_runs.main(["--smoke"]) == 0
    said = capsys.readouterr().out
    assert "two workers over one" in said and "a run on a cluster of two workers | 1 |" in said
