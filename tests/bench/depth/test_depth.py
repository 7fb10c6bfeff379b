"""Depth beside two stages, and wrong focal lengths: what is computed and reported. No timing."""

import json
import os
import sys
from dataclasses import replace

import numpy as np
import pytest

import tisfm
from bench import focal
from bench.depth import __main__ as depth
from bench.depth import scores
from bench.depth.contest import run_contest
from bench.depth.methods import Estimate, FlowThenDepth, NoMotion, triangulate, two_stage
from bench.depth.pairs import (
    HAND_HELD,
    LITTLE_MOTION,
    OFFICE,
    POSE_GIVEN,
    RENDERED_ROOM,
    RENDERED_STUDIO,
    ROOM,
    ROOMS,
    SPACED,
    TWO_BLOCKS,
    Entry,
    data_entries,
    scene_entries,
)
from bench.depth.report import (
    COMMON_SUFFIX,
    STATIC,
    _count_trusted,
    details,
    groups,
    notes,
    summary,
    thresholds,
    write,
)
from bench.depth.scores import MAX_RELATIVE_DEPTH, Score, limit_depth, parallax_of, score
from bench.focal import picture
from bench.shared.contest import Call, MethodFailure
from tisfm.metrics import pose_errors
from tisfm.metrics.depth_sequence import CERTAIN_SHARE, MAX_ERROR
from tisfm.rigid import pose_matrix
from tisfm.scenes import static_scene
from tisfm.scenes.block_scenes import STATIC_KINDS

SIZE = (60, 80)
THREADS = str(os.cpu_count())  # as the tests started Taichi


@pytest.fixture(scope="module", params=STATIC_KINDS)
def scene(request):
    return static_scene(request.param, 120, 160)


def test_two_stages_on_exact_flow_give_pose_and_depth(scene):
    truth = pose_matrix(scene.motions[0])
    found = two_stage(scene.flow, scene.camera, threshold=0.01)
    errors = pose_errors(found.pose, truth)
    # As near as random sampling comes, with its last model fitted to a few points only.
    assert errors.direction < 0.2 and errors.rotation < 0.002
    assert np.linalg.norm(found.pose[:3, 3]) == pytest.approx(1)
    scaled = found.inverse_depth / np.linalg.norm(truth[:3, 3])
    np.testing.assert_allclose(scaled * scene.depth, 1, atol=0.005)


def test_triangulation_under_a_given_pose_is_exact(scene):
    truth = pose_matrix(scene.motions[0])
    found = two_stage(scene.flow, scene.camera, threshold=0.01, pose=truth)
    np.testing.assert_array_equal(found.pose, truth)
    np.testing.assert_allclose(found.inverse_depth, 1 / scene.depth, rtol=1e-6)


def test_points_beside_the_epipolar_line_move_to_its_nearest_point():
    camera = tisfm.Camera(focal=50.0)
    pose = np.eye(4)
    pose[:3, 3] = (-1, 0, 0)  # moves the scene to the left: the flow is (-f/Z, 0)
    flow = np.full((*SIZE, 2), [-5.0, 0.7])
    np.testing.assert_allclose(triangulate(flow, camera, pose), 0.1, rtol=1e-9)
    away = np.full((*SIZE, 2), [5.0, 0.7])
    np.testing.assert_allclose(triangulate(away, camera, pose), -0.1, rtol=1e-9)


def test_flow_out_of_the_image_has_no_essential_matrix():
    with pytest.raises(NoMotion, match="only 0 of"):
        two_stage(np.full((*SIZE, 2), 1e3), tisfm.Camera(focal=50.0), threshold=0.1)


def small_entries(*names):
    entries = scene_entries(*SIZE)
    return [next(entry for entry in entries if entry.name == name) for name in names]


def exact(pair, *, status="", factor=2.0, deviation=None):
    inverse_depth = factor / pair.depth
    return Estimate(
        method="a",
        seconds=1.0,
        pose=pair.pose,
        inverse_depth=inverse_depth,
        deviation=None if deviation is None else np.full(pair.depth.shape, deviation),
        status=status,
    )


