"""The second motion that a plane allows."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.reconstruction.films import path_error
from tisfm.camera import Camera
from tisfm.reconstruction.mapping import incremental
from tisfm.reconstruction.mapping.database import (
    MatchDirections,
    colmap_camera,
    match_pairs,
    open_database,
)
from tisfm.reconstruction.mapping.incremental import grow_from_poses, grow_models
from tisfm.reconstruction.mapping.model_scores import MatchScorer
from tisfm.reconstruction.mapping.models import find_models
from tisfm.reconstruction.mapping.plane_motion import find_other_motion
from tisfm.reconstruction.mapping.rival import compare_motions
from tisfm.reconstruction.path.path_solver import make_piece
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View

FOCAL, SHAPE = 300.0, (240, 320)
TILTED = np.array([0.4, 0.1, 1.0]) / 5  # m · X = 1 on the plane
TOWARDS = np.array([0.02, -0.01, 0.15])  # step of the camera
ALONG = np.array([0.15, 0.0, -0.06])


def straight(step, count=10, turn=0.02):
    """Return poses, (N, 3, 4), world to camera, of a camera that wobbles along a line."""
    poses = []
    for k in range(count):
        rotation = Rotation.from_rotvec(turn * np.sin([0.7 * k, 0.5 * k + 1, 0.9 * k])).as_matrix()
        poses.append(np.column_stack([rotation, -rotation @ (k * np.asarray(step))]))
    return np.array(poses)


def on_plane(plane, count=200):
    """Return points of a plane in front of the camera, (N, 3)."""
    rays = np.random.default_rng(0).uniform((-0.5, -0.4, 1), (0.5, 0.4, 1), (count, 3))
    return rays / (rays @ plane)[:, None]


def project(pose, points):
    """Return the positions of points in a view, (N, 2), in focal lengths."""
    local = points @ pose[:, :3].T + pose[:, 3]
    return local[:, :2] / local[:, 2:]


def angle(rotation):
    return np.degrees(Rotation.from_matrix(rotation).magnitude())


def test_two_views_of_a_plane_fit_both_motions_exactly():
    poses, points = straight(TOWARDS, count=2), on_plane(TILTED)
    other = find_other_motion(poses, points)
    middle, first = poses[1], poses[0]  # the middle view of two is the last one
    rotation = first[:, :3] @ middle[:, :3].T
    translation = first[:, 3] - rotation @ middle[:, 3]
    plane = middle[:, :3] @ TILTED / (1 + TILTED @ middle[:, :3].T @ middle[:, 3])
    homography = rotation + np.outer(translation, plane)
    np.testing.assert_allclose(other[1], np.eye(4)[:3], atol=1e-9)
    assert angle(other[0, :, :3].T @ rotation) > 0.5
    # The rest of the homography is a translation times the vector of another plane.
    strengths = np.linalg.svd(homography - other[0, :, :3])[1]
    assert strengths[0] > 0.03
    np.testing.assert_allclose(strengths[1:], 0, atol=1e-12)


def circle(count=10):
    """Return poses of a camera that moves along half a circle, parallel to the image."""
    angles = np.linspace(0, np.pi, count)
    return np.array(
        [np.column_stack([np.eye(3), (np.cos(a), np.sin(a), 0.0)]) for a in angles.tolist()]
    )


@pytest.mark.parametrize(
    "poses, points",
    [
        (straight(TOWARDS), on_plane(TILTED) * np.linspace(0.8, 1.2, 200)[:, None]),  # no plane
        (circle(), on_plane(TILTED)),  # no line
        (straight((0.2, 0, 0)), on_plane(TILTED)),  # the other plane lies beside the camera
        (straight(TOWARDS), on_plane(TILTED)[:10]),  # few points
    ],
)
def test_other_scenes_and_paths_have_one_motion(poses, points):
    assert find_other_motion(poses, points) is None


def test_wrong_motion_of_a_plane_is_replaced(monkeypatch):
    """An adjustment does not leave the wrong motion; the other motion explains more matches."""
    poses, points = straight(TOWARDS), on_plane(TILTED)
    camera, random = Camera(focal=FOCAL), np.random.default_rng(1)
    center = np.array(camera.center_for(*SHAPE))
    views = []
    for k, pose in enumerate(poses):
        seen = FOCAL * project(pose, points) + center + random.normal(0, 0.05, (len(points), 2))
        observations = Observations(points=seen, tracks=np.arange(len(points)))
        views.append(View(frame=k, observations=observations, detected=np.empty((0, 2))))
    pairs = match_pairs(views, {})
    directions = MatchDirections(views, pairs, camera, SHAPE)
    scorer = MatchScorer(views, pairs, SHAPE)
    with open_database(views, pairs, colmap_camera(camera, SHAPE)) as database:
        starts = {k: pose for k, pose in enumerate(find_other_motion(poses, points), start=1)}
        wrong = grow_from_poses(database, starts, are_poses_fixed=False)
        assert model_error(wrong, poses) > 0.005
        monkeypatch.setattr(incremental, "_build_model", lambda *arguments: wrong)
        (right,) = grow_models(database, directions, len(views), scorer)
    assert model_error(right, poses) < 0.0005
    assert scorer.score(right) > scorer.score(wrong)


def model_error(model, poses):
    """Return the error of the path of a pycolmap model, as a share of its length."""
    found = [model.images[k].cam_from_world().matrix() for k in range(1, len(poses) + 1)]
    found, true = (
        np.linalg.inv([np.vstack([pose, np.eye(4)[3]]) for pose in path]) for path in (found, poses)
    )
    return path_error(found, true)


def test_rival_says_how_far_the_two_motions_differ():
    poses = straight(ALONG, count=4, turn=0.0)
    turn = Rotation.from_euler("y", 2, degrees=True).as_matrix()
    others = np.array([np.linalg.matrix_power(turn, k) @ pose for k, pose in enumerate(poses)])
    rival = compare_motions(poses, others, 1.01)
    assert rival.rotation == pytest.approx(2)
    assert compare_motions(poses, poses, 1.0).direction == pytest.approx(0, abs=1e-5)
    backward = poses * (1, 1, 1, -1)
    assert compare_motions(poses, backward, 1.0).direction == pytest.approx(180)
    assert "rotations by 2.0°" in rival.message and "more than a plane" in rival.message


@pytest.mark.parametrize(("noise", "is_near"), [(1.0, True), (0.05, False)])
def test_near_rival_of_a_plane_is_kept(noise, is_near):
    """With much noise, the matches hardly tell the two motions apart."""
    found = find_models(views_of_plane(noise), {}, Camera(focal=FOCAL), SHAPE)
    assert len(found) == 1 and len(found[0].poses) == 10
    assert (found[0].rival is not None) == is_near
    assert (make_piece(found[0]).rival is not None) == is_near


def views_of_plane(noise):
    """Return views of a plane that the camera nears; positions of points have noise, px."""
    points, random = on_plane(TILTED), np.random.default_rng(1)
    center = np.array(Camera(focal=FOCAL).center_for(*SHAPE))
    views = []
    for k, pose in enumerate(straight(TOWARDS)):
        seen = FOCAL * project(pose, points) + center + random.normal(0, noise, (len(points), 2))
        observations = Observations(points=seen, tracks=np.arange(len(points)))
        views.append(View(frame=k + 5, observations=observations, detected=np.empty((0, 2))))
    return views
