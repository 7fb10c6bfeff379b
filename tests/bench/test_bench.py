"""The benchmarks' bookkeeping: merging, shares, bars, agreement, contests. No timing."""

import ast
import itertools
import json
import os
import pkgutil
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench import ablation, bench_kernels, contest_report, peers, untextured
from bench.__main__ import parse
from bench.agreement import check, check_quantile, disagreement
from bench.bars import bars
from bench.columns import cores, present, ratio, standard_time
from bench.contest import Call, MethodFailure, hold, score
from bench.peer_plot import picture
from bench.peer_process import WORKER, Peer, find_peers, survey
from bench.problems import Problem
from bench.report import HEAD, collect, describe, write_markdown
from bench.sequences import FlowPair, data_folder, find_pairs, scene_pairs
from bench.traffic import TRAFFIC
from bench.unfused import sweep_unfused
from bench.untextured import Method
from tisfm import kernels
from tisfm.runtime import cpu_lanes
from tisfm.scenes import bare_patches
from tisfm.settings import Settings

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
    assert {f"{bar.bound:g}" for bar in found if not bar.met} == missed
    assert {f"{bar.bound:g}" for bar in found if bar.bound} == {"12", "70", "6", "1.3", "50", "60"}
    (beside,) = (bar for bar in found if bar.bound is None)
    fused = TRAFFIC["sweep joint"].bytes_per_pixel(6, cpu_lanes()) / 20
    assert beside.value == pytest.approx(given["large_ns"] / fused)
    assert "pass" not in str(beside) and f"memory floor: {beside.value:.2f}" in str(beside)


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
    from bench.bench_kernels import CASES, Operations, References

    assert {case.name for case in CASES} == set(TRAFFIC)
    for case, side in itertools.product(CASES, (Operations, References)):
        assert callable(getattr(side, case.kernel))


# Contests: methods on pairs with a true flow.

SIZE = (48, 64)


def flow_pair(name="Grove2", group="middlebury", size=SIZE):
    frame = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    truth = np.zeros((*size, 2))
    return FlowPair(name=name, group=group, frame0=frame, frame1=frame, truth=truth)


class Fake:
    """Flow off by a constant, in a time that is made up: call k takes seconds · (k + 1)."""

    def __init__(self, name, log, *, error=1.0, seconds=1e-3, fails_on=""):
        self.name, self.log, self.error, self.seconds = name, log, error, seconds
        self.fails_on, self.calls = fails_on, 0

    def run(self, pair):
        self.log.append((self.name, pair.name))
        if pair.name == self.fails_on:
            raise MethodFailure("broken")
        self.calls += 1
        seconds = self.seconds * self.calls
        flow = np.full((*pair.size, 2), [self.error, 0.0])
        return Call(flow=flow, seconds=seconds, cpu=2 * seconds)


def contest(methods, pairs, rounds=2):
    conditions = {"threads": 2}
    reference = methods[0].name
    return hold(
        methods, pairs, reference=reference, rounds=rounds, conditions=conditions, missing={}
    )


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
    assert [round(t.seconds * 1e3) for t in held.of("a", "Grove2").timings] == [5, 7]
    assert cores(held, "a") == pytest.approx(2)


def test_a_slow_method_has_fewer_rounds_and_no_warm_up_of_each_pair():
    log = []
    methods = [Fake("a", log), Fake("slow", log, seconds=100.0)]
    held = contest(methods, [flow_pair()], rounds=5)
    assert [t.round for t in held.of("slow", "Grove2").timings] == [1, 2, 3]
    assert [t.round for t in held.of("a", "Grove2").timings] == [1, 2, 3, 4, 5]
    assert ratio(held, "slow").median > 1e4


def test_a_failure_costs_one_pair_and_is_reported(tmp_path):
    log = []
    pairs = [flow_pair(), flow_pair("Urban2"), flow_pair("kitti", "kitti")]
    held = contest([Fake("a", log), Fake("b", log, fails_on="Urban2")], pairs)
    assert held.failures() == {"b on Urban2": "broken"}
    middlebury, kitti = present(held)
    assert middlebury.value(held, "a") == pytest.approx(1)
    assert middlebury.value(held, "b") is None
    assert kitti.value(held, "b") == 0
    assert ratio(held, "b") is None
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


def test_names_in_the_picture_overlap_neither_each_other_nor_the_marks():
    methods = [
        Fake(f"method number {k}", [], error=1 + 0.02 * k, seconds=1e-3 * (1 + 0.01 * k))
        for k in range(6)
    ]
    figure = picture(contest(methods, [flow_pair()]))
    (axes,) = figure.axes
    boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) == 6
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    marks = [line for line in axes.lines if line.get_marker() == "o"]
    centres = [axes.transData.transform(np.ravel(mark.get_xydata())) for mark in marks]
    assert not any(box.contains(*centre) for box in boxes for centre in centres)


