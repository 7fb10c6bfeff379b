"""Evaluation: the numbers are those of the metrics, and what is promised is written whole."""

import io
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import tisfm
from tisfm import evaluation, evaluation_outputs
from tisfm.datasets import find_pairs
from tisfm.egomotion import camera_motion
from tisfm.evaluation import PairEvaluation, evaluate, mean_errors
from tisfm.evaluation_outputs import EvaluationWriter
from tisfm.evaluation_table import evaluation_tables
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.formats import read_flo, read_image, write_flo, write_kitti_flow, write_png
from tisfm.interpretation import Status
from tisfm.metrics import (
    DepthErrors,
    FlowErrors,
    OcclusionScores,
    PoseErrors,
    angular_error,
    depth_errors,
    endpoint_error,
    endpoint_error_map,
    occlusion_scores,
    outlier_rate,
    pose_errors,
)
from tisfm.occlusion import leaves_image
from tisfm.rigid import pose_matrix
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


def evaluate_to(folder, data, *, settings=FAST, **options):
    writer = EvaluationWriter(folder, camera=options.get("camera"), settings=settings)
    result = evaluate(find_pairs(data), settings=settings, on_pair=writer.write, **options)
    writer.finish(result)
    return result


@pytest.fixture
def sequences(tmp_path):
    """Three frames of New Tsukuba and six of 7-Scenes' layout, and a stereo pair."""
    folder = tmp_path / "sequences"
    scene = SCENES[0]
    frames = [scene.frame0, scene.frame1]
    poses = [np.linalg.matrix_power(np.linalg.inv(MOTION), k) for k in range(6)]
    for k in range(3):
        put(folder / "lab" / f"rgb_{k:05d}.png", frames[k % 2])
    rows = "\n".join(" ".join(map(str, pose[:3].ravel())) for pose in poses)
    (folder / "lab" / "poses_camera_to_world_3x4_cm.txt").write_text(rows)
    for k, pose in enumerate(poses):
        stem = folder / "chess" / f"frame-{k:06d}"
        put(Path(f"{stem}.color.png"), frames[k % 2])
        put(Path(f"{stem}.depth.png"), np.rint(500 * scene.depth).astype(np.uint16))
        np.savetxt(f"{stem}.pose.txt", pose)
    put(folder / "two" / "block_left.png", scene.frame0)
    put(folder / "two" / "block_right.png", scene.frame1)
    disparity = np.where(HOLE, np.nan, -scene.flow[..., 0]).astype(np.float32)
    put(folder / "two" / "block_disp.npy", disparity, np.save)
    return folder


MOTION = pose_matrix(SCENES[0].motions[0])
SEQUENCE_LABELS = [
    "chess/frame-000000", "chess/frame-000001", "chess/frame-000002",
    "lab/rgb_00000", "lab/rgb_00001", "two/block",
]  # fmt: skip


@pytest.fixture
def camera_results(monkeypatch):
    """Lists of the poses that were given to interpretations, and of what these say.

    Of the latter motion, depth and status are put in, for each pair in order.
    """
    asked, given = [], []
    original = evaluation.interpret

    def interpret(frame0, frame1, *, camera=None, settings, pose=None):
        plain = replace(settings, motion="field")
        result = original(frame0, frame1, camera=camera, settings=plain)
        if frame0.shape[0] == 64:  # the pair that warms up
            return result
        asked.append(pose)
        motion, depth, status = given[len(asked) - 1]
        return SimpleNamespace(
            flow=result.flow,
            occlusion=result.occlusion,
            depth=np.broadcast_to(np.float32(depth), frame0.shape[:2]),
            motions=np.array([motion]),
            status=Status(status, "a word of advice"),
        )

    monkeypatch.setattr(evaluation, "interpret", interpret)
    return asked, given


def camera_settings():
    """Settings of one motion of the camera."""
    return replace(FAST, motion="camera")


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


# Depth and pose


