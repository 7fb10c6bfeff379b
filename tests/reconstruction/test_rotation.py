"""A camera that only turns: orientations, the focal length, and refused motions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tisfm
from tests.reconstruction.films import along
from tests.rendered import room_film
from tisfm.camera import Camera
from tisfm.exports.colmap import model_frames
from tisfm.exports.export_request import ExportRequest, piece_frames
from tisfm.exports.formats import FORMATS
from tisfm.reconstruction.chunks.overlaps import overlap_sim3
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.rotation.adjustment import Orientations, adjust_orientations
from tisfm.reconstruction.rotation.frame_pairs import FramePair, find_frame_pairs
from tisfm.reconstruction.rotation.pair_rotation import fit_rotation
from tisfm.reconstruction.rotation.rotation_search import RotationSearch
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.results.sequence_frames import SequenceFrames
from tisfm.rigid import pose_matrix
from tisfm.status import Status

SHAPE, FOCAL = (240, 320), 256.0
CAMERA = Camera(focal=FOCAL)


def turns(count, step=(0.0, 0.02, 0.0)):
    """Return the poses of a camera that turns by a rotation vector in each frame."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.arange(count)[:, None] * np.array(step)).as_matrix()
    return poses


def scene(count=400, *, seed=0, spread=0.5):
    """Return points around a camera, (N, 3), with depths from 1 − spread to 1 + spread."""
    random = np.random.default_rng(seed)
    rays = random.uniform((-1.5, -0.6, 1), (1.5, 0.6, 1), (count, 3))
    return rays * random.uniform(4 * (1 - spread), 4 * (1 + spread), (count, 1))


def seen(points, poses, *, focal=FOCAL, noise=0.1, seed=1):
    """Return the tracks of points in frames."""
    random, (height, width) = np.random.default_rng(seed), SHAPE
    found = []
    for pose in poses:
        x, y, z = np.linalg.inv(pose)[:3] @ np.column_stack([points, np.ones(len(points))]).T
        image = focal * np.column_stack([x, y]) / z[:, None] + [(width - 1) / 2, (height - 1) / 2]
        image += random.normal(0, noise, image.shape)
        inside = ((image >= 0) & (image < (width, height))).all(axis=1) & (z > 0)
        found.append(Observations(points=image[inside], tracks=np.flatnonzero(inside)))
    return found


def search(observations, camera=CAMERA):
    return RotationSearch(
        observations=observations, views=[], matches={}, camera=camera, shape=SHAPE
    )


def errors(piece, poses):
    """Return the errors of orientations, degrees."""
    found = np.array([pose[:3, :3] for pose in piece.poses.values()])
    true = poses[list(piece.poses)][:, :3, :3]
    relative = np.swapaxes(found[0].T @ found, 1, 2) @ (true[0].T @ true)
    return np.degrees(Rotation.from_matrix(relative).magnitude())


@pytest.mark.parametrize("step", [(0, 0.02, 0), (0.015, 0.005, 0.01), (0, 0, 0.03)])
def test_orientations_with_a_known_focal_length(step):
    poses = turns(12, step)
    piece, estimate = search(seen(scene(), poses)).find_piece(range(12), is_focal_known=True)
    assert estimate is None and piece.only_turns and not piece.points
    assert list(piece.poses) == list(range(12)) and errors(piece, poses).max() < 0.02
    assert all((pose[:3, 3] == 0).all() for pose in piece.poses.values())


@pytest.mark.parametrize("focal", [160.0, 600.0])
def test_focal_length_comes_from_the_rotation(focal):
    poses = turns(8, (0.002, 4 / focal, 0))
    wide = scene(1500) * (2.2 * 256 / focal, 256 / focal, 1)
    found = search(seen(wide, poses, focal=focal), Camera(focal=384.0))
    piece, estimate = found.find_piece(range(8), is_focal_known=False)
    assert abs(estimate.focal - focal) < 3 * estimate.deviation < 0.1 * focal
    assert errors(piece, poses).max() < 0.3


