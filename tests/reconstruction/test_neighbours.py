"""The choice of frames that determine the depth of a keyframe best."""

from dataclasses import replace

import numpy as np
import pytest

from tisfm import Camera
from tisfm.reconstruction.depth import neighbour_frames
from tisfm.reconstruction.depth.neighbour_frames import (
    choose_neighbours,
    choose_neighbours_of_unmatched,
)

CAMERA, SHAPE = Camera(focal=300.0), (240, 320)


def line(positions):
    """Return poses (N, 4, 4) of a camera that moves to the right and looks ahead."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, 0, 3] = positions
    return poses


def test_frames_of_enough_parallax_are_chosen_and_from_both_sides():
    poses = line(0.01 * np.arange(-40, 41))  # 3 px a frame at depth 1
    chosen = choose_neighbours(poses, 40, 1.0, CAMERA, SHAPE, max_count=4)
    apart = np.array(chosen) - 40
    assert len(chosen) == 4
    assert (apart < 0).any() and (apart > 0).any()
    assert (np.abs(3 * apart) >= 0.02 * SHAPE[1]).all()  # 6 px
    assert (np.abs(3 * apart) <= 0.2 * SHAPE[1]).all()


def test_little_parallax_from_the_other_side_is_better_than_more_from_the_same():
    poses = line([0.0, 0.05, 0.06, -0.02])
    first, second = choose_neighbours(poses, 0, 1.0, CAMERA, SHAPE, max_count=2)
    assert first in (1, 2) and second == 3


def test_far_points_take_frames_with_a_larger_baseline():
    poses = line(0.01 * np.arange(-40, 41))
    near, far = (
        np.abs(np.array(choose_neighbours(poses, 40, d, CAMERA, SHAPE)) - 40).mean()
        for d in (2.0, 0.3)
    )
    assert far > 3 * near


def test_frames_that_look_elsewhere_or_turn_only_are_not_chosen():
    poses = line([0.0, 0.05, 0.0, 0.05, 0.0])
    poses[3, :3, :3] = np.diag([-1.0, 1.0, -1.0])  # looks back
    turn = 0.1
    poses[2, :3, :3] = [
        [np.cos(turn), 0, np.sin(turn)],
        [0, 1, 0],
        [-np.sin(turn), 0, np.cos(turn)],
    ]
    assert choose_neighbours(poses, 0, 1.0, CAMERA, SHAPE) == [1]


def test_frames_without_a_pose_are_not_chosen():
    poses = line([0.0, 0.05, -0.05])
    poses[1] = np.nan
    assert choose_neighbours(poses, 0, 1.0, CAMERA, SHAPE) == [2]
    with pytest.raises(ValueError, match=r"poses\[1\] is not finite"):
        choose_neighbours(poses, 1, 1.0, CAMERA, SHAPE)


def test_unknown_depth_counts_as_the_median():
    poses = line(0.01 * np.arange(-40, 41))
    depth = np.full(SHAPE, 1.0)
    whole = choose_neighbours(poses, 40, depth, CAMERA, SHAPE)
    depth[::2] = np.nan
    depth[:, :50] = 0
    assert choose_neighbours(poses, 40, depth, CAMERA, SHAPE) == whole
    with pytest.raises(ValueError, match="inverse_depth is nowhere positive"):
        choose_neighbours(poses, 40, np.zeros(SHAPE), CAMERA, SHAPE)


def test_no_more_than_asked_for():
    poses = line(0.01 * np.arange(-40, 41))
    for most in (1, 6):
        chosen = choose_neighbours(poses, 40, 1.0, CAMERA, SHAPE, max_count=most)
        assert len(chosen) == most == len(set(chosen))


def drive(count=60, speed=0.5):
    """Return poses (N, 4, 4) of a camera that moves straight ahead."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 2, 3] = speed * np.arange(count)
    return poses


def road_before_a_wall():
    """Return an inverse depth (H, W): a wall at 100, and a road 1.5 below the camera."""
    below = np.arange(SHAPE[0]) - (SHAPE[0] - 1) / 2
    road = np.maximum(below, 0) / (1.5 * CAMERA.focal)
    return np.repeat(np.maximum(road, 0.01)[:, None], SHAPE[1], axis=1)


def more_neighbours(poses, key, depth, first, is_unmatched):
    return choose_neighbours_of_unmatched(
        poses, key, depth, CAMERA, SHAPE, first=first, is_unmatched=is_unmatched
    )


def test_a_road_without_matches_gets_nearer_frames_than_the_wall_behind_it():
    poses, depth, key = drive(), road_before_a_wall(), 30
    first = choose_neighbours(poses, key, depth, CAMERA, SHAPE, max_count=3)
    chosen = more_neighbours(poses, key, depth, first, depth > 0.02)
    assert len(chosen) > 1
    assert np.abs(np.array(chosen) - key).max() < np.abs(np.array(first) - key).max() / 2


def test_frames_in_which_distances_change_much_are_not_chosen_for_a_part(monkeypatch):
    # ahead, a wall at 20 moves by 3 % of the width only in frames that are several metres away
    poses, key = drive(speed=1.0), 30
    is_unmatched = np.zeros(SHAPE, bool)
    is_unmatched[100:140, 140:180] = True

    def farthest(ratio):
        monkeypatch.setattr(
            neighbour_frames, "DEPTH", replace(neighbour_frames.DEPTH, max_distance_ratio=ratio)
        )
        chosen = more_neighbours(poses, key, 1 / 20, [31], is_unmatched)
        return np.abs(np.array(chosen) - key).max()

    assert farthest(1.25) <= 8 < 12 <= farthest(100.0)


def test_first_frames_remain_where_others_show_the_part_no_better():
    poses = line(0.01 * np.arange(-40, 41))
    first = choose_neighbours(poses, 40, 1.0, CAMERA, SHAPE)
    is_left_half = np.arange(SHAPE[1]) < SHAPE[1] / 2
    assert more_neighbours(poses, 40, 1.0, first, np.tile(is_left_half, (SHAPE[0], 1))) == []


def test_a_single_frame_is_not_enough_for_a_part():
    poses, depth = drive(), road_before_a_wall()
    poses[32:] = poses[:30] = np.nan
    assert more_neighbours(poses, 30, depth, [], depth > 0.02) == []


def test_a_part_needs_a_cell():
    with pytest.raises(ValueError, match="is_unmatched is False everywhere"):
        more_neighbours(drive(), 30, 1.0, [31], np.zeros(SHAPE, bool))


def test_cells_of_any_size_choose_the_same_frames():
    poses, depth = drive(), road_before_a_wall()
    first = choose_neighbours(poses, 30, depth, CAMERA, SHAPE, max_count=3)
    is_road = depth > 0.02
    whole = more_neighbours(poses, 30, depth, first, is_road)
    assert more_neighbours(poses, 30, depth, first, is_road[::2, ::2]) == whole