def test_depth_errors_are_those_of_the_metrics(sequences):
    result = evaluate(find_pairs(sequences), settings=FAST)
    assert [pair.label for pair in result.pairs] == SEQUENCE_LABELS and not result.faults
    for found in result.pairs:
        loaded = found.pair.load()
        expected = tisfm.interpret(loaded.frame0, loaded.frame1, camera=found.camera, settings=FAST)
        if loaded.depth is not None:
            assert found.depth == depth_errors(expected.depth, loaded.depth)
        if loaded.flow is not None:
            assert found.errors.endpoint == endpoint_error(expected.flow, loaded.flow)
        assert found.pose is None and not found.without_depth
    assert [bool(pair.depth) for pair in result.pairs] == [True] * 3 + [False] * 2 + [True]
    assert [bool(pair.errors) for pair in result.pairs] == [False] * 5 + [True]
    assert 0 < result.pairs[-1].depth.abs_rel < 0.2
    assert [pair.camera.focal for pair in result.pairs] == pytest.approx(
        [525 * W / 640] * 3 + [615 * W / 640] * 2 + [600]
    )


def test_means_of_depth_are_over_pairs_with_depth(sequences):
    result = evaluate(find_pairs(sequences), settings=FAST)
    chess = [pair.depth for pair in result.pairs[:3]]
    means = result.dataset_means
    assert means["lab"].depth is None and means["lab"].errors is None and means["lab"].pairs == 2
    found = means["chess"].depth
    assert (found.pairs, found.without_depth) == (3, 0)
    for name in ("abs_rel", "silog", "delta1", "density", "scale"):
        values = [getattr(errors, name) for errors in chess]
        assert getattr(found.mean, name) == pytest.approx(np.mean(values))
        assert getattr(found.median, name) == np.median(values)
    assert result.mean.depth.pairs == 4 and result.mean.pairs == 6
    assert result.mean.flow_pairs == 1 and result.mean.errors == result.pairs[-1].errors
    assert result.mean.pose is None


def test_poses_are_compared(sequences, camera_results):
    _, given = camera_results
    twist = SCENES[0].motions[0] / np.linalg.norm(SCENES[0].motions[0, :3])
    opposite = twist * [-1, -1, -1, 1, 1, 1]
    turned = twist + np.radians([0, 0, 0, 0, 2, 0])
    given += [(motion, 2.0, "converged") for motion in (twist, opposite, turned)]
    result = evaluate(find_pairs(sequences / "chess", step=1)[:3], settings=camera_settings())
    first, second, third = (pair.pose for pair in result.pairs)
    # That the twists are longer than those of the frames does not count.
    assert first.direction == pytest.approx(0, abs=1e-5)
    assert first.rotation == pytest.approx(0, abs=1e-5)
    assert second.direction == pytest.approx(180, abs=1e-5)
    assert third.rotation == pytest.approx(2, abs=1e-5)
    found = result.mean.pose
    assert (found.pairs, found.without_direction) == (3, 0)
    assert found.mean.direction == pytest.approx(np.mean([0, 180, third.direction]), abs=1e-4)
    assert found.median.direction == pytest.approx(third.direction)
    assert found.median.rotation == pytest.approx(0, abs=1e-5)
    assert found.mean.rotation == pytest.approx(2 / 3, abs=1e-4)