def test_focal_length_comes_from_one_half_of_the_image():
    poses, points = turns(8), scene(1500)
    observations = seen(points[points[:, 1] > 0.1 * points[:, 2]], poses)  # texture below the sky
    piece, estimate = search(observations).find_piece(range(8), is_focal_known=False)
    assert len(piece.poses) == 8 and abs(estimate.focal - FOCAL) < 3 * estimate.deviation
    strict = replace(search(observations), max_deviation=0.2 * estimate.deviation / FOCAL)
    piece, useless = strict.find_piece(range(8), is_focal_known=False)
    assert not useless.is_useful and len(piece.poses) == 8  # with the guess, which is better known


def test_half_of_the_time_without_pairs_is_left_out():
    poses = turns(8)
    pairs = find_frame_pairs(range(8), seen(scene(), poses), [], {}, CAMERA, SHAPE)
    pairs = [pair for pair in pairs if pair.second > 4 and pair.first < 4]
    found = Orientations(rotations=poses[:, :3, :3], focal=FOCAL)
    assert abs(search([])._estimate(found, pairs).focal - FOCAL) < 1
    assert search([])._estimate(found, []) is None


def test_moving_object_does_not_disturb_orientations():
    poses = turns(12)
    still, moving = scene(), scene(80, seed=3) * (0.3, 0.4, 1)
    observations = []
    other_poses = along(12, (0.2, 0, 0, 0, 0, 0))
    for own, other in zip(seen(still, poses), seen(moving, other_poses), strict=True):
        observations.append(
            Observations(
                points=np.vstack([own.points, other.points]),
                tracks=np.r_[own.tracks, 1000 + other.tracks],
            )
        )
    piece, _ = search(observations).find_piece(range(12), is_focal_known=True)
    assert len(piece.poses) == 12 and errors(piece, poses).max() < 0.05


@pytest.mark.parametrize("is_focal_known", [True, False])
@pytest.mark.parametrize("spread", [0.5, 0.0])
def test_moving_camera_is_no_rotation(is_focal_known, spread):
    points = scene(spread=spread)  # without spread, one plane
    poses = along(12, (0.12, 0, 0, 0, 0.002, 0))
    found = search(seen(points, poses)).find_piece(range(12), is_focal_known=is_focal_known)
    assert found is None


def test_turns_before_and_after_a_cut_are_two_pieces():
    first, second = seen(scene(), turns(6)), seen(scene(seed=5), turns(5))
    second = [replace(each, tracks=each.tracks + 1000) for each in second]
    tracks = SequenceTracks(
        observations=[*first, *second], views=[], matches={}, distinct_count=11, shape=SHAPE
    )
    path = PathSolver(tracks=tracks, camera=CAMERA, readout=0.0).solve()
    assert [list(piece.poses) for piece in path.pieces] == [list(range(6)), list(range(6, 11))]
    assert all(piece.only_turns for piece in path.pieces) and not path.missing


def test_small_turn_is_left_alone():
    observations = seen(scene(), turns(12, (0, 0.001, 0)), noise=0.3)
    assert search(observations).find_piece(range(12), is_focal_known=True) is None


def test_pair_rotation_ignores_outliers():
    random = np.random.default_rng(0)
    before = random.uniform(-100, 100, (80, 2))
    rays = np.column_stack([before, np.full(80, FOCAL)])
    true = Rotation.from_rotvec((0.02, -0.05, 0.1)).as_matrix()
    turned = rays @ true.T
    after = FOCAL * turned[:, :2] / turned[:, 2:]
    after[:30] += (15, -8)
    rotation, residuals = fit_rotation(before, after, FOCAL, noise=0.5)
    np.testing.assert_allclose(rotation, true, atol=1e-4)
    assert residuals[30:].max() < 0.05 < 5 < residuals[:30].min()


def test_adjustment_lowers_the_cost_by_all_derivatives():
    """Start far from the truth in every unknown: only right derivatives lead back."""
    poses, points = turns(5, (0.01, 0.03, -0.02)), scene()
    pairs = find_frame_pairs(range(5), seen(points, poses, noise=0.0), [], {}, CAMERA, SHAPE)
    assert {(pair.first, pair.second) for pair in pairs} >= {(0, 1), (0, 2), (0, 4), (3, 4)}
    disturbed = (
        poses[:, :3, :3]
        @ Rotation.from_rotvec(np.random.default_rng(0).normal(0, 0.02, (5, 3))).as_matrix()
    )
    start = Orientations(rotations=disturbed, focal=1.15 * FOCAL)
    found = adjust_orientations(start, pairs, 1.0, with_focal=True)
    assert found.focal == pytest.approx(FOCAL, rel=1e-5)
    relative = np.swapaxes(found.rotations[0].T @ found.rotations, 1, 2) @ poses[:, :3, :3]
    assert Rotation.from_matrix(relative).magnitude().max() < 1e-5
    fixed = adjust_orientations(start, pairs, 1.0, with_focal=False)
    assert fixed.focal == start.focal


