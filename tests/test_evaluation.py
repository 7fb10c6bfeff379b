"""Evaluation: the numbers are those of the metrics, and what is promised is written whole."""

import io
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import tisfm
from tisfm import evaluation, evaluation_outputs
from tisfm.datasets import find_pairs
from tisfm.evaluation import PairEvaluation, evaluate, mean_errors
from tisfm.evaluation_outputs import EvaluationWriter
from tisfm.evaluation_table import evaluation_tables
from tisfm.formats import read_flo, read_image, write_flo, write_kitti_flow, write_png
from tisfm.metrics import (
    FlowErrors,
    OcclusionScores,
    angular_error,
    endpoint_error,
    endpoint_error_map,
    occlusion_scores,
    outlier_rate,
)
from tisfm.occlusion import leaves_image
from tisfm.scenes import static_scene

H, W = 40, 56
SCENES = [static_scene("sideways", H, W, seed=seed) for seed in (0, 1)]
FAST = tisfm.Settings.preset("fast", outer_iterations=3, warps=1)
HOLE = np.zeros((H, W), bool)
HOLE[5:12, 9:20] = True


def put(path: Path, data: np.ndarray, write: Callable = write_png) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, data)


@pytest.fixture(autouse=True)
def coarse_pictures(monkeypatch):
    """Draw with few pixels, which is what takes the time here."""
    monkeypatch.setattr(evaluation_outputs, "_DPI", 60)


@pytest.fixture
def data(tmp_path):
    """Two Middlebury pairs, one of KITTI and one of Yosemite's."""
    folder = tmp_path / "data"
    for name, scene in zip(("A", "B"), SCENES, strict=True):
        put(folder / "mid" / name / "frame10.png", scene.frame0)
        put(folder / "mid" / name / "frame11.png", scene.frame1)
        flow = np.where(HOLE[..., None], 1e10, scene.flow)
        put(folder / "mid" / name / "flow10.flo", flow, write_flo)
    scene = SCENES[0]
    road = folder / "road" / "training"
    colour = [np.dstack([frame] * 3) for frame in (scene.frame0, scene.frame1)]
    put(road / "image_2" / "000003_10.png", colour[0])
    put(road / "image_2" / "000003_11.png", colour[1])
    put(road / "flow_occ" / "000003_10.png", scene.flow, write_kitti_flow)
    visible = np.where(scene.visible[..., None], scene.flow, np.nan)
    put(road / "flow_noc" / "000003_10.png", visible, write_kitti_flow)
    put(road / "calib" / "000003.txt", None, lambda path, _: path.write_text(CALIBRATION))
    put(folder / "valley" / "yos9.png", scene.frame0)
    put(folder / "valley" / "yos10.png", scene.frame1)
    put(folder / "valley" / "flow09.flo", scene.flow, write_flo)
    put(folder / "valley" / "sky_mask.png", HOLE.astype(np.uint8))
    return folder


CALIBRATION = "P2: 56 0 27.5 0 0 56 19.5 0 0 0 1 0\n"
LABELS = ["mid/A", "mid/B", "road/000003", "valley/yos9"]
FILES = {"mid/A", "mid/B", "road/000003", "valley/yos9"}


def written(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file()
    }


def promised(*stems):
    endings = ("_flow.flo", "_flow.png", "_error.png")
    return {stem + ending for stem in stems for ending in endings} | {"eval.json"}


def record(folder):
    return json.loads((folder / "eval.json").read_text(encoding="utf-8"))


def evaluate_to(folder, data, **options):
    writer = EvaluationWriter(folder, camera=options.get("camera"), settings=FAST)
    result = evaluate(find_pairs(data), settings=FAST, on_pair=writer.write, **options)
    writer.finish(result)
    return result


# Numbers