def test_a_true_estimate_has_no_errors_and_one_of_known_noise_its_share_within():
    pair = small_entries("forward-f320")[0].load()
    found = score(exact(pair), pair)
    assert found.abs_rel == pytest.approx(0, abs=1e-9)
    assert found.direction == pytest.approx(0, abs=1e-9) and found.density == 1
    assert found.within is None and found.abs_rel_movers is None and found.abs_rel_raw is None
    noise = np.random.default_rng(0).normal(0, 0.01, pair.depth.shape)
    rough = replace(exact(pair, deviation=0.01), inverse_depth=2 / pair.depth + noise)
    assert score(rough, pair).within == pytest.approx(0.68, abs=0.03)
    assert score(replace(rough, deviation=rough.deviation * 3), pair).within > 0.98


def test_moving_objects_have_scales_of_their_own():
    pair = small_entries("two-blocks-0")[0].load()
    assert pair.group == TWO_BLOCKS and set(np.unique(pair.object_labels)) == {0, 2, 3}
    factors = np.select([pair.object_labels == 2, pair.object_labels == 3], [3.0, 0.5], 1.0)
    found = score(replace(exact(pair), inverse_depth=factors / pair.depth), pair)
    assert found.abs_rel > 0.1
    assert found.abs_rel_rest == pytest.approx(0, abs=1e-9)
    assert found.abs_rel_movers == pytest.approx(0, abs=1e-9)


def test_results_without_common_depth_are_failures():
    pair = small_entries("two-blocks-0")[0].load()
    behind = score(replace(exact(pair), inverse_depth=-1 / pair.depth), pair)
    assert "no depth where" in behind.failure and behind.abs_rel is None
    unknown = replace(pair, depth=np.where(pair.object_labels == 2, np.nan, pair.depth))
    found = score(exact(unknown), unknown)
    assert found.abs_rel_movers is None and not found.failure
    assert found.abs_rel_rest == pytest.approx(0, abs=1e-9)


def test_a_bug_of_the_comparison_is_no_dash(monkeypatch):
    pair = small_entries("two-blocks-0")[0].load()
    with pytest.raises(ValueError, match="shape"):
        score(replace(exact(pair), inverse_depth=1 / pair.depth[1:]), pair)
    known = scores.depth_errors

    def broken(depth, truth, mask=None):
        if mask is not None:
            raise ValueError("operands could not be broadcast")
        return known(depth, truth)

    monkeypatch.setattr(scores, "depth_errors", broken)
    with pytest.raises(ValueError, match="could not be broadcast"):
        score(exact(pair), pair)


def test_reported_absence_of_depth_is_counted_and_not_averaged():
    pair = small_entries("sideways-f300")[0].load()
    silent = replace(exact(pair, status="little_parallax"), inverse_depth=None)
    found = score(silent, pair)
    assert found.without_depth and found.abs_rel is None and found.direction is None
    assert found.rotation == pytest.approx(0, abs=1e-9)
    assert not score(exact(pair, status="converged"), pair).without_depth


def test_no_pixel_is_left_out_and_a_pair_without_depth_counts_as_one():
    pair = small_entries("sideways-f300")[0].load()
    assert score(exact(pair), pair).abs_rel_all == pytest.approx(0, abs=1e-9)
    behind = exact(pair).inverse_depth.copy()
    behind[:10] *= -1
    found = score(replace(exact(pair), inverse_depth=behind), pair)
    expected = (10 * pair.depth.max() / pair.depth[:10] - 1).sum() / pair.depth.size
    assert found.abs_rel == pytest.approx(0, abs=1e-9)
    assert found.abs_rel_all == pytest.approx(expected)
    silent = replace(exact(pair, status="little_parallax"), inverse_depth=None)
    assert score(silent, pair).abs_rel_all == 1


def test_parallax_excludes_the_rotation():
    """Of a wall at 2 m, a camera of 50 px that moves by 0.1 m: 50 · 0.1 / 2 px."""
    pose = np.eye(4)
    pose[:3, 3] = (-0.1, 0, 0)
    wall = np.full(SIZE, 2.0)
    wall[0] = np.nan
    pair = replace(
        small_entries("sideways-f300")[0].load(), depth=wall, pose=pose, camera=tisfm.Camera(50.0)
    )
    assert parallax_of(pair) == pytest.approx(2.5)
    turned = pose_matrix([-0.1, 0, 0, 0, 0.05, 0])
    assert parallax_of(replace(pair, pose=turned)) == pytest.approx(2.5, rel=0.1)
    assert parallax_of(replace(pair, pose=None)) is None


