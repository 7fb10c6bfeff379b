"""Reconstructions of sequences against their truth."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

import tisfm
from tests.evaluation.reconstructed import DEPTHS, PATH, H, N, Result, make_sequence
from tests.trajectory.paths import similar
from tisfm.datasets import find_sequences
from tisfm.evaluation.sequence_result import TrajectoryResult
from tisfm.evaluation.sequence_tables import sequence_tables
from tisfm.evaluation.sequences import (
    SequenceEvaluation,
    as_record,
    compare_sequence,
    reconstruct_and_compare,
)
from tisfm.metrics import absolute_errors, path_length
from tisfm.rigid import rigid_motion
from tisfm.settings import Settings
from tisfm.trajectory import Trajectory

ROUNDED = 1e-4  # of the depth, as its maps store it


@pytest.fixture
def sequence(tmp_path):
    make_sequence(tmp_path / "wall")
    (found,) = find_sequences(tmp_path)
    return found


def compared(sequence, result, **options):
    loaded = sequence.load(options.get("step", 1))
    return compare_sequence(sequence, loaded, result, camera=loaded.camera, **options)


def test_the_truth_in_another_unit_has_no_error(sequence):
    found = compared(sequence, Result(unit=0.25), seconds=1.5)
    (piece,) = found.pieces
    assert (found.frames, found.posed, piece.frames, found.largest_share) == (N, N, N, 1)
    assert piece.absolute.scale == pytest.approx(4)
    assert piece.share < 1e-9 and piece.relative.rotation < 1e-9
    assert piece.rigid_share == pytest.approx(piece.absolute.rigid / path_length(PATH))
    assert piece.rigid_share > 0.1 and piece.drift.translation < 1e-9
    depth = found.depth
    assert depth.scale == pytest.approx(4, rel=2e-4)
    assert depth.error < ROUNDED and depth.certain < ROUNDED and depth.share == 1
    assert depth.scale_spread < ROUNDED and depth.flicker < 2 * ROUNDED
    assert found.statuses == {"tracked": N} and found.seconds == 1.5


def test_pieces_are_compared_each_on_its_own(sequence):
    result = Result()
    turn = rigid_motion([0, 0, 0, 1, 2, 0.5])[0]
    result.poses[4:] = similar(PATH[4:], 7.0, turn, [1, 2, 3])
    result.piece[4:] = 3
    result.drop(3)
    result.inverse = np.array(Result().inverse)
    found = compared(sequence, result)
    assert [piece.piece for piece in found.pieces] == [0, 3]
    assert [piece.frames for piece in found.pieces] == [3, 2]
    assert found.posed == 5 and found.largest_share == 0.5
    assert found.pieces[0].share < 1e-9
    assert found.pieces[1].absolute is None  # of two frames nothing is left after an alignment
    assert found.statuses == {"tracked": 5, "lost": 1}
    whole = absolute_errors(result.poses, PATH).similarity / path_length(PATH)
    assert whole > 0.02


def test_one_scale_serves_all_frames(sequence):
    result = Result()
    result.inverse[4:] *= 1.3
    depth = compared(sequence, result).depth
    assert depth.scale == pytest.approx(2, rel=1e-3)
    errors = [frame.error for frame in depth.per_frame]
    np.testing.assert_allclose(errors, [0] * 4 + [1 - 1 / 1.3] * 2, atol=2e-4)
    scales = [frame.scale for frame in depth.per_frame]
    np.testing.assert_allclose(scales, [2] * 4 + [2.6] * 2, rtol=2e-4)
    assert depth.scale_spread == pytest.approx(np.std(np.log(scales)))
    changes = [frame.flicker for frame in depth.per_frame]
    np.testing.assert_allclose(changes[:5], [0, 0, 0, 0.3, 0], atol=1e-3)
    assert changes[5] is None and depth.flicker == pytest.approx(np.mean(changes[:5]))
    assert depth.error == np.median(errors) and depth.mean_error == np.mean(errors)


def test_frames_without_depth_count_as_one(sequence):
    result = Result().drop(1, 3, 4, 5)
    result.inverse[0, : H // 2] = np.nan
    depth = compared(sequence, result).depth
    assert (depth.frames, depth.without) == (N, 4)
    assert [depth.per_frame[k].error for k in (1, 3, 4, 5)] == [1] * 4
    assert depth.error == 1 and depth.certain == 1
    assert depth.share == pytest.approx((0.5 + 1) / N)
    assert depth.per_frame[1].scale is None and depth.per_frame[1].flicker is None
    nothing = compared(sequence, Result().drop(*range(N)))
    assert nothing.depth.error == 1 and nothing.depth.scale_spread is None
    assert nothing.pieces == () and nothing.posed == 0 and nothing.largest_share == 0


def test_without_deviations_nothing_is_surest(sequence):
    result = Result().drop(3)  # which counts as 1, but is not surest either
    result.deviation[:] = np.nan
    depth = compared(sequence, result).depth
    assert depth.certain is None and depth.error < ROUNDED
    assert depth.within is None


def test_shares_within_one_and_two_deviations(sequence):
    result = Result()
    whole = compared(sequence, result).depth
    assert whole.within == (1.0, 1.0)
    result.deviation[0] = 0.1 * result.inverse[0]
    result.inverse[0][:, ::2] *= 1.15  # half of the pixels of a frame are 1.5 deviations off
    result.deviation[1] = 0.1 * result.inverse[1]
    result.inverse[1][::2] *= 1.25  # half are 2.5 off; the others count as unknown
    result.deviation[1][1::2] = np.inf
    result.deviation[2] = np.nan
    depth = compared(sequence, result).depth
    assert depth.per_frame[0].within == pytest.approx((0.5, 1.0))
    assert depth.per_frame[1].within == (0.0, 0.0)
    assert depth.per_frame[2].within is None
    known = [frame.within for frame in depth.per_frame if frame.within is not None]
    assert depth.within == pytest.approx(np.mean(known, axis=0)) and depth.within[0] < 1


def test_keyframes_and_frames_between_have_errors_of_their_own(sequence):
    result = Result(unit=1.0)
    assert compared(sequence, result, poses_given=True).depth.keyframes is None
    result.keyframes = (0, 2)
    result.inverse = np.array(result.inverse)
    result.inverse[[0, 2]] /= 1.05
    result.inverse[[1, 3]] /= 1.25
    depth = compared(sequence, result, poses_given=True).depth
    assert depth.keyframes.frames == 2 and depth.between.frames == N - 2
    assert depth.keyframes.error == pytest.approx(0.05, abs=1e-3)
    assert depth.keyframes.wrong == 0
    assert depth.between.error == pytest.approx(0.25 * 2 / (N - 2), abs=1e-3)
    assert depth.between.wrong == pytest.approx(2 / (N - 2))
    # The scene is one plane.
    assert depth.keyframes.outline_error is None and depth.between.outline_wrong is None


def test_poses_that_are_given_fix_the_scale(sequence):
    found = compared(sequence, Result(unit=0.5), poses_given=True)
    assert found.pieces == () and found.depth.scale == 1
    assert found.depth.error == pytest.approx(0.5, rel=1e-3)
    right = compared(sequence, Result(unit=1), poses_given=True)
    assert right.depth.error < ROUNDED


def test_frames_without_truth_do_not_count(tmp_path):
    poses = PATH.copy()
    poses[2] = np.nan
    make_sequence(tmp_path / "wall", poses=poses, without_depth=(0, 5))
    (sequence,) = find_sequences(tmp_path)
    found = compared(sequence, Result())
    assert found.pieces[0].absolute.poses == N - 1 and found.pieces[0].frames == N
    assert [frame.frame for frame in found.depth.per_frame] == [1, 2, 3, 4]
    flickers = [frame.flicker is not None for frame in found.depth.per_frame]
    assert flickers == [False, False, True, False]  # poses 1 to 2 and 2 to 3 are not known


def test_far_depth_can_be_left_out(sequence):
    limit = float(np.median(DEPTHS))
    result = Result()
    result.inverse[1 / result.inverse > 0.5 * limit] *= 3  # wrong where it is far
    assert compared(sequence, result, max_depth=limit).depth.error < ROUNDED
    assert compared(sequence, result).depth.error > 0.1


def test_steps_and_wrong_sizes(sequence):
    result = Result()
    for name in ("poses", "piece", "inverse", "deviation"):
        setattr(result, name, getattr(result, name)[::2])
    result.status = result.status[::2]
    found = compared(sequence, result, step=2)
    assert found.frames == 3 and found.step == 2 and found.pieces[0].share < 1e-9
    with pytest.raises(ValueError, match=r"poses of shape \(3, 4, 4\): expected \(6, 4, 4\)"):
        compared(sequence, result)
    small = Result()
    small.inverse = small.inverse[:, 1:]
    with pytest.raises(ValueError, match=r"inverse_depth is .23, 32. and truth is .24, 32."):
        compared(sequence, small)


def test_reconstructions_use_known_values(sequence, monkeypatch):
    asked = []

    def reconstruct(source, *, camera, settings, poses, progress):
        asked.append((source, camera, settings, poses))
        return Result(unit=1)

    monkeypatch.setattr(tisfm, "reconstruct", reconstruct, raising=False)
    loaded = sequence.load()
    settings = Settings.preset("fast", motion="camera")
    options = {"camera": loaded.camera, "settings": settings}
    found, result = reconstruct_and_compare(sequence, loaded, **options)
    assert asked[0] == (loaded.frames, loaded.camera, settings, None)
    assert found.seconds >= 0 and found.pieces and isinstance(result, Result)
    found, _ = reconstruct_and_compare(sequence, loaded, give_poses=True, **options)
    np.testing.assert_array_equal(asked[1][3], loaded.poses)
    assert found.poses_given and not found.pieces
    poses = loaded.poses.copy()
    poses[3] = np.nan
    with pytest.raises(ValueError, match="1 of 6 frames have no true pose"):
        reconstruct_and_compare(sequence, replace(loaded, poses=poses), give_poses=True, **options)


def test_trajectories_are_brought_to_the_frames(sequence, tmp_path):
    loaded = sequence.load()
    file = tmp_path / "path.tum"
    late = Trajectory(poses=PATH[[0, 2, 5]], times=np.array([0.001, 2.0, 5.01]))
    found = TrajectoryResult(late, loaded, file)
    np.testing.assert_array_equal(found.piece, [0, -1, 0, -1, -1, 0])
    np.testing.assert_array_equal(found.poses[[0, 2, 5]], PATH[[0, 2, 5]])
    assert np.isnan(found.poses[[1, 3, 4]]).all()
    timed = replace(loaded, times=1e9 + np.arange(N) / 10)
    frames = Trajectory(poses=PATH[1:3], times=timed.times[1:3] + 0.01)
    assert TrajectoryResult(frames, timed, file).piece.tolist() == [-1, 0, 0, -1, -1, -1]
    with pytest.raises(ValueError, match=r"path\.tum has no pose of any frame: its times begin at"):
        TrajectoryResult(frames, loaded, file)
    with pytest.raises(ValueError, match=r"path\.tum has 5 poses, but there are 6 frames"):
        TrajectoryResult(Trajectory(poses=PATH[1:]), loaded, file)
    evaluation = compared(sequence, TrajectoryResult(Trajectory(poses=PATH), loaded, file),
                          with_depth=False)  # fmt: skip
    assert evaluation.depth is None and evaluation.pieces[0].share < 1e-12


def test_tables_and_records_have_available_errors(sequence):
    good = compared(sequence, Result(), seconds=2.0)
    broken = Result()
    broken.piece[3:] = 1
    parts = compared(sequence, broken)
    failed = SequenceEvaluation(sequence=sequence, fault="a reason")
    given = compared(sequence, Result(unit=1), poses_given=True)
    console = Console(width=160, record=True, file=io.StringIO())
    tables = sequence_tables([good, parts, failed, given])
    assert [table.row_count for table in tables] == [1 + 2 + 1, 3]
    for table in tables:
        console.print(table)
    text = console.export_text()
    for words in ("6 of 6", "3 of 6", "another piece", "wall (failed)", "100.0", "2.0"):
        assert words in text
    for evaluation in (good, parts, failed, given):
        record = json.loads(json.dumps(as_record(evaluation), allow_nan=False))
        assert record["name"] == "wall" and record["layout"] == "calibrated"
        assert len(record["pieces"]) == len(evaluation.pieces)
    assert as_record(good)["depth"]["per_frame"][0]["error"] < ROUNDED
