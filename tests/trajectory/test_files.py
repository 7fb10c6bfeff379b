"""Trajectories in the formats of TUM and KITTI."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.trajectory.paths import PATIENT, random_path
from tisfm.formats import FormatError
from tisfm.rigid import rigid_motion
from tisfm.trajectory import (
    Trajectory,
    read_kitti,
    read_trajectory,
    read_tum,
    write_kitti,
    write_tum,
)

PATH = random_path(np.random.default_rng(0), 9, missing=(2, 8))
TIMES = 1305031102.0 + np.arange(9) / 30
GOOD = "1 0 0 0 0 1 0 0 0 0 1 0\n"


def test_kitti_keeps_every_bit_and_every_line(tmp_path):
    file = tmp_path / "poses.txt"
    write_kitti(file, PATH)
    lines = file.read_text().splitlines()
    assert len(lines) == 9 and lines[2].split() == ["nan"] * 12
    found = read_kitti(file)
    np.testing.assert_array_equal(found.poses, PATH)
    assert found.times is None
    np.testing.assert_array_equal(np.flatnonzero(~found.posed), [2, 8])


def test_tum_leaves_out_frames_without_a_pose(tmp_path):
    file = tmp_path / "path.tum"
    write_tum(file, PATH, TIMES)
    lines = file.read_text().splitlines()
    assert lines[0] == "# time tx ty tz qx qy qz qw" and len(lines) == 1 + 7
    found = read_tum(file)
    kept = [0, 1, 3, 4, 5, 6, 7]
    np.testing.assert_array_equal(found.times, TIMES[kept])
    np.testing.assert_array_equal(found.poses[:, :3, 3], PATH[kept, :3, 3])
    np.testing.assert_allclose(found.poses, PATH[kept], atol=1e-14)


@PATIENT
@given(spin=st.tuples(*[st.floats(-2, 2)] * 3), half_turns=st.sampled_from([0, 1]))
def test_every_rotation_survives_its_quaternion(tmp_path_factory, spin, half_turns):
    pose = np.eye(4)
    norm = np.linalg.norm(spin)
    axis = np.array([1.0, 0, 0]) if norm < 1e-3 else np.array(spin) / norm
    turn = axis * np.pi if half_turns else np.array(spin)  # where the real part is 0
    pose[:3, :3] = rigid_motion([0, 0, 0, *turn])[0]
    file = tmp_path_factory.mktemp("tum") / "one.tum"
    write_tum(file, pose[None], [0.0])
    words = [float(word) for word in file.read_text().splitlines()[1].split()]
    assert np.linalg.norm(words[4:]) == pytest.approx(1, abs=1e-15) and words[7] >= 0
    np.testing.assert_allclose(read_tum(file).poses[0], pose, atol=1e-14)


def test_quaternions_follow_the_convention_of_tum(tmp_path):
    file = tmp_path / "quarter.tum"
    half = np.sqrt(0.5)
    file.write_text(f"0 1 2 3 0 0 {half} {half}\n")  # a quarter turn about z
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(read_tum(file).poses[0], expected, atol=1e-15)


def test_either_format_is_recognised(tmp_path):
    for name, write in (("kitti", write_kitti), ("tum", lambda *a: write_tum(*a, TIMES))):
        write(tmp_path / name, PATH)
        assert (read_trajectory(tmp_path / name).times is None) == (name == "kitti")


def test_comments_and_empty_lines_do_not_count(tmp_path):
    file = tmp_path / "poses.txt"
    file.write_text(f"# by hand\n\n{GOOD}\n{GOOD}")
    assert len(read_kitti(file).poses) == 2


@pytest.mark.parametrize(
    ("read", "text", "words"),
    [
        (read_kitti, GOOD + "1 2 3\n", "line 2 has 3 numbers, expected 12"),
        (read_kitti, GOOD + GOOD.replace("0", "x", 1), "line 2: could not convert"),
        (read_kitti, "#\n" + GOOD.replace("1", "2", 1), "line 2 is not a rotation"),
        (read_kitti, GOOD.replace("0", "nan", 1), "line 1 is not finite"),
        (read_tum, "0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "line 2 has the time 0.0, expected"),
        (read_tum, "0 0 0 0 1 0 0 1\n", "line 1 has a quaternion of length 1.41421"),
        (read_tum, "0 0 0 nan 0 0 0 1\n", "line 1 is not finite: leave out"),
        (read_tum, "0 0 0 0 0 0 1\n", "line 1 has 7 numbers, expected 8"),
        (read_trajectory, "a b c\n", "first line has 3 words, expected 8 numbers"),
        (read_trajectory, "# nothing\n", "first line has 0 words"),
        (read_trajectory, "", "is empty"),
    ],
)
def test_damage_is_named_with_its_line(tmp_path, read, text, words):
    file = tmp_path / "damaged.txt"
    file.write_text(text)
    with pytest.raises(FormatError, match=re.escape(words)) as error:
        read(file)
    assert str(file) in str(error.value)


def test_invalid_paths_are_refused_and_leave_no_file(tmp_path):
    wrong = PATH.copy()
    wrong[4, 0, 0] = 5
    for poses, times, words in (
        (wrong, TIMES, "poses[4] is"),
        (PATH[0], TIMES, "poses are (4, 4): expected (N, 4, 4)"),
        (PATH, TIMES[:3], "times are (3,): expected (9,)"),
        (PATH, TIMES[::-1], "times[1] is"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            write_tum(tmp_path / "path.tum", poses, times)
    assert list(tmp_path.iterdir()) == []


def test_a_pose_is_there_or_not():
    partly = PATH.copy()
    partly[3, 1, 2] = np.nan
    assert not Trajectory(poses=partly).posed[3]
    assert np.isnan(Trajectory(poses=partly).poses[3]).all()
    with pytest.raises(ValueError, match="masked"):
        Trajectory(poses=np.ma.masked_array(PATH, PATH > 1))