def test_errors_are_those_of_the_metrics(data):
    result = evaluate(find_pairs(data), settings=FAST)
    assert [pair.label for pair in result.pairs] == LABELS
    assert result.settings == FAST and result.faults == []
    for found in result.pairs:
        loaded = found.pair.load()
        expected = tisfm.interpret(loaded.frame0, loaded.frame1, camera=found.camera, settings=FAST)
        assert found.status == expected.status and found.message == expected.status.message
        assert found.size == (H, W) and found.seconds > 0
        masks = {"errors": None, "visible": loaded.occlusion, "without_sky": loaded.sky}
        for name, excluded in masks.items():
            errors = getattr(found, name)
            if name != "errors" and excluded is None:
                assert errors is None
                continue
            mask = None if excluded is None else ~excluded
            arguments = (expected.flow, loaded.flow)
            assert errors.endpoint == pytest.approx(endpoint_error(*arguments, mask=mask))
            assert errors.angular == pytest.approx(angular_error(*arguments, mask=mask))
            assert errors.outliers == outlier_rate(*arguments, mask=mask)
            error = endpoint_error_map(*arguments, mask=mask)
            assert errors.pixels == np.isfinite(error).sum()
            assert errors.over_one == (error[np.isfinite(error)] >= 1).mean()
    assert [bool(pair.visible) for pair in result.pairs] == [False, False, True, False]
    assert [bool(pair.without_sky) for pair in result.pairs] == [False, False, False, True]
    assert 0 < result.pairs[0].errors.endpoint < 0.5


def test_the_camera_is_the_stated_one_unless_another_is_given(data):
    stated = evaluate(find_pairs(data), settings=FAST)
    assert [pair.camera for pair in stated.pairs] == [
        tisfm.Camera(), tisfm.Camera(), tisfm.Camera(56, (27.5, 19.5)), tisfm.Camera()
    ]  # fmt: skip
    camera = tisfm.Camera(70, (20, 20))
    given = evaluate(find_pairs(data), settings=FAST, camera=camera)
    assert {pair.camera for pair in given.pairs} == {camera}
    assert given.pairs[0].errors != stated.pairs[0].errors


def test_settings_reach_the_result(data):
    pairs = find_pairs(data / "mid")[:1]
    errors = [
        evaluate(pairs, settings=settings).pairs[0].errors
        for settings in (None, FAST, tisfm.Settings.preset("paper"))
    ]
    assert len({error.endpoint for error in errors}) == 3
    assert errors[0] == evaluate(pairs, settings=tisfm.Settings()).pairs[0].errors


def test_means_are_over_pairs(data):
    result = evaluate(find_pairs(data), settings=FAST)
    means = result.dataset_means
    assert list(means) == ["mid", "road", "valley"]
    first, second, road, valley = result.pairs
    for name in ("endpoint", "angular", "outliers", "over_one"):
        pair = [getattr(found.errors, name) for found in result.pairs]
        assert getattr(means["mid"].errors, name) == pytest.approx(np.mean(pair[:2]))
        assert getattr(result.mean.errors, name) == pytest.approx(np.mean(pair))
    assert means["mid"].errors.pixels == first.errors.pixels + second.errors.pixels
    assert means["mid"].seconds == pytest.approx((first.seconds + second.seconds) / 2)
    assert (means["mid"].pairs, result.mean.pairs) == (2, 4)
    assert means["road"].visible == road.visible
    assert means["valley"].without_sky == valley.without_sky
    # Over other pairs than the errors: not to be compared with them.
    assert result.mean.visible is None and result.mean.without_sky is None


def test_occlusion_is_compared_where_the_truth_is_known(data):
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    loaded = found.pair.load()
    ours = tisfm.interpret(loaded.frame0, loaded.frame1, camera=found.camera, settings=FAST)
    known = np.isfinite(loaded.flow).all(axis=-1)
    leaves = leaves_image(np.moveaxis(loaded.flow, -1, 0))
    truth = loaded.occlusion | leaves
    assert found.occlusion == occlusion_scores(ours.occlusion, truth, mask=known)
    assert 0 < found.occlusion.f1 <= 1
    noc = data / "road" / "training" / "flow_noc" / "000003_10.png"
    write_kitti_flow(noc, loaded.flow)  # as if the dataset did not count what leaves the image
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    assert found.occlusion == occlusion_scores(ours.occlusion, leaves, mask=known)
    write_kitti_flow(noc.parents[1] / "flow_occ" / noc.name, 0 * loaded.flow)
    write_kitti_flow(noc, 0 * loaded.flow)
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    assert found.occlusion == occlusion_scores(ours.occlusion, 0 * leaves, mask=known)
    assert found.occlusion.occluded == found.occlusion.hits == 0 < found.occlusion.marked


