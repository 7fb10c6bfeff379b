"""Assignment of given poses to frames."""

import numpy as np
import pytest

from tests.reconstruction.films import along
from tisfm.reconstruction.path.given_poses import find_frame_poses
from tisfm.trajectory import Trajectory

PATH = along(6)
TIMES = 0.1 * np.arange(6)


def test_each_frame_gets_the_pose_that_is_nearest_in_time():
    times = np.array([0.02, 0.11, 0.24, 0.46, 0.52])
    poses, missing = find_frame_poses(Trajectory(poses=PATH[:5], times=times), TIMES.tolist())
    for frame, place in ((0, 0), (1, 1), (2, 2), (5, 4)):
        np.testing.assert_array_equal(poses[frame], PATH[place])
    # The frame at 0.5 s takes the pose at 0.52 s, so the pose at 0.46 s has no frame left.
    assert sorted(missing) == [3, 4]
    assert np.isnan(poses[[3, 4]]).all()
    assert missing[3].message == "no pose is given within 0.05 s of it"


@pytest.mark.parametrize("times", [[None] * 6, [0.0, None, 0.2, 0.3, 0.4, 0.5], [0.0] * 6])
def test_without_times_of_all_frames_poses_go_by_their_order(times):
    holed = PATH.copy()
    holed[2] = np.nan
    for given in (Trajectory(poses=holed), Trajectory(poses=holed, times=TIMES + 7)):
        poses, missing = find_frame_poses(given, times)
        np.testing.assert_array_equal(poses, holed)
        assert {k: why.message for k, why in missing.items()} == {2: "no pose is given for it"}


def test_poses_without_times_go_by_their_order():
    poses, missing = find_frame_poses(Trajectory(poses=PATH), TIMES.tolist())
    np.testing.assert_array_equal(poses, PATH)
    assert missing == {}


def test_as_many_poses_as_frames_are_needed_where_times_are_not_known():
    with pytest.raises(ValueError, match="poses are 6, but there are 5 frames"):
        find_frame_poses(Trajectory(poses=PATH), [None] * 5)
    with pytest.raises(ValueError, match="poses are 6 with times, but the 5 frames have no"):
        find_frame_poses(Trajectory(poses=PATH, times=TIMES), [None] * 5)


def test_times_of_another_clock_are_refused():
    with pytest.raises(ValueError, match=r"no pose is within 0\.05 s of a frame: frames are from"):
        find_frame_poses(Trajectory(poses=PATH, times=TIMES + 1.3e9), TIMES.tolist())