def test_pairs_have_few_points_at_most():
    observations = seen(scene(), turns(3))
    pairs = find_frame_pairs([0, 1, 2], observations, [], {}, CAMERA, SHAPE)
    assert all(isinstance(pair, FramePair) and len(pair.before) <= 150 for pair in pairs)
    assert pairs[0].motion == pytest.approx(0.02 * FOCAL, rel=0.3)


POSES = along(6, (0, 0, 0, 0, 0.03, 0))


@pytest.fixture(scope="module")
def turned():
    """Return the reconstruction of a film in which the camera turns by 8°."""
    film = room_film(POSES, 120, 160, samples=1)
    fast = tisfm.Settings.preset("fast", motion="camera")
    return tisfm.reconstruct(film.frames, camera=Camera(focal=96.0), settings=fast)


def test_result_has_orientations_and_no_positions(turned):
    assert set(turned.status) == {"pure_rotation"} and "sideways" in turned.status[0].message
    assert turned.piece.tolist() == [0] * 6 and turned.only_turns(0)
    assert not turned.has_position.any() and (turned.poses[:, :3, 3] == 0).all()
    piece = Piece(poses=dict(enumerate(turned.poses)), views=(), points={})
    assert errors(piece, POSES).max() < 0.2
    assert turned.keyframes == () and np.isnan(turned.depth(2)).all()
    assert len(turned.points()) == 0 and not turned.checks[0].contradicts


def test_piece_with_positions_comes_first(turned):
    status = (*turned.status[:4], Status("converged"), Status("converged"))
    piece = np.array([0, 0, 0, 0, 1, 1], np.int32)
    mixed = replace(turned, status=status, piece=piece, unit=(1.0, 1.0))
    export = ExportRequest(
        result=mixed, frames=SequenceFrames(mixed), chosen=range(6), folder=turned.folder
    )
    assert any("4 frames left out" in note for note in FORMATS["nerfstudio"].notes(export))
    assert mixed.largest_piece == 1 and mixed.has_position.tolist() == [False] * 4 + [True] * 2
    assert piece_frames(mixed) == [[4, 5], [0, 1, 2, 3]] and model_frames(mixed) == {1: [4, 5]}


def test_exports_say_that_positions_are_unknown(turned, tmp_path):
    frames = SequenceFrames(turned)
    export = ExportRequest(result=turned, frames=frames, chosen=range(6), folder=tmp_path)
    assert any("positions are unknown, and 0" in note for note in FORMATS["tum"].notes(export))
    with pytest.raises(ValueError, match="the camera only turns"):
        FORMATS["colmap"].check(export)
    with pytest.raises(ValueError, match="positions"):
        model_frames(turned)
    assert "sideways" in frames.depth_advice


def test_nerfstudio_counts_frames_outside_the_largest_piece_with_positions(turned, tmp_path):
    status = (*turned.status[:4], Status("converged"), Status("converged"))
    piece = np.array([0, 0, 0, 0, 1, 1], np.int32)
    mixed = replace(turned, status=status, piece=piece, unit=(1.0, 1.0))
    export = ExportRequest(
        result=mixed, frames=SequenceFrames(mixed), chosen=range(6), folder=tmp_path
    )
    notes = FORMATS["nerfstudio"].notes(export)
    assert any(note.startswith("only the largest piece; 4 frames") for note in notes), notes


def test_chunks_of_a_turn_join_by_their_orientations(turned):
    turn = pose_matrix((0, 0, 0, 0.1, 0, 0))
    other = replace(turned, poses=turn @ turned.poses)
    np.testing.assert_allclose(
        overlap_sim3(other, turned, [(k, k) for k in range(6)]), turn, atol=1e-12
    )