@pytest.mark.parametrize("status", ["little_parallax", "pure_rotation", "no_motion"])
def test_too_little_parallax_is_counted_and_averaged_nowhere(sequences, camera_results, status):
    _, given = camera_results
    twist = SCENES[0].motions[0]
    given += [(twist, 2.0, "converged"), (-twist, 2.0, status), (twist, np.nan, "diverged")]
    result = evaluate(find_pairs(sequences / "chess"), settings=camera_settings())
    first, second, third = result.pairs
    assert not result.faults
    assert [pair.without_depth for pair in result.pairs] == [False, True, True]
    assert second.depth is None and third.depth is None
    assert second.pose.direction is None and second.pose.rotation == first.pose.rotation
    means = result.mean
    assert (means.depth.pairs, means.depth.without_depth) == (1, 2)
    assert means.depth.mean == means.depth.median == first.depth
    assert (means.pose.pairs, means.pose.without_direction) == (3, 1)
    assert means.pose.mean.direction == pytest.approx(0, abs=1e-4)
    names = {table: [row[0] for row in printed(result, table=table)] for table in (0, 1)}
    chess = [f"chess/frame-00000{k}" for k in range(3)]
    for table, count in ((0, 1), (1, 3)):
        assert names[table] == [
            chess[0],
            f"{chess[1]} (too little parallax)",
            f"{chess[2]} (no depth)",
            f"chess, mean of {count}",
            f"chess, median of {count}",
            "chess, too little parallax: 1",
            "chess, no depth: 1",
        ]
    assert printed(result)[1][1:5] == ["–"] * 4 and printed(result)[5][1:] == ["–"] * 5
    assert printed(result, table=1)[1][1] == "–"


def test_nothing_but_too_little_parallax(sequences, camera_results, tmp_path):
    _, given = camera_results
    given += [(SCENES[0].motions[0] * 0, np.nan, "pure_rotation")] * 6
    result = evaluate_to(tmp_path / "out", sequences, settings=camera_settings())
    assert not result.faults
    assert result.mean.depth.mean is None and result.mean.depth.without_depth == 4
    assert result.mean.pose.mean.direction is None
    assert set(written(tmp_path / "out")) == {f"{label}_flow.flo" for label in SEQUENCE_LABELS} | {
        "two/block_flow.png", "two/block_error.png", "eval.json"
    }  # fmt: skip
    rows = [row[0] for row in printed(result, table=1)]
    assert rows[-1] == "all, too little parallax: 4" and not any("mean" in row for row in rows)


def test_a_known_pose_is_given(sequences, camera_results):
    asked, given = camera_results
    given += [(SCENES[0].motions[0], 2.0, "converged")] * 6
    result = evaluate(find_pairs(sequences), settings=camera_settings())
    assert not result.faults
    assert [pose is None for pose in asked] == [True] * 5 + [False]
    np.testing.assert_array_equal(asked[-1], pose_matrix([-1, 0, 0, 0, 0, 0]))
    assert [bool(pair.pose) for pair in result.pairs] == [True] * 5 + [False]
    asked.clear()
    assert not evaluate(find_pairs(sequences), settings=FAST).faults
    assert asked == [None] * 6


def test_depth_and_pose_are_recorded(sequences, camera_results, tmp_path):
    _, given = camera_results
    given += [(SCENES[0].motions[0], SCENES[0].depth, "converged")] * 5
    given += [(SCENES[0].motions[0], 2.0, "little_parallax")]
    result = evaluate_to(tmp_path / "out", sequences, settings=camera_settings())
    about = record(tmp_path / "out")
    for entry, found in zip(about["pairs"], result.pairs, strict=True):
        assert entry["depth"] == (None if found.depth is None else asdict(found.depth))
        assert entry["pose"] == (None if found.pose is None else asdict(found.pose))
        assert entry["without_depth"] == found.without_depth
        assert entry["status"] == found.status
    chess = about["dataset_means"]["chess"]
    for kind, errors in (("depth", DepthErrors), ("pose", PoseErrors)):
        for word in ("mean", "median"):
            expected = getattr(getattr(result.dataset_means["chess"], kind), word)
            assert errors(**chess[kind][word]) == expected
    assert about["mean"]["depth"]["without_depth"] == 1
    assert about["pairs"][4]["inputs"]["pose_rows"] == [1, 2]
    depths = {f"{label}_depth_error.png" for label in SEQUENCE_LABELS[:3]}
    assert depths < set(written(tmp_path / "out"))
    assert "two/block_depth_error.png" not in written(tmp_path / "out")
    picture = read_image(tmp_path / "out" / "chess" / "frame-000000_depth_error.png")
    assert picture.ndim == 3 and picture.shape[1] > 400


