"""Depth and pose: the numbers are those of the metrics, and too little parallax has none."""

from dataclasses import asdict, replace

import numpy as np
import pytest

import tisfm
from tests.evaluation.evaluated import (
    FAST,
    SCENES,
    SEQUENCE_LABELS,
    H,
    W,
    camera_settings,
    evaluate_to,
    printed,
    put,
    record,
    written,
)
from tisfm.camera import Camera
from tisfm.datasets import find_pairs
from tisfm.evaluation.pair_tables import evaluation_tables
from tisfm.evaluation.pairs import evaluate
from tisfm.formats import read_image
from tisfm.lens import Undistortion
from tisfm.metrics import DepthErrors, PoseErrors, depth_errors, endpoint_error
from tisfm.rigid import pose_matrix


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
    assert printed(result)[1][1:6] == ["–"] * 5 and printed(result)[5][1:] == ["–"] * 6
    assert printed(result, table=1)[1][1] == "–"


def test_pairs_with_little_parallax_have_no_depth_errors(sequences, camera_results, tmp_path):
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


def test_a_known_pose_is_used(sequences, camera_results):
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
    flow, depth, pose = (printed(result, width=84, table=table) for table in range(3))
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
        assert row[1:6] == [
            f"{expected.abs_rel:.3f}",
            f"{expected.abs_rel_all:.3f}",
            f"{expected.silog:.2f}",
            f"{100 * expected.delta1:.1f}",
            f"{100 * expected.density:.1f}",
        ]
    assert depth[1][1:] == ["–"] * 6
    found = result.pairs[0].pose
    assert pose[0][1:3] == [f"{found.direction:.2f}", f"{found.rotation:.4f}"]
    assert pose[0][3] == depth[0][6] == f"{result.pairs[0].seconds:.2f}"


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


def test_given_poses_are_used(sequences, camera_results):
    asked, given = camera_results
    given += [(SCENES[0].motions[0], SCENES[0].depth, "converged")] * 6
    pairs = find_pairs(sequences)
    result = evaluate(pairs, settings=camera_settings(), give_poses=True)
    assert not result.faults
    for pair, pose in zip(pairs, asked, strict=True):
        np.testing.assert_array_equal(pose, pair.load().pose)
    assert all(found.pose is None for found in result.pairs)
    assert [found.depth is not None for found in result.pairs] == [True] * 3 + [False] * 2 + [True]
    with pytest.raises(ValueError, match='poses are to be given, but motion="field"'):
        evaluate(pairs, settings=FAST, give_poses=True)


def test_depth_beyond_a_limit_does_not_count(sequences):
    pairs = find_pairs(sequences)[:1]
    depth = pairs[0].load().depth
    limit = float(np.nanmedian(depth))
    (found,) = evaluate(pairs, settings=FAST, max_depth=limit).pairs
    (whole,) = evaluate(pairs, settings=FAST).pairs
    result = tisfm.interpret(
        pairs[0].load().frame0, pairs[0].load().frame1, camera=found.camera, settings=FAST
    )
    near = np.where(depth <= limit, depth, np.nan)
    assert found.depth == depth_errors(result.depth, near) != whole.depth
    (nothing,) = evaluate(pairs, settings=FAST, max_depth=1e-3).pairs
    known = np.isfinite(depth).sum()
    assert nothing.fault == f"no true depth is left up to 0.001 of {known} pixels that have one"
    for limit in (0, -1, np.nan):
        with pytest.raises(ValueError, match="expected a positive depth"):
            evaluate(pairs, settings=FAST, max_depth=limit)


def test_depth_is_resampled_as_the_frames_are(tmp_path):
    """The truth of a camera with distortion and oblong pixels, of a wall that slants."""
    folder, rows = tmp_path / "room", np.mgrid[:H, :W][0]
    for k, frame in enumerate((SCENES[0].frame0, SCENES[0].frame1)):
        put(folder / "images" / f"{k}.png", frame)
        put(folder / "depth" / f"{k}.png", (1000 + 100 * rows).astype(np.uint16))
    (folder / "camera.txt").write_text("fx fy cx cy k1 k2 p1 p2\n56 64 27.5 19.5 -.1 0 0 0\n")
    seen = []
    (found,) = evaluate(
        find_pairs(folder), settings=FAST, on_pair=lambda *given: seen.append(given)
    ).pairs
    (_, result, loaded), camera = seen[0], found.camera
    assert camera == Camera((56, 64), (27.5, 19.5), (-0.1, 0, 0, 0))
    lens = Undistortion(camera, H, W)
    expected = lens.apply_nearest((1 + 0.1 * rows).astype(np.float32))
    np.testing.assert_array_equal(loaded.depth, expected)
    assert 0 < np.isnan(expected).sum() < expected.size / 2
    assert found.depth == depth_errors(result.depth, expected)
    assert result.camera == camera.pinhole()