def test_the_worker_needs_nothing_of_this_project():
    tree = ast.parse(WORKER.read_text(encoding="utf-8"))
    names = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    roots = {name.partition(".")[0] for name in names}
    assert roots <= sys.stdlib_module_names | {"numpy", "cv2", "skimage"}


@pytest.fixture
def dis(tmp_path):
    peer = Peer(
        "OpenCV DIS fast", python=Path(sys.executable), threads=1, folder=tmp_path, timeout=60
    )
    yield peer
    peer.close()


def test_a_worker_gives_flow_and_starts_again_after_it_died(dis):
    first, second = scene_pairs(96, 128)
    expected = dis.run(first).flow
    assert score(expected, first, dis.name).epe < 1
    dis._process.kill()
    dis._process.wait()
    with pytest.raises(MethodFailure, match="its process died with status"):
        dis.run(second)
    np.testing.assert_array_equal(dis.run(first).flow, expected)


def test_what_a_library_refuses_is_reported_and_the_worker_goes_on(dis):
    pair = scene_pairs(96, 128)[0]
    other = np.zeros((10, 12), np.uint8)
    unequal = replace(pair, name="unequal", frame1=other)
    with pytest.raises(MethodFailure, match="error"):
        dis.run(unequal)
    assert dis.run(pair).flow.shape == (96, 128, 2)


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands for Python")
def test_a_worker_that_does_not_answer_is_ended(tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexec sleep 60\n")
    python.chmod(0o755)
    peer = Peer("OpenCV DIS fast", python=python, threads=1, folder=tmp_path, timeout=0.2)
    with pytest.raises(MethodFailure, match="without an answer"):
        peer.run(scene_pairs(24, 32)[0])


def test_every_peer_is_available_or_missing_for_a_reason():
    found = survey(Path(sys.executable))
    assert "OpenCV DIS medium" in found.available
    assert all(found.missing.values())
    with pytest.raises(RuntimeError, match="does not run the peers' worker"):
        survey(Path("no-such-python"))
    _, found = find_peers(Path("no-such-python"))
    assert not found.available and "no-such-python" in found.missing["all peers"]
    assert find_peers(None)[0] == Path(sys.executable)


def test_smoke_of_the_peers(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(peers, "RESULTS", tmp_path)
    threads = str(os.cpu_count())  # as the tests started Taichi
    assert peers.main(["--smoke", "--only", "tisfm fast", "DIS", "--threads", threads]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        f"smoke-peers.{suffix}" for suffix in ("md", "json", "png")
    }
    assert "OpenCV DIS medium" in capsys.readouterr().out
    assert peers.main(["--smoke", "--only", "nothing", "--threads", threads]) == 2
    assert "no method has nothing in its name" in capsys.readouterr().err


def test_smoke_of_the_changes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ablation, "RESULTS", tmp_path)
    monkeypatch.setattr(ablation, "CHANGES", {"one warp": {"warps": 1}, "none": {"warps": 2}})
    threads = str(os.cpu_count())
    assert ablation.main(["--smoke", "--preset", "fast", "--threads", threads]) == 0
    printed = capsys.readouterr().out
    assert "missing: none: the same as the preset" in printed
    assert "one warp: warps = 1" in (tmp_path / "smoke-ablation.md").read_text(encoding="utf-8")


def test_parts_without_texture(tmp_path, monkeypatch, capsys):
    fast = Settings.preset("fast", outer_iterations=2)
    methods = {"a": Method(fast), "b": Method(fast, noise=5), "c": Method(None)}
    monkeypatch.setattr(untextured, "methods", lambda: methods)
    monkeypatch.setattr(untextured, "SEEDS", (0, 1))
    threads = str(os.cpu_count())
    size = ["--height", "90", "--width", "120"]
    assert untextured.main(["-o", str(tmp_path), *size, "--threads", threads]) == 0
    text = (tmp_path / "untextured.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out.strip() in text
    assert f"- threads: {threads}" in text and "- NumPy: " in text
    record = json.loads((tmp_path / "untextured.json").read_text(encoding="utf-8"))
    assert {name: len(rows) for name, rows in record["found"].items()} == {"a": 2, "b": 2, "c": 2}
    assert set(record["found"]["a"][0]) == set(untextured.COLUMNS)
    assert all(np.isfinite(v) for rows in record["found"].values() for v in rows[0].values())
    assert record["found"]["a"] != record["found"]["b"]
    assert "depth_bare" not in record["found"]["c"][0]


def test_the_noise_is_what_it_says():
    pair = bare_patches(90, 120)
    noise = untextured.noisy(pair, 5, seed=0).frame1 - pair.frame1.astype(float)
    assert noise.std() == pytest.approx(5, rel=0.05)
    assert {method.noise for method in untextured.methods().values()} == {0, 2, 5}


def test_the_changes_are_possible_and_an_impossible_one_is_named():
    for preset in ("fast", "balanced", "accurate"):
        assert set(ablation.variants(preset, ablation.CHANGES)) == set(ablation.CHANGES)
    with pytest.raises(ValueError, match="'few' is impossible: warps is 0"):
        ablation.variants("fast", {"few": {"warps": 0}})


def test_all_pairs_are_found(shared_data):
    found, missing = find_pairs(shared_data)
    assert not missing
    assert len(found) == 10
    for pair in found:
        assert pair.frame0.shape[:2] == pair.frame1.shape[:2] == pair.size
        assert pair.frame0.dtype == pair.frame1.dtype == np.uint8
        known = (np.abs(pair.truth) < 1e9).all(axis=-1)
        x, y = np.meshgrid(*map(np.arange, pair.size[::-1]))
        place = (np.dstack([x, y]) + np.where(known[..., None], pair.truth, 0)).astype(np.float32)
        first, second = pair.frame0.astype(np.float32), pair.frame1.astype(np.float32)
        moved = cv2.remap(second, place, None, cv2.INTER_LINEAR)
        assert np.abs(moved - first)[known].mean() < 0.8 * np.abs(second - first)[known].mean()


def test_missing_pairs_are_named(tmp_path):
    found, missing = find_pairs(tmp_path)
    assert not found
    assert "frame10.png" in missing["Grove2"]
    with pytest.raises(NotADirectoryError, match="expected one with real sequences"):
        data_folder(tmp_path / "none")


# On a GPU


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
    assert "the bars are those of the CPU" in capsys.readouterr().err


def test_the_gpu_is_named():
    named = report()
    named["machine_info"] |= {"arch": "cuda", "gpu": "NVIDIA X, 1.2"}
    assert "Kernels on cuda: NVIDIA X, 1.2" in describe(collect([named], {}))
    assert not any("Kernels on" in line for line in describe(collect([report()], {})))


@pytest.mark.parametrize(("lanes", "on_device"), [(1, True), (cpu_lanes(), False)])
def test_what_is_timed_agrees_with_the_reference(lanes, on_device):
    problem = Problem(23, 34)
    for case in bench_kernels.CASES:
        operations = bench_kernels.Operations(
            problem,
            lanes,
            case.components or 6,
            scheme=case.scheme,
            solver=case.solver,
            on_device=on_device,
        )
        run, read = getattr(operations, case.kernel)()
        bench_kernels.reference_run(problem, case.without_solver())
        expected = problem.expected[case.without_solver()]
        check(read(run()), expected, case.tolerance(problem))


def test_two_passes_need_more_lanes_than_one():
    problem = Problem(5, 6)
    side = bench_kernels.Operations(problem, 1, 6, scheme="joint")
    field = side.field
    with pytest.raises(ValueError, match="1 lane: expected 8 or 16"):
        sweep_unfused(
            side.grid, *side.system(), field.x_hat, field.y_hat, field.rho,
            alpha=1.0, relaxation=1.0, solver="cholesky",
        )  # fmt: skip


def test_a_pass_for_one_color_spares_lines_of_the_other():
    two_passes = TRAFFIC["sweep_unfused joint"]
    once = TRAFFIC["sweep joint"]
    n = 6
    assert two_passes.bytes_per_pixel(n, 8) == 2 * once.bytes_per_pixel(n, 8) == 2 * 4 * 19
    # Of 16 lanes, each color has lines of its own: of the tensor, and of ρ̂ where it is written.
    assert two_passes.bytes_per_pixel(n, 16) == 4 * (2 * 19 - 5 - n)


def test_every_public_kernel_is_timed():
    """But what is a part of another: `sweeper` of `sweep`, `advancer` of `advance`."""
    timed = {case.kernel for case in bench_kernels.CASES}
    for info in pkgutil.walk_packages(kernels.__path__, "tisfm.kernels."):
        source = Path(find_spec(info.name).origin).read_text(encoding="utf-8")
        tree = ast.parse(source)
        decorated = {
            node.name.removeprefix("_")
            for node in tree.body
            if isinstance(node, ast.FunctionDef)
            and any(getattr(d, "id", "") in ("lane_kernel", "Kernel") for d in node.decorator_list)
        }
        variants = {name for name in decorated if name.endswith(("_sites", "_by_pixel", "_order"))}
        schemes = {"cube", "five_tap"} if info.name.endswith("derivatives") else {"scale"}
        assert decorated - variants - schemes <= timed, info.name
