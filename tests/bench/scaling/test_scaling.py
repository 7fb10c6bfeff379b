"""Scaling of whole pairs: what the benchmark reports, and that its parts add up."""

import json
from types import SimpleNamespace

import pytest

from bench.scaling import __main__ as scaling
from bench.scaling import worker as scaling_worker


def found():
    runs = [
        {
            "preset": "fast",
            "threads": threads,
            "times": {"10x10": [2e-6 / threads] * 3, "10x30": [6.6e-6 / threads] * 3},
            "peer": {"name": "DIS", "size": "10x10", "times": [1e-6 / threads] * 3},
            "shares": {"10x10": {"sweeps": 0.75, "all else": 0.25}, "10x30": {"sweeps": 1.0}},
        }
        for threads in (1, 2)
    ]
    return {
        "conditions": {"processor": "x"},
        "sizes": ["10x10", "10x30"],
        "presets": ["fast"],
        "runs": runs,
        "memory": {"fast": {"10x30": 50.0}},
    }


def test_report():
    text = scaling.report(found())
    assert "| fast | 1 | 10x10 | 2e-06 [2e-06–2e-06] | 20 | – |" in text
    assert "| fast | 2 | 10x30 | 3.3e-06 [3.3e-06–3.3e-06] | 11 | 1.10 |" in text
    assert "| fast | 2.00 | 2.00 |" in text
    assert "| fast | 10x30 | 50.0 | 0.00 |" in text
    assert "| sweeps | 75.0 | 100.0 |" in text
    assert "## Time over the time of DIS at 10x10" in text
    assert "| fast | 2 | 5e-07 | 2.00 | 6.60 |" in text
    assert "## Bars" not in text


MIDDLE, LARGE, LARGEST = 480 * 640, 1080 * 1920, 2160 * 3840


def large(preset="balanced", *, middle=400.0, floats=50.0):
    """Return a run whose pair takes 400 ns per pixel at 1080x1920, 40 times DIS's time."""
    times = {
        "480x640": [MIDDLE * middle * 1e-9] * 3,
        "1080x1920": [LARGE * 400e-9] * 3,
        "2160x3840": [LARGEST * 400e-9] * 3,
    }
    unit = LARGE * 1e-8
    run = {
        "preset": preset,
        "times": times,
        "shares": {size: {"all": 1.0} for size in times},
        "peer": {"name": "DIS", "size": "480x640", "times": [unit, unit, 9 * unit]},
    }
    return found() | {
        "sizes": list(times),
        "presets": [preset],
        "runs": [run | {"threads": 1}, run | {"threads": 2}],
        "memory": {preset: {"2160x3840": floats}},
    }


@pytest.mark.parametrize(
    ("given", "met"),
    [
        ({}, [True, True, True]),
        ({"middle": 340.0}, [True, False, True]),
        ({"floats": 110.0}, [True, True, False]),
    ],
)
def test_bars(given, met):
    held = list(scaling.bars(large(**given)))
    assert [bar.is_met for bar in held] == met
    assert [bar.bound for bar in held] == [57.0, 1.15, 3.0]
    assert held[0].value == pytest.approx(40)  # the median, of the same rounds
    assert f"- {held[0]}" in scaling.report(large(**given))


def test_the_fast_preset_stands_beside_the_peer_at_its_size_without_a_bar():
    run = large("fast")
    assert [bar.bound for bar in scaling.bars(run)] == [None, 1.15, 3.0]
    for entry in run["runs"]:
        entry["peer"]["times"] = [0.01] * 3
    beside = next(scaling.bars(run))
    assert beside.value == pytest.approx(MIDDLE * 400e-9 / 0.01)
    assert str(beside).startswith("also")


def test_growth_is_that_of_the_same_rounds():
    run = large()
    slow = {"480x640": (1, 3, 3), "1080x1920": (1, 3, 1)}  # a machine that was busy for a while
    for entry in run["runs"]:
        for size, factors in slow.items():
            entry["times"][size] = [
                t * factor for t, factor in zip(entry["times"][size], factors, strict=True)
            ]
    (growth,) = (bar for bar in scaling.bars(run) if "growth" in bar.name)
    assert growth.value == pytest.approx(1)


def test_calls_take_turns_and_quick_ones_are_doubled(monkeypatch):
    monkeypatch.setattr(scaling_worker, "FAST_CALL", -1.0)
    log = []
    calls = {name: lambda name=name: log.append(name) for name in "ab"}
    times = scaling_worker.measure_in_turns(calls, 2)
    assert log == list("ab" * 4)  # two warm up
    assert {name: len(values) for name, values in times.items()} == {"a": 2, "b": 2}
    monkeypatch.setattr(scaling_worker, "FAST_CALL", 1.0)
    log.clear()
    scaling_worker.measure_in_turns(calls, 1)
    assert log == list("abab" + "aabb")


def test_picture(tmp_path):
    scaling.draw(found(), tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_the_stages_of_a_pair_make_up_its_time(tmp_path):
    from tisfm import runtime

    pairs = scaling.render(["24x32", "40x50"], tmp_path)
    answer = scaling_worker.measure(
        {
            "preset": "fast",
            "threads": runtime.threads(),
            "pairs": pairs,
            "rounds": 2,
            "peer": "40x50",
        }
    )
    answer = json.loads(json.dumps(answer))
    assert answer["lanes"] == runtime.lanes()
    assert answer["peer"]["size"] == "40x50" and len(answer["peer"]["times"]) == 2
    assert set(answer["times"]) == {"24x32", "40x50"}
    for size in ("24x32", "40x50"):
        assert len(answer["times"][size]) == 2
        assert min(answer["times"][size]) > 0
        shares = answer["shares"][size]
        assert set(shares) == {label for *_, label in scaling_worker.STAGES}
        assert sum(shares.values()) == pytest.approx(1)
        assert min(shares.values()) >= 0


def test_a_stage_does_not_count_inner_stages(monkeypatch):
    times = iter([0.0, 1.0, 5.0, 7.0])  # s: outer and inner begin, inner and outer end
    clock = SimpleNamespace(perf_counter=lambda: next(times))
    monkeypatch.setattr(scaling_worker, "time", clock)
    watch = scaling_worker.Stopwatch()
    inner = watch._timed(lambda: None, "inner")
    watch._timed(lambda: inner(), "outer")()
    assert watch.seconds == {"inner": 4.0, "outer": 3.0}


@pytest.mark.parametrize("arguments", [["--rounds", "0"], ["--threads", "0"]])
def test_bad_numbers_are_refused(arguments, capsys):
    with pytest.raises(SystemExit):
        scaling.parse(arguments)
    assert "at least 1" in capsys.readouterr().err
