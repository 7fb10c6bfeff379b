"""The joined result has the checks, masks and grades of its chunks; a piece has one verdict."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.exports.made import SHAPE, made
from tests.reconstruction.films import along
from tests.reconstruction.test_path_checks import check_of
from tisfm import PathCheck
from tisfm.camera_file import write_camera
from tisfm.reconstruction.chunks.joining import ChunkResult, place_chunks, write_joined_result
from tisfm.reconstruction.result.folder import write_mask, write_record

COUNT, SHARED = 6, 3  # frames of a chunk, and of its overlap with the next chunk


def joined(folder, checks, masks, errors):
    """Return the joined result of chunks of one path, with these checks, masks and errors."""
    poses = along(len(checks) * SHARED + SHARED)
    parts = []
    for number, (check, mask, error) in enumerate(zip(checks, masks, errors, strict=True)):
        begin = number * SHARED
        chunk = made(folder / f"{number}", count=COUNT, poses=poses[begin : begin + COUNT])
        chunk = replace(chunk, checks=(check,), depth_error=np.full(COUNT, error))
        write_record(chunk.folder, chunk)
        write_camera(chunk.folder / "camera.json", chunk.camera, SHAPE)
        if mask is not None:
            write_mask(chunk.folder, mask)
        frames = {begin + k: k for k in range(COUNT)}
        parts.append(ChunkResult(result=tisfm.Reconstruction.load(chunk.folder), frames=frames))
    placements = place_chunks(parts, has_given_poses=True)
    out = folder / "out"
    for name in ("depth", "frames", "cache"):
        (out / name).mkdir(parents=True)
    write_joined_result(out, parts, placements, camera=parts[0].result, missing={}, notes=())
    return tisfm.Reconstruction.load(out)


def test_a_wrong_chunk_contradicts_the_whole_piece(tmp_path):
    right, wrong = check_of(), check_of(zoom=0.01)
    result = joined(tmp_path, [right, wrong, right], [None] * 3, [0.01] * 3)
    (check,) = result.checks
    assert [(pair.first, pair.second) for pair in check.pairs] == [(0, 1), (3, 4), (6, 7)]
    assert check.contradicts and check.objections == ("zoom",)
    assert check.message.startswith("a chunk of the frames, 3 to 4: the picture grows")
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


def test_a_single_part_is_its_own_check():
    check = check_of(zoom=0.01)
    assert PathCheck.joined([check]) == check
