"""The joined result has the checks, masks, grades and deviations of its chunks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tisfm
from tests.exports.made import SHAPE, made
from tests.reconstruction.films import along
from tests.reconstruction.test_path_checks import check_of
from tisfm import PathCheck
from tisfm.camera_file import write_camera
from tisfm.reconstruction.chunks.chunk import Span
from tisfm.reconstruction.chunks.error_report import ErrorReport
from tisfm.reconstruction.chunks.joining import write_joined_result
from tisfm.reconstruction.chunks.placement import ChunkResult, place_chunks
from tisfm.reconstruction.result.folder import write_mask, write_record
from tisfm.reconstruction.result.statuses import mark_contradicted

COUNT, SHARED = 6, 3  # frames of a chunk, and of its overlap with the next chunk


def joined(folder, checks, masks, errors, causes=None, scales=None):
    """Return the joined result of chunks of one path, with these checks, masks and errors.

    Chunks are contradicted by their checks; `causes` says what hides the motion in each. `scales`
    are factors of the depth of chunks.
    """
    poses = along(len(checks) * SHARED + SHARED)
    parts = []
    of_chunks = zip(checks, masks, errors, causes or [""] * len(checks), strict=True)
    for number, (check, mask, error, cause) in enumerate(of_chunks):
        begin = number * SHARED
        chunk = made(folder / f"{number}", count=COUNT, poses=poses[begin : begin + COUNT])
        status = mark_contradicted(chunk.status, [0] * COUNT, [check], {0: cause})
        chunk = replace(chunk, checks=(check,), depth_error=np.full(COUNT, error), status=status)
        write_record(chunk.folder, chunk)
        write_camera(chunk.folder / "camera.json", chunk.camera, SHAPE)
        if mask is not None:
            write_mask(chunk.folder, mask)
        frames = {begin + k: k for k in range(COUNT)}
        parts.append(ChunkResult(result=tisfm.Reconstruction.load(chunk.folder), frames=frames))
    placements = place_chunks(parts, has_given_poses=True)
    if scales is not None:
        placements = [replace(one, scale=scales[one.part]) for one in placements]
    out = folder / "out"
    for name in ("depth", "frames", "cache"):
        (out / name).mkdir(parents=True)
    write_joined_result(out, parts, placements, camera=parts[0].result, missing={}, notes=())
    return tisfm.Reconstruction.load(out)


def test_a_wrong_chunk_contradicts_the_whole_piece(tmp_path):
    right, wrong = check_of(), check_of(zoom=0.01)
    noise = "noise hides the motion"
    result = joined(tmp_path, [right, wrong, right], [None] * 3, [0.01] * 3, ["", noise, ""])
    (check,) = result.checks
    assert [(pair.first, pair.second) for pair in check.pairs] == [(0, 1), (3, 4), (6, 7)]
    assert check.contradicts and check.objections == ("zoom",)
    assert [part.pairs[0].first for part in check.parts] == [0, 3, 6]
    later = check.renumbered({k: 2 * k for k in range(9)})
    assert [part.pairs[0].first for part in later.parts] == [0, 6, 12]
    assert check.message.startswith("a part of the frames, 3 to 4: the picture grows")
    assert {status.message for status in result.status} == {
        f"{check.message}. Probable cause: {noise}"
    }
    assert set(result.status) == {"contradicted"} and set(result.grades) == {"contradicted"}
    assert PathCheck.from_json(check.as_json()) == check


def test_right_chunks_join_to_a_right_piece(tmp_path):
    masks = np.zeros((2, *SHAPE), bool)
    masks[0, :5], masks[1, -5:] = True, True
    result = joined(tmp_path, [check_of(), check_of(fixed_share=0.01)], masks, [0.01, 0.05])
    (check,) = result.checks
    assert not check.contradicts and check.message == "" and check.fixed_share == 0.01
    np.testing.assert_array_equal(result.mask, masks.any(axis=0))
    assert set(result.status) == {"converged"}
    assert result.grades[0] == "good" and result.grades[-1] == "fair"
    assert result.depth_error.tolist() == pytest.approx([0.01] * 4 + [0.05] * 5)


def test_deviations_of_positions_are_in_the_unit_of_the_joined_path(tmp_path):
    result = joined(tmp_path, [check_of()] * 2, [None] * 2, [0.01] * 2, scales=[0.5, 3.0])
    chunks = [tisfm.Reconstruction.load(tmp_path / f"{number}") for number in range(2)]
    assert (chunks[0].position_deviation > 0).all()
    for frames, chunk, own, scale in (
        (slice(4), chunks[0], slice(4), 0.5),
        (slice(4, 9), chunks[1], slice(1, 6), 3.0),
    ):
        expected = scale * chunk.position_deviation[own]
        np.testing.assert_allclose(result.position_deviation[frames], expected)
        np.testing.assert_array_equal(
            result.rotation_deviation[frames], chunk.rotation_deviation[own]
        )


def test_the_note_on_the_focal_length_is_that_of_all_chunks(tmp_path):
    plain, dependent = (
        check_of(focal_deviation=0.3),
        check_of(focal_deviation=0.3, focal_direction=40.0),
    )
    result = joined(tmp_path, [plain, plain, dependent], [None] * 3, [0.01] * 3)
    assert "direction of motion by up to 40°" in result.focal_note
    assert not result.calibration.message


def test_a_single_part_is_its_own_check():
    check = check_of(zoom=0.01)
    assert PathCheck.joined([check]) == check


def test_each_frame_with_depth_is_reported_once(tmp_path):
    """Its number is that in the joined result, also if a later chunk is complete first."""
    chunks = []
    for number, (start, errors) in enumerate(((10, [np.nan, 0.1, 0.2]), (16, [0.3, 0.4, 0.5]))):
        chunk = made(tmp_path / f"{number}", count=3)
        skipped = () if number else ((14, "damaged"),)
        write_record(chunk.folder, replace(chunk, depth_error=np.array(errors), skipped=skipped))
        span = Span(start=start, stop=None, count=3 + len(skipped))
        chunks.append(SimpleNamespace(folder=chunk.folder, span=span))
    reported = []
    report = ErrorReport(chunks, range(10, 22, 2))
    report.add(1, lambda *pair: reported.append(pair))
    assert not reported  # the first chunk may have frames that cannot be read
    report.add(0, lambda *pair: reported.append(pair))
    assert reported == [(1, 0.1), (2, 0.2), (3, 0.4), (4, 0.5)]