def test_tables_of_depth_and_pose(sequences, camera_results):
    _, given = camera_results
    given += [(SCENES[0].motions[0], SCENES[0].depth, "converged")] * 6
    (sequences / "chess" / "frame-000001.depth.png").unlink()
    result = evaluate(find_pairs(sequences), settings=camera_settings())
    flow, depth, pose = (printed(result, width=80, table=table) for table in range(3))
    assert [row[0] for row in flow] == ["two/block"]
    assert [row[0] for row in depth] == [
        "chess/frame-000000", "chess/frame-000001 (failed)", "chess/frame-000002",
        "chess, mean of 2", "chess, median of 2", "two/block", "all, mean of 3", "all, median of 3",
    ]  # fmt: skip
    assert [row[0] for row in pose] == [
        "chess/frame-000000", "chess/frame-000001 (failed)", "chess/frame-000002",
        "chess, mean of 2", "chess, median of 2", "lab/rgb_00000", "lab/rgb_00001",
        "lab, mean of 2", "lab, median of 2", "all, mean of 4", "all, median of 4",
    ]  # fmt: skip
    errors, median = result.pairs[0].depth, result.dataset_means["chess"].depth.median
    for row, expected in ((depth[0], errors), (depth[4], median)):
        assert row[1:5] == [
            f"{expected.abs_rel:.3f}",
            f"{expected.silog:.2f}",
            f"{100 * expected.delta1:.1f}",
            f"{100 * expected.density:.1f}",
        ]
    assert depth[1][1:] == ["–"] * 5
    found = result.pairs[0].pose
    assert pose[0][1:3] == [f"{found.direction:.2f}", f"{found.rotation:.4f}"]
    assert pose[0][3] == depth[0][5] == f"{result.pairs[0].seconds:.2f}"


def test_tables_without_one_motion_of_the_camera(sequences):
    result = evaluate(find_pairs(sequences), settings=FAST)
    titles = [table.title for table in evaluation_tables(result)]
    assert titles == [f"{kind} against the truth" for kind in ("Flow", "Depth", "Pose")]
    lab = replace(result, pairs=result.pairs[3:5])
    (table,) = evaluation_tables(lab)
    assert "--motion camera" in table.caption
    assert [row[1:3] for row in printed(lab)] == [["–", "–"]] * 2
    others = replace(result, pairs=(*result.pairs[:3], result.pairs[5]))
    assert [table.title for table in evaluation_tables(others)] == titles[:2]


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
    assert about["camera"] == {"focal": 5.0, "center": None, "distortion": None}


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


def test_poses_of_a_real_sequence(shared_data):
    """From the flow alone: no order, sign or inverse of the poses is mistaken."""
    for pair in find_pairs(shared_data / "new_tsukuba")[3:40:12]:
        loaded = pair.load()
        result = tisfm.interpret(
            loaded.frame0,
            loaded.frame1,
            camera=loaded.camera,
            settings=tisfm.Settings.preset("fast"),
        )
        motion = camera_motion(result.flow, result.confidence, loaded.camera)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = motion.rotation, motion.translation
        errors = pose_errors(pose, loaded.pose)
        assert errors.direction < 3 and errors.rotation < 0.05


@pytest.mark.parametrize("channels", [(), (3,)])
def test_what_warms_up_reaches_all_kernels(monkeypatch, recwarn, channels):
    """A pair without parallax would leave those of depth to be compiled while time is taken."""
    statuses = []
    original = evaluation.interpret

    def interpret(*frames, **options):
        result = original(*frames, **options)
        statuses.append(result.status)
        return result

    monkeypatch.setattr(evaluation, "interpret", interpret)
    evaluation._warm_up(tisfm.Settings(motion="camera"), channels, np.dtype(np.uint8))
    assert statuses == ["converged"]
    assert not [w for w in recwarn if w.category is GuessedFocalWarning]
