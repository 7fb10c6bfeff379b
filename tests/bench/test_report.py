"""The table of timings and its bars: merging, shares, ratios. No timing."""

import pytest

from bench import __main__ as command
from bench.__main__ import DISAGREEMENT_TEXT, fault_of, parse
from bench.kernels.traffic import TRAFFIC
from bench.report import HEAD, bars, collect, describe, write_markdown
from tisfm.runtime import cpu_lanes

PIXELS = 480 * 640


def entry(median, **info):
    stats = {"median": median, "iqr": median / 10, "rounds": 5}
    return {"stats": stats, "extra_info": {"threads": 2, **info}}


def report(sweep_ns=10.0, numpy_ns=1000.0, large_ns=None, pair_ratio=60.0):
    kernel = {"kernel": "sweep separate", "size": [480, 640], "model": "rigid"}
    scale = 1e-9 * PIXELS
    words = TRAFFIC["sweep separate"].bytes_per_pixel(6, cpu_lanes())
    taichi = {"implementation": "taichi", "solver": "cholesky", "lanes": cpu_lanes()}
    entries = [
        entry(0.01, implementation="stream", kernel="copy", bytes=2 * 10**8),
        entry(0.01, implementation="stream", kernel="triad", bytes=10**8),
        entry(numpy_ns * scale, implementation="numpy", **kernel),
        entry(sweep_ns * scale, bytes_per_pixel=words, **taichi, **kernel),
    ]
    if large_ns is not None:
        large = {"size": [1080, 1920], "model": "rigid"}
        taichi |= {"solver": "closed_form"}
        for kernel in ("sweep joint", "sweep_unfused joint"):
            words = TRAFFIC[kernel].bytes_per_pixel(6, cpu_lanes())
            seconds = large_ns * 1e-9 * 1080 * 1920
            entries.append(entry(seconds, bytes_per_pixel=words, kernel=kernel, **taichi, **large))
        pair = {"kernel": "pair balanced", "size": [240, 320], "model": "rigid"}
        entries.append(entry(1.0, **taichi, **pair))
        entries.append(entry(pair_ratio, implementation="numpy", **pair))
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


def test_the_reference_of_another_process_is_not_used():
    first, second = report(), report()
    second["benchmarks"] = [
        {**e, "extra_info": e["extra_info"] | {"threads": 1}}
        for e in second["benchmarks"]
        if e["extra_info"]["implementation"] == "taichi"
    ]
    ratios = {row.threads: row.ratio for row in collect([first, second], {}).rows}
    assert ratios[1] is None
    assert ratios[2] == pytest.approx(100)


FLOOR = TRAFFIC["sweep_unfused joint"].bytes_per_pixel(6, cpu_lanes()) / 20  # ns, at 20 GB/s


@pytest.mark.parametrize(
    ("change", "missed"),
    [
        ({}, set()),
        ({"sweep_ns": 13}, {"12"}),
        ({"numpy_ns": 600}, {"70"}),
        ({"large_ns": 1.2 * FLOOR}, {"6"}),
        ({"large_ns": 1.4 * FLOOR}, {"6", "1.3"}),
        ({"pair_ratio": 40}, {"50"}),
        ({"floats": 61}, {"60"}),
    ],
)
def test_bars(change, missed):
    given = {"sweep_ns": 10, "numpy_ns": 1000, "large_ns": 5, "floats": 50} | change
    memory = dict.fromkeys(("paper", "fast", "balanced", "accurate"), given.pop("floats"))
    found = list(bars(collect([report(**given)], memory)))
    assert {f"{bar.bound:g}" for bar in found if not bar.is_met} == missed
    assert {f"{bar.bound:g}" for bar in found if bar.bound} == {"12", "70", "6", "1.3", "50", "60"}
    beside, paper = (bar for bar in found if bar.bound is None)
    assert "paper" in paper.name and paper.value == memory["paper"]
    fused = TRAFFIC["sweep joint"].bytes_per_pixel(6, cpu_lanes()) / 20
    assert beside.value == pytest.approx(given["large_ns"] / fused)
    assert "pass" not in str(beside) and f"memory floor: {beside.value:.2f}" in str(beside)


def test_a_bar_that_was_not_measured_is_missed():
    assert not any(bar.is_met for bar in bars(collect([], {})))


def test_a_run_on_a_gpu_has_one_lane_and_files_of_its_own(capsys):
    options = parse(["--smoke", "--arch", "cuda"])
    assert (options.arch, options.lanes, options.output) == ("cuda", "1", "smoke-cuda")
    assert len(options.threads) == 1 and not options.memory and not options.contests
    options = parse([])
    assert (options.arch, options.lanes, options.output) == (
        "cpu",
        "16,8,1" if cpu_lanes() == 16 else "8,1",
        "full",
    )
    with pytest.raises(SystemExit):
        parse(["--bars", "--arch", "cuda"])
    assert "the bars hold for the CPU" in capsys.readouterr().err


def test_the_gpu_is_named():
    named = report()
    named["machine_info"] |= {"arch": "cuda", "gpu": "NVIDIA X, 1.2"}
    assert "Kernels on cuda: NVIDIA X, 1.2" in describe(collect([named], {}))
    assert not any("Kernels on" in line for line in describe(collect([report()], {})))


@pytest.mark.parametrize(
    ("gone", "told"),
    [
        ({"pytest", "pytest_benchmark"}, "needs pytest and pytest-benchmark, not installed"),
        ({"xdist"}, "needs pytest-xdist, not installed"),
    ],
)
def test_missing_packages_are_named_before_any_benchmark(monkeypatch, capsys, gone, told):
    def found(module):
        return None if module in gone else module

    def begun(*arguments):
        raise AssertionError("nothing is run")

    monkeypatch.setattr(command, "find_spec", found)
    monkeypatch.setattr(command, "run_benchmarks", begun)
    assert command.main(["--smoke"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and told in err and "pip install -e '.[test]'" in err and err.count("\n") == 1


def test_only_a_failed_test_counts_as_a_wrong_answer():
    assert fault_of(0) == "" and fault_of(1) == DISAGREEMENT_TEXT
    assert "exit code 4" in fault_of(4) and "disagreed" not in fault_of(4)
