"""The place that a browser begins at: all is in sight, upright, whatever the window."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.view.results import write_reconstruction
from tisfm.results.opening import open_result
from tisfm.view.viewpoint import FOV, overview

FRUSTUM = np.array([(0, 0, 0), (0.1, 0.1, 0.2), (-0.1, 0.1, 0.2), (0.1, -0.1, 0.2)])


def slopes(pose, points):
    """Return where points are seen from a pose, (N, 2), and their depths, (N,)."""
    inside = (points - pose[:3, 3]) @ pose[:3, :3]
    return inside[:, :2] / inside[:, 2:], inside[:, 2]


@given(
    aspect=st.floats(0.3, 3),
    wide=st.floats(0.05, 3),
    depth=st.floats(0.01, 1000),
    deep=st.floats(0.01, 1.5),
)
def test_camera_and_points_are_in_sight(aspect, wide, depth, deep):
    generator = np.random.default_rng(1)
    rays = np.concatenate([generator.uniform(-wide, wide, (300, 2)), np.ones((300, 1))], axis=1)
    points = rays * generator.uniform(depth, depth * (1 + deep), (300, 1))
    whole = FRUSTUM * depth
    pose, distance = overview(points, whole, aspect=aspect)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(pose[:3, :3]) > 0 and distance > 0
    half = np.tan(FOV / 2) * np.array((aspect, 1.0))
    for places, share in ((points, 0.8), (whole, 1.0)):
        seen, depths = slopes(pose, places)
        assert ((np.abs(seen) < half).all(axis=1) & (depths > 0)).mean() >= share


def test_the_viewpoint_is_upright_and_looks_like_the_camera():
    points = np.random.default_rng(0).uniform((-1, -1, 2), (1, 1, 3), (500, 3))
    up = np.array((np.sin(0.4), -np.cos(0.4), 0))  # the camera was held at a slant
    pose, _ = overview(points, FRUSTUM, up=up)
    assert pose[2, 2] > 0.9
    assert up @ pose[:3, 0] == pytest.approx(0, abs=1e-9) and up @ pose[:3, 1] < -0.9


def test_without_points_the_camera_is_in_sight():
    pose, distance = overview(np.zeros((0, 3)), FRUSTUM)
    seen, depths = slopes(pose, FRUSTUM)
    assert np.isfinite(pose).all() and distance > 0
    assert (np.abs(seen) < np.tan(FOV / 2) * 1.2).all() and (depths > 0).all()


def test_up_is_how_cameras_were_held(tmp_path):
    pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")
    from tisfm.view.page import ViewerPage

    turn = np.eye(4)
    turn[:3, :3] = ((1, 0, 0), (0, 0, 1), (0, -1, 0))  # Y of the camera is −Z of the world
    shot = write_reconstruction(tmp_path / "before")
    write_reconstruction(tmp_path / "r", changes={"poses": turn @ shot.poses})
    page = ViewerPage(open_result(tmp_path / "r"), port=0)
    page.stop()
    assert page.scene.up == pytest.approx((0, 0, 1), abs=0.1)