def test_occlusion_of_a_dataset_counts_false_alarms_where_nothing_is_occluded():
    def scored(hits, marked, occluded):
        scores = OcclusionScores.from_counts(
            hits=hits, marked=marked, occluded=occluded, pixels=1000
        )
        errors = FlowErrors(endpoint=1.0, angular=1.0, outliers=0.0, over_one=0.0, pixels=1000)
        return PairEvaluation(pair=None, seconds=1.0, errors=errors, occlusion=scores)

    found, nothing_there = scored(hits=60, marked=80, occluded=100), scored(0, 40, 0)
    mean = mean_errors([found, nothing_there]).occlusion
    assert (mean.hits, mean.marked, mean.occluded, mean.pixels) == (60, 120, 100, 2000)
    assert mean.precision == 0.5 and mean.recall == 0.6
    assert mean.f1 == pytest.approx(120 / 220)
    assert mean.f1 < found.occlusion.f1
    assert mean_errors([found, replace(nothing_there, occlusion=None)]).occlusion is None


def test_a_pair_that_is_all_occluded_has_no_visible_errors(data):
    visible = np.full((H, W, 2), np.nan)
    write_kitti_flow(data / "road" / "training" / "flow_noc" / "000003_10.png", visible)
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    assert found.visible is None and found.errors is not None


def test_a_pair_given_twice_counts_once(data):
    pairs = find_pairs(data / "mid")
    result = evaluate([*pairs, *find_pairs(data)[:2]], settings=FAST)
    assert [pair.label for pair in result.pairs] == LABELS[:2]


def test_no_time_includes_compiling(data, monkeypatch):
    """A small pair of the same type and channels is interpreted first."""
    seen = []
    original = evaluation.interpret

    def spy(frame0, frame1, **options):
        seen.append((frame0.shape, frame0.dtype, options["settings"]))
        return original(frame0, frame1, **options)

    monkeypatch.setattr(evaluation, "interpret", spy)
    evaluate(find_pairs(data), settings=FAST)
    grey, colour = (H, W), (H, W, 3)
    assert [shape for shape, _, _ in seen] == [(64, 64), grey, grey, (64, 64, 3), colour, grey]
    assert {(dtype, settings) for _, dtype, settings in seen} == {(np.dtype(np.uint8), FAST)}


@pytest.mark.parametrize(
    ("options", "message"),
    [({"camera": 600.0}, "camera is 600.0: expected a tisfm.Camera"),
     ({"settings": "fast"}, "settings is 'fast': expected a tisfm.Settings")],
)  # fmt: skip
def test_options_are_checked(options, message):
    with pytest.raises(TypeError, match=message):
        evaluate([], **options)


# Faults


@pytest.mark.parametrize("name", ["frame10.png", "frame11.png", "flow10.flo"])
def test_a_fault_of_one_pair_does_not_lose_the_others(data, tmp_path, name):
    path = data / "mid" / "A" / name
    path.write_bytes(path.read_bytes()[:50])
    result = evaluate_to(tmp_path / "out", data / "mid")
    assert [pair.label for pair in result.faults] == ["mid/A"]
    assert str(path) in result.faults[0].fault and "cut off" in result.faults[0].fault
    assert result.faults[0].errors is None
    assert result.mean.pairs == 1
    assert result.dataset_means["mid"].errors == result.pairs[1].errors
    assert set(written(tmp_path / "out")) == promised("mid/B")
    about = record(tmp_path / "out")["pairs"][0]
    assert about["fault"] == result.faults[0].fault
    assert about["errors"] is None and about["outputs"] is None


def test_nothing_left_to_average(data):
    for path in data.rglob("*10.png"):
        path.write_bytes(b"nothing")
    result = evaluate(find_pairs(data / "mid"), settings=FAST)
    assert len(result.faults) == 2
    assert result.mean is None and result.dataset_means == {"mid": None}


def test_flow_that_is_not_finite_is_a_fault(data, monkeypatch):
    original = evaluation.interpret

    def broken(*arguments, **options):
        result = original(*arguments, **options)
        result.flow[3, 4] = np.nan
        return result

    monkeypatch.setattr(evaluation, "interpret", broken)
    result = evaluate(find_pairs(data / "mid"), settings=FAST)
    assert all("flow is not finite at 1 of" in pair.fault for pair in result.pairs)


