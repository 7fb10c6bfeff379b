"""The benchmarks' bookkeeping: merging, shares, bars, agreement. No timing."""

import itertools

import numpy as np
import pytest

from bench.agreement import check, check_quantile, disagreement
from bench.bars import bars
from bench.report import HEAD, collect, write_markdown
from bench.traffic import TRAFFIC

PIXELS = 480 * 640


def entry(median, **info):
    stats = {"median": median, "iqr": median / 10, "rounds": 5}
    return {"stats": stats, "extra_info": {"threads": 2, **info}}


def report(sweep_ns=10.0, numpy_ns=1000.0):
    kernel = {"kernel": "sweep", "size": [480, 640], "model": "rigid"}
    scale = 1e-9 * PIXELS
    words = TRAFFIC["sweep"].bytes_per_pixel(6)
    taichi = {"implementation": "taichi", "solver": "cholesky", "lanes": 8}
    entries = [
        entry(0.01, implementation="stream", kernel="copy", bytes=2 * 10**8),
        entry(0.01, implementation="stream", kernel="triad", bytes=10**8),
        entry(numpy_ns * scale, implementation="numpy", **kernel),
        entry(sweep_ns * scale, bytes_per_pixel=words, **taichi, **kernel),
    ]
    machine = {"machine": "x", "system": "y", "python_version": "3", "numpy": "2", "taichi": "1"}
    return {"machine_info": machine, "benchmarks": entries}


def test_a_row_has_time_bandwidth_share_and_ratio(tmp_path):
    results = collect([report()], {"fast": 50.0})
    (row,) = results.rows
    assert row.time == pytest.approx(10)
    assert row.bandwidth == pytest.approx(4 * (5 + 4 * 6) / 10)  # 29 words in 10 ns
    assert row.share == pytest.approx(row.bandwidth / 20)  # the better of the streams
    assert row.ratio == pytest.approx(100)
    write_markdown(results, tmp_path / "name.md")
    text = (tmp_path / "name.md").read_text(encoding="utf-8")
    assert "| " + " | ".join(row.cells()) + " |" in text
    assert len(row.cells()) == len(HEAD)


def test_the_reference_of_another_process_is_not_taken():
    first, second = report(), report()
    second["benchmarks"] = [
        {**e, "extra_info": e["extra_info"] | {"threads": 1}}
        for e in second["benchmarks"]
        if e["extra_info"]["implementation"] == "taichi"
    ]
    ratios = {row.threads: row.ratio for row in collect([first, second], {}).rows}
    assert ratios[1] is None
    assert ratios[2] == pytest.approx(100)


@pytest.mark.parametrize(
    ("sweep_ns", "numpy_ns", "floats", "met"),
    [
        (10, 1000, 50, (True, True, True)),
        (13, 1000, 50, (False, True, True)),
        (10, 600, 50, (True, False, True)),
        (10, 1000, 61, (True, True, False)),
    ],
)
def test_bars(sweep_ns, numpy_ns, floats, met):
    memory = dict.fromkeys(("paper", "fast", "balanced", "accurate"), floats)
    found = list(bars(collect([report(sweep_ns, numpy_ns)], memory)))
    assert [bar.met for bar in found[:2]] == list(met[:2])
    assert {bar.met for bar in found[2:]} == {met[2]}


def test_a_bar_that_was_not_measured_is_missed():
    assert not any(bar.met for bar in bars(collect([], {})))


def test_disagreement_is_relative_to_each_component():
    expected = np.array([[[100.0, 0.0]], [[0.0, 0.1]]])
    actual = expected.copy()
    actual[1, 0, 0] = 0.01
    assert disagreement(actual, expected) == pytest.approx(0.1)
    assert check(actual, expected, 0.2) == pytest.approx(0.1)


@pytest.mark.parametrize("wrong", [0.5, np.nan, np.inf])
def test_one_wrong_pixel_fails_the_check(wrong):
    expected = np.ones((2, 30, 40))
    actual = expected.copy()
    actual[1, 7, 7] = wrong
    with pytest.raises(AssertionError, match="differs from the reference"):
        check(actual, expected, 1e-3)
    with pytest.raises(AssertionError, match="100% of the pixels"):
        check_quantile(np.abs(actual - expected), 1.0, 1e-3)


def test_every_kernel_has_its_traffic():
    from bench.bench_kernels import CASES
    from bench.operations import Operations
    from bench.references import References

    assert {case.name for case in CASES} == set(TRAFFIC)
    for case, side in itertools.product(CASES, (Operations, References)):
        assert callable(getattr(side, case.kernel))
