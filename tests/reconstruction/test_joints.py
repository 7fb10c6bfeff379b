"""Pieces that share no tracks are joined where their images agree."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

import tisfm
from tests.reconstruction import films
from tests.rendered import room_film
from tisfm.metrics.trajectory_errors import absolute_errors
from tisfm.reconstruction.geometry.sim3 import transform_pose
from tisfm.reconstruction.joints import joint_search
from tisfm.reconstruction.joints.alignment import Aligner
from tisfm.reconstruction.joints.joint_search import find_joint, join_pieces
from tisfm.reconstruction.mapping.rival import Rival
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import TrackPoints
from tisfm.rigid import pose_matrix
from tisfm.scenes import Film

COUNT, HALF = 14, 7
# The later piece has other axes, another origin and another scale than the earlier one.
OTHER_WORLD = pose_matrix((0.3, -0.2, 0.5, 0.1, 0.6, -0.2)) @ np.diag([2.5, 2.5, 2.5, 1.0])


def true_piece(film, frames, world=None, seed=0):
    """Return a piece with exact poses and points, and the tracks in the frames of the film."""
    random = np.random.default_rng(seed)
    world = np.eye(4) if world is None else world
    height, width = film.frames[0].shape
    places = random.uniform((8, 8), (width - 9, height - 9), (150, 2)).round()
    first = frames[0] if seed else frames[-1]
    columns, rows = places.astype(int).T
    rays = (places - film.camera.center_for(height, width)) / film.camera.focal
    local = np.column_stack([rays, np.ones(len(rays))]) * film.depth[first][rows, columns, None]
    points = local @ film.poses[first][:3, :3].T + film.poses[first][:3, 3]
    tracks = np.arange(150) + 1000 * seed
    piece = Piece(
        poses={frame: transform_pose(world, film.poses[frame]) for frame in frames},
        views=tuple(frames),
        points=TrackPoints(tracks=tracks, positions=points @ world[:3, :3].T + world[:3, 3]),
    )
    observations = {frame: Observations(points=places[:0], tracks=tracks[:0]) for frame in frames}
    observations[first] = Observations(points=places, tracks=tracks)
    return piece, observations


def replace_camera(camera, distortion):
    return tisfm.Camera(focal=camera.focal, distortion=distortion)


def two_pieces(film, gap=1, *, other=None):
    """Return two pieces of a film, the later one in another world, and the tracks of all frames.

    The later piece may belong to another film.
    """
    earlier, tracks = true_piece(film, range(HALF))
    later_frames = range(HALF - 1 + gap, len(film.frames))
    later, more = true_piece(other or film, later_frames, OTHER_WORLD, seed=1)
    empty = Observations(points=np.zeros((0, 2)), tracks=np.zeros(0, np.int64))
    observations = [{**tracks, **more}.get(frame, empty) for frame in range(len(film.frames))]
    return [earlier, later], observations


@pytest.mark.parametrize("gap", [1, 3])
def test_pieces_are_joined(gap):
    film = films.walk(COUNT)
    pieces, observations = two_pieces(film, gap)
    pieces[1] = replace(pieces[1], rival=Rival(loss=1.0, direction=40.0, rotation=2.0))
    joined = join_pieces(pieces, observations, film.camera, film.frames.__getitem__)
    assert len(joined) == 1 and joined[0].rival == pieces[1].rival
    assert sorted(joined[0].poses) == sorted({*pieces[0].poses, *pieces[1].poses})
    assert set(joined[0].points) == {*pieces[0].points, *pieces[1].points}
    depth = np.median(film.depth[0])
    for frame, pose in joined[0].poses.items():
        assert np.abs(pose[:3, :3] - film.poses[frame][:3, :3]).max() < 0.01
        assert np.linalg.norm(pose[:3, 3] - film.poses[frame][:3, 3]) < 0.015 * depth
    ratios = [
        np.linalg.norm(joined[0].points[track]) / np.linalg.norm(point)
        for track, point in true_piece(film, pieces[1].views, seed=1)[0].points.items()
    ]
    assert np.median(ratios) == pytest.approx(1, abs=0.015)


def test_brightness_may_change_at_a_joint():
    film = films.walk(COUNT)
    pieces, observations = two_pieces(film)
    frames = film.frames.astype(np.float32)
    frames[HALF:] = 0.7 * frames[HALF:] + 30
    joined = join_pieces(
        pieces, observations, film.camera, frames.round().astype(np.uint8).__getitem__
    )
    assert len(joined) == 1


def test_pieces_of_other_scenes_stay_apart():
    film = films.walk(COUNT)
    turned = pose_matrix((0, 0, 0, 0, 2.5, 0)) @ films.along(COUNT)
    other = room_film(turned, 180, 240, samples=2)
    pieces, observations = two_pieces(film, other=other)
    frames = np.concatenate([film.frames[:HALF], other.frames[HALF:]])
    assert len(join_pieces(pieces, observations, film.camera, frames.__getitem__)) == 2


def test_a_piece_that_its_own_images_contradict_stays_apart():
    film = films.walk(COUNT)
    pieces, observations = two_pieces(film)
    frames = np.concatenate([film.frames[:HALF], films.mirrored(film)[HALF:]])
    assert len(join_pieces(pieces, observations, film.camera, frames.__getitem__)) == 2


def test_pieces_far_apart_in_time_turning_pieces_and_small_pieces_stay_apart():
    film = films.walk(COUNT)
    pieces, observations = two_pieces(film, gap=6)
    grey = film.frames.__getitem__
    assert len(join_pieces(pieces, observations, film.camera, grey)) == 2
    pieces, observations = two_pieces(film)
    turning = [pieces[0], replace(pieces[1], only_turns=True)]
    assert len(join_pieces(turning, observations, film.camera, grey)) == 2
    few = replace(pieces[1], points=pieces[1].points.select(np.arange(1000, 1020)))
    assert len(join_pieces([pieces[0], few], observations, film.camera, grey)) == 2


def striped_film(wavelength):
    """Return a film of a camera that moves along a wall of stripes, 2 m away."""
    camera, height, width = tisfm.Camera(focal=180.0), 120, 200
    poses = films.along(COUNT, (0.05, 0, 0, 0, 0, 0))
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    x = (columns - (width - 1) / 2) / 180 * 2.0
    y = (rows - (height - 1) / 2) / 180 * 2.0
    frames = [
        128 + 50 * np.sin(2 * np.pi * (x + pose[0, 3]) / wavelength) * np.cos(9 * y)
        for pose in poses
    ]
    depth = np.full((COUNT, height, width), 2.0)
    return Film(frames=np.rint(frames).astype(np.uint8), depth=depth, poses=poses, camera=camera)


def test_a_repeated_pattern_leaves_pieces_apart():
    film = striped_film(wavelength=0.35)
    pieces, observations = two_pieces(film)
    assert len(join_pieces(pieces, observations, film.camera, film.frames.__getitem__)) == 2


def test_dark_frames_leave_pieces_apart_without_a_warning(recwarn):
    film = films.walk(COUNT)
    pieces, observations = two_pieces(film)
    dark = np.full_like(film.frames, 10)
    assert len(join_pieces(pieces, observations, film.camera, dark.__getitem__)) == 2
    assert not recwarn.list


@pytest.mark.parametrize(
    ("joins_pieces", "distortion", "expected"),
    [(True, None, True), (False, None, False), (True, (-0.1, 0.0, 0.0, 0.0), False)],
)
def test_only_images_that_belong_to_the_tracks_join_pieces(joins_pieces, distortion, expected):
    film = films.walk(COUNT)
    pieces, observations = two_pieces(film)
    camera = replace_camera(film.camera, distortion)
    tracks = SequenceTracks(
        observations=observations, views=(), matches={}, distinct_count=COUNT, shape=(180, 240)
    )
    solver = PathSolver(
        tracks=tracks, camera=camera, grey=film.frames.__getitem__, joins_pieces=joins_pieces
    )
    solution = solver.complete_solution(pieces, (), observations, camera)
    joined = solver._join_pieces(solution)
    assert (len(joined.pieces) == 1) == expected
    if expected:
        assert joined.pieces[0].joints == (HALF,)
        assert not joined.missing_frames


def test_pieces_whose_patches_disagree_stay_apart():
    """In a bare room with three frames lost, an alignment may end far from the truth."""
    film = films.walk(COUNT)
    pieces, observations = two_pieces(film)
    refine = Aligner.refine_one_way

    def refine_apart(self, start, *, shows_earlier):
        alignment = refine(self, start, shows_earlier=shows_earlier)
        turn = pose_matrix((0, 0, 0, 0, 0.05 * shows_earlier, 0))
        return replace(alignment, similarity=turn @ alignment.similarity)

    with mock.patch.object(Aligner, "refine_one_way", refine_apart):
        joined = join_pieces(pieces, observations, film.camera, film.frames.__getitem__)
    assert len(joined) == 2


def test_a_path_goes_on_after_spoiled_frames():
    film = room_film(films.along(13), 150, 200, samples=2, textured=True)
    frames = film.frames.copy()
    random = np.random.default_rng(0)
    frames[5:8] = random.integers(0, 60, frames[5:8].shape)  # as if a hand covered the lens
    settings = tisfm.Settings.preset("fast", motion="camera")
    with mock.patch.object(joint_search, "find_joint", wraps=find_joint) as search:
        walk = tisfm.reconstruct(
            list(frames), camera=film.camera, settings=settings, depth_of="none"
        )
    assert search.called
    assert walk.piece.tolist() == [0] * 5 + [-1] * 3 + [0] * 5
    has_pose = walk.piece == 0
    errors = absolute_errors(walk.poses[has_pose], film.poses[has_pose])
    length = np.linalg.norm(np.diff(film.poses[:, :3, 3], axis=0), axis=1).sum()
    assert errors.similarity < 0.005 * length