def test_the_most_certain_pixels_are_judged_in_the_unit_of_the_pose():
    pair = replace(small_entries("sideways-f300")[0].load(), pose_given=True)
    estimate = exact(pair, factor=1.0, deviation=0.1)
    certain = np.zeros(pair.depth.shape, bool)
    certain.ravel()[: round(CERTAIN_SHARE * certain.size)] = True
    estimate.inverse_depth[...] = np.where(certain, 0.8 / pair.depth, 0.01 / pair.depth)
    estimate.deviation[...] = np.where(certain, 1e-6, 1e-3) * estimate.inverse_depth
    assert score(estimate, pair).abs_rel_certain == pytest.approx(0.25)
    estimate.deviation[...] = np.where(certain, 1e-3, 1e-6) * estimate.inverse_depth
    wrong = score(estimate, pair).abs_rel_certain
    assert wrong == pytest.approx(MAX_ERROR, rel=1e-6)  # each pixel's error is limited
    assert score(estimate, replace(pair, pose_given=False)).abs_rel_certain is None


def test_statuses_are_compared_with_errors():
    def of(status, error, parallax):
        return Score(
            method="a", pair="p", group="g", status=status, abs_rel_all=error, parallax=parallax
        )

    scores = [
        of("converged", 0.6, 5.0),
        of("converged", 0.4, 1.0),
        of("diverged", 0.9, 4.0),
        of("little_parallax", 1.0, 3.5),
        of("little_parallax", 1.0, 2.5),
    ]
    assert _count_trusted(scores) == ("1 of 5", "2 of 3")
    assert _count_trusted([replace(scores[0], status="")]) == ("–", "–")


def test_the_rooms_are_there_with_and_without_their_pose(shared_data):
    entries, _ = data_entries(shared_data)
    for group, count in ((ROOM, 7), (OFFICE, 11), (SPACED, 16)):
        for given in (POSE_GIVEN, ""):
            mine = [entry for entry in entries if entry.group == group + given]
            assert len(mine) == count
            pair = mine[0].load()
            assert pair.pose_given == bool(given) and pair.camera.is_pinhole
            assert np.nanmax(pair.depth) <= 40 and parallax_of(pair) > 0
    names = [entry.name for entry in entries]
    assert len(set(names)) == len(names)


def test_limited_depth_has_neither_gaps_nor_depths_beyond_the_horizon():
    depth_map = np.array([[1.0, 1.0, 1.0], [np.nan, 1e6, 2.0]])
    np.testing.assert_array_equal(
        limit_depth(depth_map), [[1, 1, 1], [MAX_RELATIVE_DEPTH, MAX_RELATIVE_DEPTH, 2]]
    )


class TrueFlow:
    """The true flow of a scene with some noise, in a made-up time."""

    name = "true"

    def __init__(self, flows, noise):
        self.flows, self.noise = flows, noise

    def run(self, pair):
        flow = self.flows.get(pair.name)
        if flow is None:
            flow = static_scene("sideways+rotation", *pair.size).flow
        noise = np.random.default_rng(0).normal(0, self.noise, flow.shape)
        return Call(flow=flow + noise, seconds=2.0, cpu=2.0)


class Broken:
    name = "broken"

    def __init__(self, on):
        self.on = on

    def run(self, pair):
        if pair.name in self.on:
            raise MethodFailure("its process died")
        return [replace(exact(pair), method=self.name)]


def true_flow():
    flows = {
        f"{kind}-f320": static_scene(kind, *SIZE, seed=1, focal=80.0).flow for kind in STATIC_KINDS
    }
    return TrueFlow(flows, 0.02)


def contest(methods, *names, rounds=1):
    return run_contest(
        methods, small_entries(*names), rounds=rounds, conditions={"x": 1}, missing={}
    )


