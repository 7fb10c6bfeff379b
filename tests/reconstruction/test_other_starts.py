"""A path that begins with a wrong motion is found again from the dense image motion."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import along, path_error
from tests.rendered import room_film
from tisfm.reconstruction import pipeline
from tisfm.reconstruction.mapping.solution import FocalEstimate, Piece
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.stages import other_starts
from tisfm.reconstruction.stages.other_starts import is_direction_wrong, start_elsewhere

FAST = tisfm.Settings.preset("fast", motion="camera")
SIDEWAYS = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # it turns positions


def reconstruct_from_a_wrong_path(monkeypatch, film, objection=""):
    """Reconstruct a film whose first path moves in a wrong direction."""

    def solve_wrongly(job, reading):
        result = right_solve(job, reading)
        (piece,) = result.path.pieces
        poses = {frame: pose.copy() for frame, pose in piece.poses.items()}
        for pose in poses.values():
            pose[:3, 3] = SIDEWAYS @ pose[:3, 3]
        path = replace(result.path, pieces=(replace(piece, poses=poses),), objection=objection)
        return replace(result, path=path)

    right_solve = pipeline.solve_path
    monkeypatch.setattr(pipeline, "solve_path", solve_wrongly)
    return tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, depth_of="keyframes")


def direction_error(poses, true_poses):
    """Return the angle between two motions from the first frame to the last one, degrees."""
    first, second = ((np.linalg.inv(each[0]) @ each[-1])[:3, 3] for each in (poses, true_poses))
    cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_dense_motion_replaces_a_wrong_start(monkeypatch):
    film = room_film(along(10, np.array((0.06, 0.01, 0.02, 0, 0.012, 0))), 120, 160)
    result = reconstruct_from_a_wrong_path(monkeypatch, film, "a zoom fits better")
    assert path_error(result.poses, film.poses) < 0.005
    assert direction_error(result.poses, film.poses) < 1
    assert not result.checks[0].contradicts and set(result.status) == {"converged"}
    depth = result.depth(result.keyframes[1])
    scale = np.median(film.depth[result.keyframes[1]] / depth)
    relative = np.abs(scale * depth / film.depth[result.keyframes[1]] - 1)
    assert np.median(relative) < 0.03


def test_wrong_path_stays_if_checks_contradict_every_other_start(monkeypatch):
    film = room_film(along(10, np.array((0.06, 0.01, 0.02, 0, 0.012, 0))), 120, 160)
    contradicted, checked = SimpleNamespace(contradicts=True), []
    monkeypatch.setattr(
        other_starts, "check_path", lambda _, path: checked.append(path) or (contradicted,)
    )
    result = reconstruct_from_a_wrong_path(monkeypatch, film)
    assert 1 <= len(checked) <= 3
    assert set(result.status) == {"contradicted"}
    assert direction_error(result.poses, film.poses) > 45
    assert np.isfinite(result.depth(result.keyframes[0])).all()  # the depth of the first path


@pytest.mark.parametrize(
    ("contradicts", "objections", "expected"),
    [
        (True, ("excess", "direction"), True),
        (True, ("excess", "residual"), False),
        (False, ("direction",), False),
    ],
)
def test_only_a_contradicted_direction_asks_for_another_start(contradicts, objections, expected):
    check = SimpleNamespace(contradicts=contradicts, objections=objections)
    assert is_direction_wrong(check) == expected


@pytest.mark.parametrize(
    "change",
    ["given poses", "no tracks", "fixed pixels", "two pieces", "focal", "joints", "views", "zoom"],
)
def test_other_starts_are_not_tried(change):
    camera = tisfm.Camera(focal=100.0)
    piece = Piece(poses={}, views=(), points={}, joints=(3,) if change == "joints" else ())
    pieces = (piece,) * (2 if change == "two pieces" else 1)
    path = CameraPath(
        pieces=pieces, missing={}, observations=(), camera=camera,
        focal=FocalEstimate(focal=100.0, deviation=1.0) if change == "focal" else None,
        zoom=np.ones(4) if change == "zoom" else None,
    )  # fmt: skip
    first = SimpleNamespace(path=path, fixed_pixels=True if change == "fixed pixels" else None)
    job = SimpleNamespace(revises_camera=change != "given poses")  # nothing else is asked
    tracks = SimpleNamespace(views=range(1000 if change == "views" else 10))
    reading = SimpleNamespace(tracks=None if change == "no tracks" else tracks)
    check = SimpleNamespace(contradicts=True, objections=("excess", "direction"))
    assert start_elsewhere(job, reading, first, [check] * len(pieces)) is None
