"""Standard deviations of poses, against the spread of the poses of noisy tracks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from tisfm.camera import Camera
from tisfm.metrics import align
from tisfm.reconstruction.calibration import normal_equations
from tisfm.reconstruction.calibration.camera_adjustment import adjust_camera
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.calibration.track_bundle import TrackBundle
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path import pose_deviation
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.pose_deviation import (
    PoseDeviations,
    _find_covariance,
    _find_depth_variances,
    _find_own_variance,
    find_pose_deviations,
)
from tisfm.reconstruction.path.settings import POSE_DEVIATION, PoseDeviationSettings
from tisfm.reconstruction.stages.depth import _find_pose_effects
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import points_of_tracks, triangulate_tracks
from tisfm.rigid import nearest_rotation, pose_matrix

CAMERA, SHAPE = Camera(focal=300.0), (240, 320)
NOISE = 0.1  # px


@pytest.fixture(autouse=True)
def without_factors(monkeypatch):
    """Observations are independent here."""
    plain = replace(POSE_DEVIATION, position_factor=1.0, rotation_factor=1.0)
    monkeypatch.setattr(pose_deviation, "POSE_DEVIATION", plain)


def walk(count=7, *, bend=0.03):
    """Poses of a camera that moves sideways and turns."""
    return {
        3 * k: pose_matrix([0.15 * k, 0.01 * k * k * bend, 0.02 * k, 0.004 * k, bend * k, 0.0])
        for k in range(count)
    }


def tracks_of(poses, focal=CAMERA.focal, count=150, seed=0):
    """Points, and their exact positions in every frame."""
    random = np.random.default_rng(seed)
    points = random.uniform((-2, -1.2, 3), (3, 1.2, 7), (count, 3))
    nothing = Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
    observations = [nothing] * (max(poses) + 1)
    for frame, pose in poses.items():
        x, y, z = np.linalg.inv(pose)[:3] @ np.c_[points, np.ones(count)].T
        image = focal * np.stack([x / z, y / z], axis=1) + CAMERA.center_for(*SHAPE)
        inside = ((image > 0) & (image < (SHAPE[1] - 1, SHAPE[0] - 1))).all(axis=1)
        observations[frame] = Observations(points=image[inside], tracks=np.flatnonzero(inside))
    return Piece(poses=poses, views=tuple(poses), points=dict(enumerate(points))), observations


def noisy(observations, seed, noise=NOISE):
    random = np.random.default_rng(seed)
    return [
        replace(view, points=view.points + noise * random.standard_normal(view.points.shape))
        for view in observations
    ]


def adjusted(piece, observations, focal=CAMERA.focal):
    """The poses that fit the tracks best."""
    bundle = TrackBundle.from_piece(piece, observations, piece.views, CAMERA, SHAPE)
    found = adjust_camera(bundle, focal, scales=(0.5,)).bundle
    bottom = np.tile([[[0.0, 0, 0, 1]]], (len(found.poses), 1, 1))
    poses = np.linalg.inv(np.concatenate([found.poses, bottom], axis=1))
    points = dict(zip(found.tracks.tolist(), found.points, strict=True))
    return replace(piece, poses=dict(zip(piece.poses, poses, strict=True)), points=points)


def deviations_of(piece, observations, focal_deviation=0.0, zoom=None):
    path = CameraPath(
        pieces=(piece,), missing={}, observations=observations, camera=CAMERA, zoom=zoom
    )  # fmt: skip
    return find_pose_deviations(path, piece, SHAPE, focal_deviation)


def errors(piece, truth):
    """Errors of positions, and of rotations in degrees, in the axes of the cameras, (F, 6)."""
    poses, true = (np.array(list(p.poses.values())) for p in (piece, truth))
    centers, true_centers = poses[:, :3, 3], true[:, :3, 3]
    shift = align(centers, true_centers).apply(centers) - true_centers
    between = true[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    turned = nearest_rotation(between.sum(axis=0)) @ poses[:, :3, :3]
    rotation = np.swapaxes(turned, 1, 2) @ true[:, :3, :3]
    shift = np.einsum("nji,nj->ni", true[:, :3, :3], shift)
    return np.c_[shift, np.degrees(Rotation.from_matrix(rotation).as_rotvec())]


def spread_ratio(truth, tracks_of_seed):
    """Return the spread of adjusted poses over their stated deviations, (F, 6)."""
    spread, stated = [], []
    for seed in range(24):
        tracks = tracks_of_seed(seed)
        piece = adjusted(truth, tracks)
        spread.append(errors(piece, truth))
        found = deviations_of(piece, tracks)
        stated.append(np.c_[found.position, found.rotation])
    return np.sqrt(np.mean(np.square(spread), axis=0) / np.mean(np.square(stated), axis=0))


def test_deviations_are_the_spread_of_adjusted_poses():
    truth, observations = tracks_of(walk())
    ratio = spread_ratio(truth, lambda seed: noisy(observations, seed))
    # A deviation from 24 draws is off by 14 %.
    assert ratio.min() > 0.55 and ratio.max() < 1.6
    assert np.median(ratio) == pytest.approx(1, abs=0.15)


def test_drift_of_tracks_is_part_of_the_deviations():
    """Errors that stay in a track from frame to frame cost more than independent ones."""
    truth, observations = tracks_of(walk())

    def drifting(seed):
        random = np.random.default_rng(seed)
        drift = np.cumsum(0.05 * random.standard_normal((len(observations), 150, 2)), axis=0)
        return [
            replace(view, points=view.points + drift[k][view.tracks])
            for k, view in enumerate(observations)
        ]

    ratio = spread_ratio(truth, drifting)
    assert ratio.min() > 0.55 and ratio.max() < 1.7
    assert np.median(ratio) == pytest.approx(1, abs=0.2)


def test_zoom_is_part_of_the_deviations():
    truth, observations = tracks_of(walk())
    tracks = noisy(observations, 0)
    zoom = np.linspace(1, 1.1, len(observations))
    constant, free = deviations_of(truth, tracks), deviations_of(truth, tracks, zoom=zoom)
    assert free.position[:, 2].mean() > 1.2 * constant.position[:, 2].mean()


def test_focal_length_is_part_of_the_deviations():
    truth, observations = tracks_of(walk())
    exact = deviations_of(truth, observations)
    wide = deviations_of(truth, observations, 0.05)
    wrong = errors(adjusted(truth, observations, 1.05 * CAMERA.focal), truth)
    part = np.sqrt(
        np.square(np.c_[wide.position, wide.rotation])
        - np.square(np.c_[exact.position, exact.rotation])
    )
    sizes = np.linalg.norm(part, axis=0), np.linalg.norm(wrong, axis=0)
    np.testing.assert_allclose(*sizes, rtol=0.2, atol=0.1 * sizes[1].max() * 1e-2)


def test_noisier_tracks_have_larger_deviations():
    truth, observations = tracks_of(walk())
    small, large = (
        deviations_of(truth, noisy(observations, 0, noise)) for noise in (NOISE, 1.3 * NOISE)
    )
    assert (large.position > small.position).all() and (large.rotation > small.rotation).all()


def test_straight_path_has_deviations():
    truth, observations = tracks_of(walk(bend=0.0))
    found = deviations_of(truth, noisy(observations, 0))
    assert np.isfinite(found.position).all() and (found.rotation > 0).all()


def test_long_pieces_are_divided_into_windows(monkeypatch):
    truth, observations = tracks_of(walk(8))
    observations = noisy(observations, 0)
    whole = deviations_of(truth, observations)
    windows = PoseDeviationSettings(max_frames=4, position_factor=1.0, rotation_factor=1.0)
    monkeypatch.setattr(pose_deviation, "POSE_DEVIATION", windows)
    found = deviations_of(truth, observations)
    first = tuple(truth.views[:4])
    poses = {frame: truth.poses[frame] for frame in first}
    part = deviations_of(replace(truth, poses=poses, views=first), observations)
    np.testing.assert_allclose(found.position[:4], part.position)
    assert found.frames == whole.frames and np.isfinite(found.position).all()


def test_tracks_that_link_no_frames_give_no_deviations():
    truth, observations = tracks_of(walk())
    alone = [replace(v, tracks=v.tracks + 1000 * k) for k, v in enumerate(observations)]
    points = {1000 * k + j: p for k in range(len(alone)) for j, p in truth.points.items()}
    assert deviations_of(replace(truth, points=points), alone) is None  # fmt: skip


def test_products_of_dense_parts_are_those_of_sparse_matrices(monkeypatch):
    random = np.random.default_rng(0)
    left, right = (
        csr_matrix(random.standard_normal((9, 25)) * (random.random((9, 25)) < 0.4))
        for _ in range(2)
    )
    exact = left.toarray() @ right.toarray().T
    np.testing.assert_allclose(normal_equations.multiply_by_columns(left, right), exact)
    dense = replace(CALIBRATION, min_dense_operations=0, dense_columns=7)
    monkeypatch.setattr(normal_equations, "CALIBRATION", dense)
    np.testing.assert_allclose(normal_equations.multiply_by_columns(left, right), exact)


def test_frames_with_few_tracks_are_left_out():
    truth, observations = tracks_of(walk())
    tracks = noisy(observations, 0)
    poor = truth.views[3]
    tracks[poor] = tracks[poor].select(np.arange(len(tracks[poor].tracks)) < 5)
    found = deviations_of(truth, tracks)
    assert set(found.frames) == set(truth.views) - {poor}
    assert np.isfinite(found.position).all() and found.position.max() < 0.01


def test_frames_are_left_out_until_all_have_enough_tracks():
    """Five tracks link frames 5 and 6 with frame 7, five others link them with frame 8."""
    truth, observations = tracks_of(walk(9))
    tracks = noisy(observations, 0)
    views = [tracks[frame].tracks for frame in truth.views]
    shared = np.intersect1d(np.intersect1d(views[5], views[6]), np.intersect1d(views[7], views[8]))
    for k, members in {5: shared[:10], 6: shared[:10], 7: shared[:5], 8: shared[5:10]}.items():
        kept = tracks[truth.views[k]].select(np.isin(views[k], members))
        tracks[truth.views[k]] = replace(kept, tracks=kept.tracks + 1000)
    points = {**truth.points, **{1000 + track: p for track, p in truth.points.items()}}
    found = deviations_of(replace(truth, points=points), tracks)
    assert found.frames == truth.views[:5] and np.isfinite(found.position).all()


def test_parts_that_were_joined_have_their_own_alignment():
    truth, observations = tracks_of(walk(8))
    tracks = noisy(observations, 0)
    for frame in truth.views[4:]:
        tracks[frame] = replace(tracks[frame], tracks=tracks[frame].tracks + 1000)
    points = {**truth.points, **{1000 + track: p for track, p in truth.points.items()}}
    joined = replace(truth, points=points, joints=(truth.views[4],))
    found = deviations_of(joined, tracks)
    assert found.frames == truth.views
    for rows in (slice(0, 4), slice(4, 8)):
        frames = truth.views[rows]
        poses = {frame: truth.poses[frame] for frame in frames}
        alone = deviations_of(replace(joined, poses=poses, views=frames, joints=()), tracks)
        np.testing.assert_allclose(found.position[rows], alone.position)
        np.testing.assert_allclose(found.relative_depth[rows], alone.relative_depth)


def test_variances_that_are_not_positive_are_unknown(monkeypatch):
    truth, observations = tracks_of(walk())
    monkeypatch.setattr(pose_deviation, "_remove_motions", lambda matrix, _: -np.abs(matrix))
    found = deviations_of(truth, noisy(observations, 0))
    assert np.isnan(found.position).all() and np.isfinite(found.relative_depth).all()


@pytest.mark.parametrize("depth", [-0.5, 1e-3, 0.1, 0.4])
def test_one_bad_point_does_not_spoil_depth(depth, monkeypatch):
    """A point behind the camera, or much too near; all points of a frame count."""
    all_tracks = replace(POSE_DEVIATION, depth_tracks=1000)
    monkeypatch.setattr(pose_deviation, "POSE_DEVIATION", all_tracks)
    truth, observations = tracks_of(walk())
    bundle = TrackBundle.from_piece(truth, noisy(observations, 0), truth.views, CAMERA, SHAPE)
    covariance = _find_covariance(bundle, CAMERA.focal, None)
    usual = _find_depth_variances(bundle, covariance)
    k, points = 3, bundle.points.copy()
    pose = truth.poses[truth.views[k]]
    first = bundle.indices[bundle.views == k][0]
    points[first] = pose[:3, :3] @ (0.3, 0.1, depth) + pose[:3, 3]
    found = _find_depth_variances(replace(bundle, points=points), covariance)
    np.testing.assert_allclose(found, usual, rtol=0.1)


def test_factor_that_depths_share_is_not_that_of_one_outlier():
    random = np.random.default_rng(0)
    relative = 0.5 + 1e-3 * random.standard_normal((40, 12))
    usual = _find_own_variance(relative, np.eye(12))
    assert usual == pytest.approx(12e-6, rel=0.3)
    assert _find_own_variance(relative + 7.0, np.eye(12)) == pytest.approx(usual)
    relative[3] += 1.0
    assert _find_own_variance(relative, np.eye(12)) == pytest.approx(usual, rel=0.1)


def test_depth_of_a_frame_without_deviation_has_the_largest_of_its_piece():
    truth, _ = tracks_of(walk(4))
    some = truth.views[:3]
    deviations = PoseDeviations(
        frames=some,
        position=np.zeros((3, 3)),
        rotation=np.zeros((3, 3)),
        relative_depth=np.array([0.01, np.nan, 0.02]),
    )
    expected = dict(zip(truth.views, [0.01, 0.02, 0.02, 0.02], strict=True))
    assert _find_pose_effects(truth, deviations) == expected
    assert _find_pose_effects(truth, None) == dict.fromkeys(truth.views, 0.0)


def test_depth_is_off_because_of_the_poses():
    """The depth of exact tracks from noisy poses."""
    truth, observations = tracks_of(walk())
    spread, stated = [], []
    for seed in range(24):
        tracks = noisy(observations, seed)
        piece = adjusted(truth, tracks)
        found = deviations_of(piece, tracks)
        stated.append(found.relative_depth)
        points = triangulate_tracks(observations, piece.poses, CAMERA, SHAPE)
        of_frames = []
        for frame in truth.poses:
            pose, true_pose = piece.poses[frame], truth.poses[frame]
            rows, found_points = points_of_tracks(observations[frame], points)
            _, true_points = points_of_tracks(observations[frame].select(rows), truth.points)
            depth = (found_points - pose[:3, 3]) @ pose[:3, 2]
            ratio = depth / ((true_points - true_pose[:3, 3]) @ true_pose[:3, 2])
            of_frames.append(ratio / ratio.mean() - 1)
        spread.append([np.sqrt(np.median(ratio**2)) / 0.6745 for ratio in of_frames])
    ratio = np.sqrt(np.mean(np.square(spread), axis=0) / np.mean(np.square(stated), axis=0))
    assert ratio.min() > 0.6 and ratio.max() < 1.6