def test_every_threshold_is_scored_from_one_flow_and_the_best_is_reported(tmp_path):
    pipeline = FlowThenDepth(true_flow(), thresholds=(0.02, 20.0))
    held = contest([pipeline], "forward-f320", "sideways-f320", rounds=2)
    assert held.thresholds(pipeline.name) == [0.02, 20.0]
    assert {len(held.best(pipeline.name, group)) for group in held.groups} == {1}
    errors = [np.prod(held.typical_errors(pipeline.name, t)) for t in (0.02, 20.0)]
    assert held.best_threshold(pipeline.name) == (0.02, 20.0)[int(np.argmin(errors))]
    first = held.scores[0]
    assert first.flow_seconds == 2.0 < first.seconds
    write(held, tmp_path / "out", remarks=["a remark"])
    text = (tmp_path / "out.md").read_text(encoding="utf-8")
    assert "- a remark" in text and "## Thresholds of the essential matrix" in text
    record = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert len(record["scores"]) == 4
    assert record["best_thresholds"] == {pipeline.name: held.best_threshold(pipeline.name)}
    assert len(thresholds(held).rows) == 2


def test_all_static_scenes_are_summed_up_together():
    pipeline = FlowThenDepth(true_flow(), thresholds=(0.02,))
    held = contest([pipeline], "forward-f320", "sideways-f320")
    together = groups(held)[0]
    assert together.name == STATIC and len(together.pairs) == 2
    assert list(details(held)) == [STATIC, "scenes, forward", "scenes, sideways"]
    mean = np.mean([s.abs_rel for s in held.scores])
    assert summary(held).rows[0][1] == f"{mean:.4f}"


def test_failures_are_reported_and_cost_one_pair():
    held = contest([Broken(["forward-f320"])], "forward-f320", "sideways-f320")
    assert held.failures() == {"broken on forward-f320": "its process died"}
    row = details(held)[STATIC].rows[0]
    assert row[1] == "0.0000" and "–, 1 failed" in row
    assert contest([Broken([]), Broken(["warm-up"])], "sideways-f320").missing == {
        "broken": "its process died"
    }
    with pytest.raises(ValueError, match="no method can run: broken: its process died"):
        contest([Broken(["warm-up"])], "sideways-f320")


class Silent:
    name = "silent"

    def run(self, pair):
        status = "little_parallax" if pair.name == "forward-f320" else "converged"
        found = exact(pair, status=status)
        found = replace(found, method=self.name)
        return [replace(found, inverse_depth=None) if status == "little_parallax" else found]


def test_pairs_without_depth_are_named():
    pipeline = FlowThenDepth(true_flow(), thresholds=(0.02,))
    held = contest([Silent(), pipeline], "forward-f320", "forward-f300", "sideways-f320")
    assert [group.name for group in groups(held)][:2] == [STATIC, STATIC + COMMON_SUFFIX]
    assert groups(held)[1].pairs == ("forward-f300", "sideways-f320")
    mean = np.mean([s.abs_rel for s in held.scores if s.method == pipeline.name][1:])
    assert summary(held).rows[1][1] == f"{mean:.4f}"  # over the pairs that both have
    assert "1 of 3" in details(held)[STATIC].rows[0]
    assert any("silent: forward-f320 (little_parallax)" in note for note in notes(held))


