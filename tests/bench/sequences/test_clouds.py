"""Errors of fused points, on a wall whose distance is known."""

import numpy as np
import pytest

import tisfm
from bench.sequences import clouds
from bench.sequences.cloud_errors import TrueFrame, align_surfaces, cloud_errors
from tisfm.rigid import pose_matrix

CAMERA = tisfm.Camera(60.0)


def frame(offset=0.0):
    """A frame that sees a wall 2 m ahead."""
    depth = np.full((48, 64), 2.0, np.float32)
    return TrueFrame(depth=depth, pose=pose_matrix((offset, 0, 0, 0, 0, 0)), camera=CAMERA)


TRUTH = [frame(), frame(0.1)]


def test_the_true_surface_is_exact_and_complete():
    points = np.concatenate([true.surface(true.depth)[0] for true in TRUTH])
    errors = cloud_errors(points, TRUTH, 40.0)
    assert errors.accuracy == errors.completeness == (100, 100)
    assert cloud_errors(points, TRUTH, 1.0).completeness == (0, 0)  # no true point is nearer than 1


def test_points_before_the_surface_are_wrong():
    points, _, _ = TRUTH[0].surface(TRUTH[0].depth, step=1)
    points[: len(points) // 2] *= 0.97
    errors = cloud_errors(points, TRUTH, 40.0)
    # At the border of the image, by rounding, some points are not in the frame.
    assert errors.accuracy == pytest.approx((50, 100), abs=2)


def test_half_of_the_surface_is_half_complete():
    points, _, _ = TRUTH[0].surface(TRUTH[0].depth)
    left = points[points[:, 0] < 0]
    errors = cloud_errors(left, TRUTH[:1], 40.0)
    assert errors.accuracy == (100, 100)
    assert errors.completeness == pytest.approx((50, 50), abs=10)
    assert cloud_errors(np.empty((0, 3)), TRUTH, 40.0).completeness == (0, 0)


def test_surfaces_are_aligned_by_their_depth():
    """A reconstruction in another unit and other axes is taken to the true world."""
    turn = pose_matrix((0.3, -0.2, 0.1, 0.1, 0.2, -0.1))
    poses = []
    for true in TRUTH:
        pose = turn @ true.pose
        pose[:3, 3] /= 4
        poses.append(pose)
    depths = [true.depth / 4 for true in TRUTH]
    found = align_surfaces(depths, np.array(poses), TRUTH)
    assert found.scale == pytest.approx(4)
    centres = np.array([pose[:3, 3] for pose in poses])
    np.testing.assert_allclose(found.apply(centres), [t.pose[:3, 3] for t in TRUTH], atol=1e-6)


def test_the_table_has_a_row_for_each_cloud():
    row = {
        "run": "fast, given", "cloud": "points, normal", "accuracy": (91.04, 98.0),
        "completeness": (70.0, 80.0), "points": 123, "seconds": None,
    }  # fmt: skip
    text = clouds.report({"threads": 2}, [row])
    assert "| fast, given | points, normal | 91.0 | 98.0 | 70.0 | 80.0 | 123 | – |" in text
    assert "Completeness is the share" in text
