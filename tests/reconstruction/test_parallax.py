"""Parallax beyond a homography and beyond a rotation, with directions from formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tisfm.reconstruction.mapping.parallax import homography_residuals, rotation_residuals

NOISE = 3e-4  # rad


def directions(points):
    """Return unit directions to points, (N, 2), in focal lengths."""
    rays = np.column_stack([points, np.ones(len(points))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def matches(depth, translation, rotation, *, focal=1.0, outliers=0, noise=NOISE):
    """Return directions to the same points in two views.

    `focal` is the true focal length over the stated one; `depth` maps positions, (N, 2), to Z.
    """
    random = np.random.default_rng(0)
    before = random.uniform(-0.6, 0.6, (300, 2))
    rays = np.column_stack([before / focal, np.ones(300)])
    moved = (rays * depth(before)[:, None]) @ Rotation.from_rotvec(rotation).as_matrix().T
    moved += translation
    after = focal * moved[:, :2] / moved[:, 2:] + random.normal(0, noise, (300, 2))
    after[:outliers] += random.uniform(-0.2, 0.2, (outliers, 2))
    return directions(before), directions(after)


def far_and_near(points):
    return np.where(np.sin(40 * points[:, 0]) > 0, 2.0, 4.0)


def tilted(points):
    return 3 / (1 + 0.5 * points[:, 0])


@pytest.mark.parametrize("focal", [0.55, 0.8, 1.0, 1.3, 1.9])
@pytest.mark.parametrize("rotation", [(0, 0.05, 0), (0.1, 0.2, 0.1), (0, 0, 0.5), (0, 0, 0)])
def test_rotation_explains_turning_cameras_for_any_focal_length(focal, rotation):
    pair = matches(far_and_near, np.zeros(3), rotation, focal=focal, outliers=30)
    for left in (rotation_residuals(*pair), homography_residuals(*pair)):
        assert np.median(left) < 3 * NOISE
        assert np.median(left[:30]) > 50 * NOISE  # outliers do not affect the fit


def test_focal_length_beyond_the_limits_leaves_parallax():
    """Three times the stated focal length is beyond the search: the rest counts as parallax."""
    pair = matches(far_and_near, np.zeros(3), (0.1, 0.3, 0), focal=3.0, noise=0)
    assert np.median(rotation_residuals(*pair)) > 10 * NOISE


@pytest.mark.parametrize("depth", [tilted, lambda points: np.full(len(points), 3.0)])
@pytest.mark.parametrize("translation", [(0.4, 0, 0), (0, -0.4, 0.05), (0.05, 0.05, -0.2)])
def test_plane_has_parallax_beyond_a_rotation_but_not_beyond_a_homography(depth, translation):
    if translation[2] < 0 and depth is not tilted:
        translation = (0.4, 0.3, 0)  # motion straight towards a plane looks like a zoom
    pair = matches(depth, np.array(translation), (0.01, 0.02, 0.0))
    assert np.median(homography_residuals(*pair)) < 3 * NOISE
    assert np.median(rotation_residuals(*pair)) > 6 * NOISE


def test_depth_has_parallax_beyond_both():
    pair = matches(far_and_near, np.array([0.1, 0.02, 0]), (0, 0.02, 0))
    assert np.median(homography_residuals(*pair)) > 10 * NOISE
    assert np.median(rotation_residuals(*pair)) > 10 * NOISE


def test_no_directions_and_directions_behind_the_camera():
    assert rotation_residuals(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    before, after = matches(far_and_near, np.zeros(3), (0, 0.05, 0))
    after[7] = -after[7]
    left = rotation_residuals(before, after)
    assert left[7] == np.pi and np.median(np.delete(left, 7)) < 3 * NOISE
