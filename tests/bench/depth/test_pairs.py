"""Truth from matched points and known poses."""

import numpy as np

from bench.depth.pairs import depth_of_matches
from tisfm.rigid import pose_matrix
from tisfm.scenes import static_scene


def test_points_have_their_true_depth_and_wrong_poses_leave_few():
    scene = static_scene("sideways", 240, 320)
    pose = pose_matrix(scene.motions[0])
    frames = scene.frame0, scene.frame1
    depth = depth_of_matches(*frames, scene.camera, pose)
    known = np.isfinite(depth)
    assert known.sum() > 100
    error = np.abs(depth - scene.depth)[known] / scene.depth[known]
    assert np.median(error) < 0.03
    wrong = pose.copy()
    wrong[:3, 3] = wrong[[1, 0, 2], 3]  # the other way across
    assert np.isfinite(depth_of_matches(*frames, scene.camera, wrong)).sum() < 0.2 * known.sum()
