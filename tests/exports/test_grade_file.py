"""Exports of contradicted or poor results carry the grade."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.exports.made import made
from tisfm.exports import write_gltf_cameras, write_tum_paths
from tisfm.exports.grade_file import GRADES, write_grades
from tisfm.formats.glb import glb_points
from tisfm.formats.ply_note import add_ply_note
from tisfm.reconstruction.result.folder import write_record
from tisfm.results.sequence_frames import SequenceFrames
from tisfm.status import Status
from tisfm.trajectory import read_tum

WRONG = Status("contradicted", "the zoom changes: give a mask")


@pytest.fixture
def right(tmp_path):
    return made(tmp_path / "made", count=3)


@pytest.fixture
def wrong(right):
    result = replace(right, status=(WRONG,) * 3)
    write_record(right.folder, result)
    return result


@pytest.fixture
def rough(right):
    return replace(right, depth_error=np.array([0.01, 0.3, 0.2]))


def test_warnings(right, wrong, rough):
    assert right.warning() == "" and rough.warning([0]) == ""
    assert wrong.warning() == f"Grade contradicted, 3 of 3 frames: {WRONG.message}"
    assert rough.warning([1, 0]) == (
        "Grade poor, depth of 1 of 2 frames, expected to be off by up to 30 %"
    )


def test_texts_in_files(right, wrong, tmp_path):
    for result, count in ((right, 0), (wrong, 1)):
        (path,) = write_tum_paths(result, tmp_path)
        assert path.read_text().count(WRONG.message) == count
        assert len(read_tum(path).poses) == 3
        path, _ = write_gltf_cameras(result, tmp_path)
        assert json.dumps(json.loads(path.read_text())).count(WRONG.message) == count
    points = wrong.points(agreeing=1)
    assert WRONG.message in points.note and right.points(agreeing=1).note == ""
    points.save(tmp_path / "points.ply")
    assert f"comment {wrong.warning()}\n".encode() in (tmp_path / "points.ply").read_bytes()
    assert len(trimesh.load(tmp_path / "points.ply").vertices) == len(points)
    assert WRONG.message.encode() in glb_points(points.positions, points.colors, note=points.note)


def test_a_header_of_ply_is_ascii():
    data = b"ply\nformat ascii 1.0\nend_header\n"
    assert add_ply_note(data, "") == data
    assert add_ply_note(data, "8° off\nend_header") == (
        b"ply\nformat ascii 1.0\ncomment 8? off end_header\nend_header\n"
    )


def test_file_of_grades(rough, tmp_path):
    warning = write_grades(SequenceFrames(rough), tmp_path, range(3))
    lines = (tmp_path / GRADES).read_text().splitlines()
    assert warning == rough.warning() and warning in lines[1]
    assert lines[2] == "# 1 good, 2 poor"
    assert lines[4:] == ["0; good; 0.01; f0", "1; poor; 0.3; f1", "2; poor; 0.2; f2"]
    assert write_grades(SequenceFrames(rough), tmp_path, [0]) == ""
    assert not (tmp_path / GRADES).exists()
    (tmp_path / GRADES).write_text("mine")
    write_grades(SequenceFrames(rough), tmp_path, [0])
    assert (tmp_path / GRADES).read_text() == "mine"