# Files


def test_the_promised_files(data, tmp_path):
    result = evaluate_to(tmp_path / "out", data)
    assert set(written(tmp_path / "out")) == promised(*FILES)
    for found in result.pairs:
        loaded = found.pair.load()
        stem = tmp_path / "out" / found.label
        flow = read_flo(f"{stem}_flow.flo")
        assert endpoint_error(flow, loaded.flow) == pytest.approx(found.errors.endpoint)
        for ending in ("flow", "error"):
            picture = read_image(f"{stem}_{ending}.png")
            assert picture.ndim == 3 and picture.shape[1] > 200
    grey = read_image(tmp_path / "out" / "mid" / "A_error.png") == 128
    assert grey.all(axis=2).mean() > 0.3 * HOLE.mean()


def test_the_record_holds_every_number(data, tmp_path):
    result = evaluate_to(tmp_path / "out", data)
    about = record(tmp_path / "out")
    assert about["complete"] is True
    assert about["version"] == tisfm.__version__
    assert set(about["versions"]) == {"python", "numpy", "taichi", "opencv-python-headless"}
    assert about["threads"] >= 1 and about["camera"] is None
    assert tisfm.Settings(**about["settings"]) == FAST
    for entry, found in zip(about["pairs"], result.pairs, strict=True):
        assert f"{entry['dataset']}/{entry['name']}" == found.label == entry["outputs"]
        for name in ("errors", "visible", "without_sky", "occlusion"):
            expected = getattr(found, name)
            assert entry[name] == (None if expected is None else asdict(expected))
        assert entry["seconds"] == found.seconds
        assert entry["size"] == [H, W]
        assert entry["status"] == found.status
        assert Path(entry["inputs"]["truth"]) == found.pair.truth
        assert Path(entry["inputs"]["frame1"]) == found.pair.frame1
    assert FlowErrors(**about["mean"]["errors"]) == result.mean.errors
    assert {name: mean["pairs"] for name, mean in about["dataset_means"].items()} == {
        "mid": 2, "road": 1, "valley": 1
    }  # fmt: skip


def test_pairs_of_one_name_do_not_overwrite_each_other(data, tmp_path):
    (data / "again").mkdir()
    (data / "mid").rename(data / "again" / "mid")
    (data / "road").rename(data / "mid")
    (data / "mid" / "training").rename(data / "mid" / "A")
    pairs = [pair for pair in find_pairs(data) if pair.layout == "middlebury"]
    twin = tmp_path / "other" / "mid" / "a"  # the same, where file names ignore case
    twin.parent.mkdir(parents=True)
    (data / "again" / "mid" / "B").rename(twin)
    writer = EvaluationWriter(tmp_path / "out", camera=None, settings=FAST)
    evaluate([*pairs[:1], *find_pairs(twin)], settings=FAST, on_pair=writer.write)
    assert set(written(tmp_path / "out")) == promised("mid/A", "mid/a_2")


def test_names_stay_within_the_folder(data, tmp_path):
    (pair,) = find_pairs(data / "mid" / "A")
    wild = type(pair)(**{**vars(pair), "dataset": "../x y", "name": "../../é/?z"})
    writer = EvaluationWriter(tmp_path / "out", camera=None, settings=FAST)
    evaluate([wild], settings=FAST, on_pair=writer.write)
    (entry,) = record(tmp_path / "out")["pairs"]
    assert entry["name"] == "../../é/?z"
    assert set(written(tmp_path / "out")) == promised(entry["outputs"])
    assert not {path.name for path in tmp_path.iterdir()} - {"data", "out"}


@pytest.mark.parametrize("step", ["interpret", "write_flo", "save_figure", "rename"])
def test_what_an_interruption_leaves_is_complete(data, tmp_path, monkeypatch, step):
    """Ctrl-C at the second pair: the record holds the first, and every file there is whole."""
    evaluate_to(tmp_path / "whole", data / "mid")
    module = evaluation if step == "interpret" else evaluation_outputs
    name = "atomic_write" if step == "rename" else step
    original, calls = getattr(module, name), []
    # One warm-up and one pair; one flow; two figures; the empty record and that of one pair.
    before = {"interpret": 2, "write_flo": 1, "save_figure": 3, "rename": 2}[step]

    def interrupted(*arguments, **options):
        calls.append(1)
        if len(calls) > before:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    monkeypatch.setattr(module, name, interrupted)
    with pytest.raises(KeyboardInterrupt):
        evaluate_to(tmp_path / "out", data / "mid")
    left, whole = written(tmp_path / "out"), written(tmp_path / "whole")
    assert set(left) <= set(whole)
    for name in set(left) - {"eval.json"}:
        assert left[name] == whole[name], name
    about = record(tmp_path / "out")
    assert about["complete"] is False and about["mean"] is None
    assert [entry["name"] for entry in about["pairs"]] == ["A"]


