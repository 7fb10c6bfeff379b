"""Films with exact truth, what is measured of them, and how it is told."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from bench.sequences import rendered_films
from bench.sequences.rendered import draw, write
from bench.sequences.rendered_films import (
    COUNTS,
    FilmParameters,
    _distance,
    circle_path,
    depth_in_one_scale,
    end_gap,
    keyframe_path,
    path_error,
    round_trip_path,
    scale_change,
    shake_path,
    turn_path,
    walk_path,
)
from bench.shared.results import Bar


def similar(poses, scale=1.0):
    """Return the poses in other axes and another unit."""
    found = poses.copy()
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    found[:, :3, :3] = turn @ poses[:, :3, :3]
    found[:, :3, 3] = scale * poses[:, :3, 3] @ turn.T + (1, 2, 3)
    return found


def test_round_trips_end_where_they_began():
    poses = round_trip_path(20)
    np.testing.assert_allclose(poses[0], poses[-1], atol=1e-12)
    assert end_gap(similar(poses, 3.0), poses) == pytest.approx(0, abs=1e-6)
    off = similar(poses, 3.0)
    off[-1, :3, 3] += (0.3, 0, 0)
    length = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
    assert end_gap(off, poses) == pytest.approx(100 * 0.1 / length, rel=0.05)
    assert path_error(off, poses) > 0.1


def test_rounds_go_on_as_they_began():
    poses = circle_path(460)
    np.testing.assert_array_equal(circle_path(300), poses[:300])
    np.testing.assert_allclose(poses[225, :3, :3], poses[0, :3, :3], atol=1e-12)
    assert np.linalg.norm(poses[225, :3, 3] - poses[0, :3, 3]) > 0.1
    looking = poses[:, :3, 2]
    outward = poses[:, :3, 3] * (1, 0, 1)
    assert ((looking * outward).sum(axis=1) > 0.99 * np.linalg.norm(outward, axis=1)).all()


def test_the_camera_turns_on_the_spot():
    poses = turn_path(5, 7, 6, step=0.03)
    assert len(poses) == 18
    way = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert (way[4:11] == 0).all() and (way[:4] > 0.03).all() and (way[11:] > 0.03).all()
    turns = poses[:-1, :3, :3].transpose(0, 2, 1) @ poses[1:, :3, :3]
    angle = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
    np.testing.assert_allclose(angle[4:11], 0.03, atol=1e-6)
    np.testing.assert_allclose(angle[11:], 0, atol=1e-6)


def test_a_change_of_scale_is_seen():
    poses = turn_path(5, 5, 5)
    found = similar(poses)
    found[10:, :3, 3] = found[9, :3, 3] + 1.1 * (found[10:, :3, 3] - found[9, :3, 3])
    change = scale_change(found, poses, slice(0, 5), slice(10, None))
    assert change == pytest.approx(100 * (1 - 1 / 1.1), abs=1e-6)


def test_a_shaken_camera_turns_between_frames():
    poses = shake_path(20)
    turns = poses[:-1, :3, :3].transpose(0, 2, 1) @ poses[1:, :3, :3]
    angle = np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert 2 < angle.max() < 3.2 and np.linalg.norm(poses[-1, :3, 3]) > 0.5


def test_missing_depth_counts_in_one_scale():
    true = np.random.default_rng(0).uniform(1, 3, (4, 6, 8)).astype(np.float32)
    found = 2 * true
    found[1] *= 1.1
    found[2, :3] = np.nan
    film = SimpleNamespace(frames=true, depth=true)
    result = SimpleNamespace(depth=lambda k: found[k])
    expected = (0.1 + 0.5) / 4
    assert depth_in_one_scale(film, result) == pytest.approx(expected, abs=1e-5)


def test_frames_around_one():
    poses = keyframe_path(5)
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(poses[1] @ poses[2], np.eye(4), atol=1e-12)
    assert len(walk_path(7)) == 7


def test_films_are_kept_and_points_on_them_are_right(tmp_path, monkeypatch):
    monkeypatch.setattr(rendered_films, "CACHE", tmp_path / "films")
    take = FilmParameters(name="x", poses=walk_path(2), textured=True, height=24, width=32)
    film = take.film()
    monkeypatch.setattr(rendered_films, "room_film", None)
    again = take.film()
    np.testing.assert_array_equal(again.frames, film.frames)
    np.testing.assert_array_equal(again.depth, film.depth)
    assert again.camera == film.camera
    row, column = (a.ravel() for a in np.mgrid[2:22:4, 2:30:4])
    cx, cy = film.camera.center_for(24, 32)
    ahead = np.stack([(column - cx), (row - cy), np.full(row.size, film.camera.focal)], axis=1)
    points = ahead / film.camera.focal * film.depth[0, row, column, None]
    near, far = _distance(points, film), _distance(1.04 * points, film)
    assert np.median(near) < 0.01 < np.median(far)
    assert np.isinf(_distance(-points, film)).all()


def test_figures_stand_beside_their_bars(tmp_path):
    bars = [Bar("gap", 0.2, 0.3), Bar("mesh", 93.0, 95.0, at_most=False), Bar("ATE", 1.0, None)]
    errors = {"bare": [0.05, 0.04, 0.03, 0.025, 0.02]}
    write({"threads": 2}, bars, errors, tmp_path / "out")
    text = (tmp_path / "out.md").read_text()
    assert "| gap | 0.2 | ≤ 0.3 | met |" in text
    assert "| mesh | 93 | ≥ 95 | **not met** |" in text
    assert "| ATE | 1 | | |" in text
    kept = json.loads((tmp_path / "out.json").read_text())
    assert kept["errors"] == errors and len(kept["bars"]) == 3
    assert len(errors["bare"]) == len(COUNTS)
    draw(errors, tmp_path / "again.png")
    assert (tmp_path / "again.png").stat().st_size == (tmp_path / "out.png").stat().st_size
