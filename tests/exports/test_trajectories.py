"""Paths for TUM's and KITTI's tools."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.exports.made import made
from tests.trajectory.paths import PATIENT, random_path
from tisfm.exports import write_kitti_paths, write_tum_paths
from tisfm.exports.export_request import frame_rate, frame_times
from tisfm.trajectory import read_kitti, read_tum


def stamps(file):
    return [float(line) for line in file.read_text().splitlines()]


@PATIENT
@given(
    piece=st.lists(st.integers(-1, 2), min_size=1, max_size=9).filter(lambda p: max(p) >= 0),
    seed=st.integers(0, 99),
    rate=st.one_of(st.none(), st.floats(1, 120)),
)
def test_every_segment_survives_its_files(tmp_path_factory, piece, seed, rate):
    place = tmp_path_factory.mktemp("paths")
    numbers = sorted({p for p in piece if p >= 0})
    piece = [numbers.index(p) if p >= 0 else -1 for p in piece]  # there is none without a frame
    poses = random_path(np.random.default_rng(seed), len(piece))
    result = made(place / "walk", count=len(piece), piece=piece, poses=poses, with_depth=())
    tum = write_tum_paths(result, place, frames_per_second=rate)
    kitti = write_kitti_paths(result, place, frames_per_second=rate)
    assert len(tum) == len(numbers) and len(kitti) == 2 * len(numbers)
    seen, sizes = [], []
    for file, poses_file, times_file in zip(tum, kitti, kitti[len(tum) :], strict=False):
        found = read_tum(file)
        frames = np.rint(found.times * (rate or 1)).astype(int)
        np.testing.assert_allclose(found.poses, poses[frames], atol=1e-12)
        np.testing.assert_array_equal(read_kitti(poses_file).poses, poses[frames])
        np.testing.assert_array_equal(stamps(times_file), found.times)
        assert len({piece[frame] for frame in frames}) == 1
        seen += list(frames)
        sizes.append(len(frames))
    assert sorted(seen) == [k for k, p in enumerate(piece) if p >= 0]
    assert sizes == sorted(sizes, reverse=True)
    assert tum[0].name == "trajectory.tum"
    assert [file.name for file in tum[1:]] == [
        f"trajectory-piece{k}.tum" for k in range(2, len(tum) + 1)
    ]


def test_times_are_those_of_the_source(tmp_path):
    times = (10.0, 10.1, 10.3, 10.4, 10.5, 10.6)
    result = made(tmp_path / "walk", times=times, piece=[0, 0, -1, 0, 0, 0])
    (file,) = write_tum_paths(result, tmp_path, frames=range(1, 6, 2))
    np.testing.assert_array_equal(read_tum(file).times, [10.1, 10.4, 10.6])


def test_half_known_times_are_not_mixed_with_numbers():
    np.testing.assert_array_equal(frame_times((0.5, None, 1.5)), [0, 1, 2])
    np.testing.assert_array_equal(frame_times((0.5, 0.4, 1.5)), [0, 1, 2])
    assert frame_rate((0.0, 0.04, 0.09, 0.13), range(4)) == pytest.approx(25)
    assert frame_rate((0.0, None), range(2)) == 25.0
    assert frame_rate((0.0, None), range(2), 12) == 12.0
    with pytest.raises(ValueError, match="frames_per_second is 0"):
        frame_rate((), (), 0)


def test_a_path_without_a_pose_is_refused(tmp_path):
    result = made(tmp_path / "walk", count=3, piece=[-1, -1, 0])
    with pytest.raises(ValueError, match=r"none of 2 frames in .* has a pose"):
        write_tum_paths(result, tmp_path, frames=[0, 1])
    with pytest.raises(IndexError, match="frame is 3: expected 0 to 2"):
        write_kitti_paths(result, tmp_path, frames=[3])
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]


def test_evo_reads_them(tmp_path):
    evo = shutil.which("evo_traj", path=os.pathsep.join(
        [str(Path(sys.executable).parent), os.environ.get("PATH", "")]
    ))  # fmt: skip
    if evo is None:
        pytest.skip("evo_traj is not installed: pip install evo")
    result = made(tmp_path / "walk", piece=[0, 0, -1, 0, 0, 0])
    files = {"tum": write_tum_paths(result, tmp_path)[0]}
    files["kitti"] = write_kitti_paths(result, tmp_path)[0]
    length = np.linalg.norm(np.diff(result.poses[[0, 1, 3, 4, 5], :3, 3], axis=0), axis=1).sum()
    for kind, file in files.items():
        done = subprocess.run(
            [evo, kind, str(file)],
            env=os.environ | {"HOME": str(tmp_path), "USERPROFILE": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert "infos:\t5 poses" in done.stdout
        assert f"{length:.3f}m path length" in done.stdout