def test_the_record_of_an_earlier_evaluation_does_not_stay(data, tmp_path):
    evaluate_to(tmp_path / "out", data / "valley")
    EvaluationWriter(tmp_path / "out", camera=tisfm.Camera(5.0), settings=tisfm.Settings())
    about = record(tmp_path / "out")
    assert about["pairs"] == [] and about["complete"] is False
    assert about["camera"] == {"focal": 5.0, "center": None}


def test_a_picture_that_cannot_be_written_is_a_fault(data, tmp_path, monkeypatch):
    original = evaluation_outputs.write_flo

    def full(path, flow):
        if "B_flow" in str(path):
            raise OSError(28, "No space left on device")
        original(path, flow)

    monkeypatch.setattr(evaluation_outputs, "write_flo", full)
    result = evaluate_to(tmp_path / "out", data / "mid")
    (fault,) = result.faults
    assert fault.label == "mid/B" and "No space left on device" in fault.fault
    assert [entry["fault"] is None for entry in record(tmp_path / "out")["pairs"]] == [
        True, False
    ]  # fmt: skip


# The table


def printed(result, width=110, table=0):
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(evaluation_tables(result)[table])
    rows = [line for line in console.export_text().splitlines() if line.startswith("│")]
    return [[cell.strip() for cell in row.strip("│").split("│")] for row in rows]


def test_the_table(data):
    result = evaluate(find_pairs(data), settings=FAST)
    rows = printed(result)
    assert [row[0] for row in rows] == [
        "mid/A", "mid/B", "mid, mean of 2", "road/000003", "valley/yos9", "all, mean of 4"
    ]  # fmt: skip
    for row, found in zip([*rows[:2], *rows[3:5]], result.pairs, strict=True):
        errors = found.errors
        assert row[1:5] == [
            f"{errors.endpoint:.3f}",
            f"{errors.angular:.2f}",
            f"{100 * errors.outliers:.2f}",
            f"{100 * errors.over_one:.2f}",
        ]
        assert row[5] == (f"{found.visible.endpoint:.3f}" if found.visible else "–")
        assert row[6] == (f"{found.without_sky.endpoint:.3f}" if found.without_sky else "–")
        assert row[7] == (f"{100 * found.occlusion.f1:.1f}" if found.occlusion else "–")
        assert row[8] == f"{found.seconds:.2f}"
    assert [bool(found.occlusion) for found in result.pairs] == [False, False, True, False]
    assert rows[-1][1] == f"{result.mean.errors.endpoint:.3f}"


def test_the_table_has_no_empty_columns(data):
    (data / "mid" / "A" / "frame10.png").unlink()
    rows = printed(evaluate(find_pairs(data / "mid"), settings=FAST))
    assert [row[0] for row in rows] == ["mid/A (failed)", "mid/B", "mid, mean of 1"]
    assert rows[0][1:] == ["–"] * 5
    assert rows[1][1:] == rows[2][1:]


def test_names_are_no_markup(data):
    (pair,) = find_pairs(data / "mid" / "A")
    odd = type(pair)(**{**vars(pair), "dataset": "[red]set[/red]"})
    result = evaluation.Evaluation(
        settings=FAST, pairs=(PairEvaluation(pair=odd, fault="no file"),)
    )
    assert printed(result)[0][0] == "[red]set[/red]/A (failed)"


# Real datasets


def test_the_default_preset_on_a_real_pair(shared_data):
    (found,) = evaluate(find_pairs(shared_data / "middlebury" / "RubberWhale")).pairs
    assert found.errors.endpoint < 0.25
    assert found.errors.pixels == pytest.approx(0.984 * 388 * 584, rel=1e-3)
