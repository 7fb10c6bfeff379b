"""Scaling of whole pairs: what the benchmark reports, and that its parts add up."""

import json

import pytest

from bench import scaling, scaling_worker


def found():
    runs = [
        {
            "preset": "fast",
            "threads": threads,
            "times": {"10x10": [2e-6 / threads] * 3, "10x30": [6.6e-6 / threads] * 3},
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


def test_picture(tmp_path):
    scaling.draw(found(), tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_the_stages_of_a_pair_make_up_its_time(tmp_path):
    from tisfm import runtime

    pairs = scaling.render(["24x32", "40x50"], tmp_path)
    answer = scaling_worker.measure(
        {"preset": "fast", "threads": runtime.threads(), "pairs": pairs, "rounds": 2}
    )
    answer = json.loads(json.dumps(answer))
    for size in ("24x32", "40x50"):
        assert len(answer["times"][size]) == 2
        assert min(answer["times"][size]) > 0
        shares = answer["shares"][size]
        assert set(shares) == {label for *_, label in scaling_worker.STAGES}
        assert sum(shares.values()) == pytest.approx(1)
        assert min(shares.values()) >= 0


def test_a_stage_does_not_count_those_within():
    watch = scaling_worker.Stopwatch()
    inner = watch._timed(lambda: sum(range(200_000)), "inner")
    watch._timed(lambda: inner(), "outer")()
    assert watch.seconds["outer"] < watch.seconds["inner"]


@pytest.mark.parametrize("arguments", [["--rounds", "0"], ["--threads", "0"]])
def test_bad_numbers_are_refused(arguments, capsys):
    with pytest.raises(SystemExit):
        scaling.parse(arguments)
    assert "at least 1" in capsys.readouterr().err