@pytest.mark.nightly
def test_smoke_of_the_comparison(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(depth, "RESULTS", tmp_path)
    options = ["--smoke", "--preset", "fast", "--threads", THREADS]
    chosen = ["--pairs", "forward-f320", "two-blocks-0", "--methods", "fast", "DIS"]
    assert depth.main([*options, *chosen, "--remark", "a noisy machine"]) == 0
    printed = capsys.readouterr().out
    assert "tisfm fast, camera" in printed and "OpenCV DIS medium + essential matrix" in printed
    assert {path.name for path in tmp_path.iterdir()} == {"smoke-depth.md", "smoke-depth.json"}
    text = (tmp_path / "smoke-depth.md").read_text(encoding="utf-8")
    assert "- command: `python -m bench.depth --preset fast" in text
    assert "\n- a noisy machine\n" in text
    assert "moving objects, mean" in text and "within σ, %" in text and "time / field" in text
    assert sys.prefix not in text


def test_a_method_without_a_name_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(depth, "RESULTS", tmp_path)
    options = ["--smoke", "--threads", THREADS, "--pairs", "forward-f320", "--methods", "nothing"]
    assert depth.main([*options, "--peer-python", "no-such-python"]) == 2
    assert "no method has nothing in its name" in capsys.readouterr().err


@pytest.mark.nightly
def test_without_the_peers_interpreter_own_rows_are_left_and_one_line_says_why(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(depth, "RESULTS", tmp_path)
    options = ["--smoke", "--preset", "fast", "--threads", THREADS, "--pairs", "forward-f320"]
    assert depth.main([*options, "--peer-python", "no-such-python"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (missing,) = [line for line in lines if line.startswith("missing: all peers")]
    assert "no-such-python does not run peer_worker.py" in missing
    record = json.loads((tmp_path / "smoke-depth.json").read_text(encoding="utf-8"))
    assert record["methods"] == ["tisfm fast, camera", "tisfm fast + essential matrix"]
    assert depth.main([*options, "--methods", "nothing"]) == 2
    assert "no method has nothing in its name" in capsys.readouterr().err


def test_the_pairs_are_those_of_every_group(shared_data):
    entries, missing = data_entries(shared_data)
    assert not missing
    count = {
        name: sum(entry.group == name for entry in entries) for name in (HAND_HELD, TWO_BLOCKS)
    }
    assert count == {HAND_HELD: 16, TWO_BLOCKS: 0}
    assert sum(entry.group == RENDERED_STUDIO for entry in entries) == 25
    first = next(entry for entry in entries if entry.group == LITTLE_MOTION).load()
    assert first.depth.shape == first.raw_depth.shape == first.frame0.shape[:2]
    assert not first.pose_given and first.pose.shape == (4, 4)
    stereo = next(entry for entry in entries if entry.name == "cones").load()
    assert stereo.pose_given and stereo.raw_depth is None


def test_missing_groups_are_named(tmp_path):
    entries, missing = data_entries(tmp_path)
    assert not entries
    assert missing[HAND_HELD] == "none of its frames in sevenscenes"
    assert any("left.png" in reason for reason in missing.values())


def test_scenes_are_rendered_when_their_turn_comes_at_the_focal_length_of_their_name():
    entries = scene_entries(*SIZE)
    assert len(entries) == 22 and all(isinstance(entry, Entry) for entry in entries)
    pair = next(entry for entry in entries if entry.name == "sideways-f600").load()
    assert pair.camera.focal == 600 * SIZE[1] / 320  # the same view
    rooms = [entry.load() for entry in entries if entry.group.startswith(RENDERED_ROOM)]
    assert [pair.pose_given for pair in rooms] == [True, False] * 2
    assert {pair.group for pair in rooms} <= set(ROOMS)


@pytest.mark.nightly
def test_wrong_focal_lengths(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(focal, "FOCALS", (600.0,))
    monkeypatch.setattr(focal, "RATIOS", (1.0, 5 / 3))
    monkeypatch.setattr(focal, "STATIC_KINDS", ("forward", "forward+rotation"))
    size = ["--height", "90", "--width", "120", "--preset", "fast", "--threads", THREADS]
    monkeypatch.setattr(focal, "RESULTS", tmp_path)
    assert focal.main([*size]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"focal.md", "focal.json", "focal.png"}
    text = (tmp_path / "focal.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out.strip() in text
    assert "1000 px assumed for true 600 px: abs-rel is at most 20% worse in" in text
    record = json.loads((tmp_path / "focal.json").read_text(encoding="utf-8"))
    assert len(record["found"]) == 4
    exact_depth = {(o["kind"], o["ratio"]): o["exact_abs_rel"] for o in record["found"]}
    assert exact_depth["forward", 5 / 3] < 0.002 < exact_depth["forward+rotation", 5 / 3]
    figure = picture(record["found"])
    assert len(figure.axes) == 4 and all(len(axes.lines) == 3 for axes in figure.axes)


def test_a_constant_added_to_inverse_depth_is_found():
    truth = np.random.default_rng(0).uniform(0.1, 0.3, SIZE)
    found = focal.offset_of(4 * (truth - 0.05), truth)
    assert found == pytest.approx(-0.05 / np.median(truth))
