"""One checkout beside another: what differs is found, what does not is not. No timing."""

import os
import shutil

import numpy as np
import pytest

from bench.regression import __main__ as regression
from bench.regression.checkout import PairedTimes, measure_in_turns
from bench.regression.report import (
    Case,
    Difference,
    Findings,
    difference,
    markdown,
    out_of_bounds,
    relative,
)
from bench.shared.results import ROOT

SHAPE = (6, 8)
ALTERED = """

import dataclasses as _dataclasses

from tisfm.pair import interpret as _interpret


def interpret(*frames, **options):
    found = _interpret(*frames, **options)
    return _dataclasses.replace(found, flow=found.flow + found.flow.dtype.type(0.25))
"""


def answer(**changes):
    rng = np.random.default_rng(0)
    arrays = {
        "flow": rng.normal(size=(*SHAPE, 2)).astype(np.float32),
        "inverse_depth": rng.uniform(1, 2, SHAPE).astype(np.float32),
        "confidence": rng.uniform(size=SHAPE).astype(np.float32),
        "occlusion": np.zeros(SHAPE, bool),
        "labels": np.zeros(SHAPE, np.int32),
    }
    for name, (place, value) in changes.items():
        arrays[name][place] = value
    return arrays


def compared(tmp_path, before, after):
    paths = [tmp_path / name for name in ("before.npz", "after.npz")]
    for path, arrays in zip(paths, (before, after), strict=True):
        np.savez(path, **arrays)
    return difference(*paths)


def test_no_difference_is_exactly_none(tmp_path):
    both = answer(inverse_depth=((0, 0), np.nan))
    found = compared(tmp_path, both, both)
    assert found == Difference(
        flow_max=0, flow_median=0, above_rounding=0, depth_max=0, depth_median=0, labels=0,
        occlusion=0, identical=True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("change", "field", "expected"),
    [
        ({"flow": ((2, 3, 1), 100.0)}, "above_rounding", 1 / 48),
        ({"flow": ((2, 3, 1), np.nan)}, "flow_max", np.inf),
        ({"inverse_depth": ((2, 3), np.inf)}, "depth_max", np.inf),
        ({"occlusion": ((2, 3), True)}, "occlusion", 1 / 48),
        ({"labels": ((2, 3), 1)}, "labels", 1 / 48),
    ],
)
def test_each_difference_is_seen(tmp_path, change, field, expected):
    found = compared(tmp_path, answer(), answer(**change))
    assert getattr(found, field) == pytest.approx(expected)
    assert not found.identical


def test_arrays_of_one_side_only_and_confidence_count(tmp_path):
    without = {name: value for name, value in answer().items() if name != "labels"}
    assert compared(tmp_path, answer(), without).labels == 1
    assert compared(tmp_path, without, without).labels == 0
    assert not compared(tmp_path, answer(), answer(confidence=((0, 0), 0.5))).identical


def test_inverse_depth_is_compared_relatively_with_a_floor():
    before = np.array([1.0, 2.0, 1e-9, np.nan])
    after = np.array([1.1, 1.0, 1.1e-9, np.nan])
    np.testing.assert_allclose(relative(before, after), [0.1, 0.5, 1e-8, 0.0], atol=1e-12)


def test_sides_take_turns():
    log = []
    found = measure_in_turns(3, lambda side: log.append(side) or (side, len(log)))
    assert log == [0, 1, 1, 0, 0, 1]
    assert found == [((0, 1), (1, 2)), ((0, 4), (1, 3)), ((0, 5), (1, 6))]


def paired(ratio, cpu):
    samples = [((1.0, 2.0), (ratio * k, 2.0 * cpu * k)) for k in (0.99, 1.0, 1.01)]
    return PairedTimes.of("thing", samples)


def test_out_of_bounds():
    case = {"pair": "p", "preset": "fast", "motion": "field", "before": "converged"}
    nothing = {
        "flow_max": 0.0, "flow_median": 0.0, "above_rounding": 0.0, "depth_max": 1e-6,
        "depth_median": 0.0, "labels": 0.0, "occlusion": 0.0, "identical": False,
    }  # fmt: skip

    def reasons(times=(), after="converged", **changes):
        differs = Difference(**nothing | changes)
        cases = [Case(**case, after=after, difference=differs)]
        found = Findings(conditions={}, cases=cases, times=times)
        listed = list(out_of_bounds(found))
        assert all(f"- {line}\n" in markdown(found) for line in listed)
        return " ".join(listed)

    assert reasons() == ""
    assert "0.500% of the pixels" in reasons(above_rounding=0.005)
    assert "labels differ" in reasons(labels=0.01)
    assert "was converged and is diverged" in reasons(after="diverged")
    assert "1.100 times as long" in reasons([paired(1.1, 1.1)])
    assert reasons([paired(1.1, 1.0)]) == reasons([paired(1.02, 1.1)]) == ""


def run(before, monkeypatch, tmp_path):
    monkeypatch.setattr(regression, "RESULTS", tmp_path)
    words = ["--quick", "--only", "answers", "--preset", "fast", "--motion", "field"]
    words += ["--pairs", "two_blocks", "--threads", str(os.cpu_count())]
    code = regression.main(["--before", str(before), *words])
    return code, (tmp_path / "smoke-regression.md").read_text(encoding="utf-8")


@pytest.mark.nightly
def test_the_same_checkout_gives_the_same_bits(tmp_path, monkeypatch):
    code, text = run(ROOT, monkeypatch, tmp_path)
    assert code == 0
    assert "| two_blocks | fast | field | the same bits |" in text
    assert "1 cases; in 1 every array is the same in every bit" in text


@pytest.mark.nightly
def test_an_altered_checkout_is_found_out(tmp_path, monkeypatch):
    other = tmp_path / "other"
    for name in ("tisfm", "kernels"):
        shutil.copytree(ROOT / name, other / name, ignore=shutil.ignore_patterns("__pycache__"))
    with (other / "tisfm" / "__init__.py").open("a", encoding="utf-8") as file:
        file.write(ALTERED)
    code, text = run(other, monkeypatch, tmp_path)
    assert code == 1
    assert "Largest difference of flow: 0.25 px" in text
    assert "flow differs by more than 0.001 px at 100.000% of the pixels" in text


def test_a_folder_that_is_no_checkout_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        regression.main(["--before", str(tmp_path)])
    assert "is no checkout of this project" in capsys.readouterr().err
