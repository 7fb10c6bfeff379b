"""Sequences as a whole: where they are found, and what their files say."""

import re

import numpy as np
import pytest

from tests.datasets.made import COLOUR, HOLE, MAKERS, POSES, H, W, put
from tisfm.datasets import SEQUENCE_LAYOUTS, find_sequences
from tisfm.datasets.calibration import KNOWN_CAMERAS, scale_known_camera
from tisfm.datasets.pose_files import motion_between
from tisfm.formats import FormatError
from tisfm.lens import undistort_depth
from tisfm.metrics import path_length
from tisfm.trajectory import write_kitti, write_tum

COUNT = {"new_tsukuba": 4, "sevenscenes": 5, "calibrated": 4, "tum": 4, "kitti_odometry": 4}


def make_tum(root):
    root = root / "rgbd_freiburg2_desk"
    times = 1000 + np.arange(4) / 30
    for k, time in enumerate(times):
        put(root / "rgb" / f"{time:.6f}.png", COLOUR[k % 2])
    rgb = [f"{time:.6f} rgb/{time:.6f}.png" for time in times]
    (root / "rgb.txt").write_text("\n".join(["# colour", *rgb]))
    late = times[[0, 1, 3]] + 0.01
    for time in late:
        put(root / "depth" / f"{time:.6f}.png", np.full((H, W), 10000, np.uint16))
    (root / "depth.txt").write_text("\n".join(f"{t:.6f} depth/{t:.6f}.png" for t in late))
    kept = [0, 1, 2]
    write_tum(root / "groundtruth.txt", np.array(POSES)[kept], times[kept] + 0.003)


def make_kitti_odometry(root):
    folder = root / "sequences" / "07"
    for k in range(4):
        put(folder / "image_0" / f"{k:06d}.png", COLOUR[k % 2][..., 0])
    (folder / "calib.txt").write_text("P0: 56 0 21.5 0 0 56 14.5 0 0 0 1 0\n")
    (folder / "times.txt").write_text("0\n0.1\n0.2\n0.3\n")
    (root / "poses").mkdir()
    write_kitti(root / "poses" / "07.txt", POSES[:4])


MAKE = {**MAKERS, "tum": make_tum, "kitti_odometry": make_kitti_odometry}


def found(data, kind):
    MAKE[kind](data)
    (sequence,) = find_sequences(data)
    assert sequence.layout == kind
    return sequence


@pytest.mark.parametrize("kind", SEQUENCE_LAYOUTS)
@pytest.mark.parametrize("step", [1, 2])
def test_every_layout_is_found_and_read(data, kind, step):
    loaded = found(data, kind).load(step)
    expected = np.array(POSES[: COUNT[kind]])
    if kind == "new_tsukuba":
        expected[:, :3, 3] /= 100  # cm
    known = np.ones(COUNT[kind], bool)
    if kind == "tum":
        known[3] = False
    assert len(loaded.frames) == len(range(0, COUNT[kind], step)) == len(loaded.depths)
    np.testing.assert_array_equal(loaded.posed, known[::step])
    poses = loaded.poses[loaded.posed]
    np.testing.assert_allclose(poses, expected[::step][known[::step]], atol=1e-7)
    assert all(path.is_file() for path in loaded.frames)
    assert (loaded.times is not None) == (kind in ("tum", "kitti_odometry"))
    if loaded.times is not None:
        rate = {"tum": 30, "kitti_odometry": 10}[kind]
        np.testing.assert_allclose(np.diff(loaded.times), step / rate, atol=2e-6)
    assert path_length(loaded.poses) > 0


def test_names_and_cameras(data):
    for kind in SEQUENCE_LAYOUTS:
        MAKE[kind](data / kind)
    sequences = {sequence.layout: sequence for sequence in find_sequences(data)}
    assert set(sequences) == set(SEQUENCE_LAYOUTS)
    assert sequences["kitti_odometry"].name == "sequences 07"
    assert sequences["tum"].name == "rgbd_freiburg2_desk"
    cameras = {kind: sequence.load().camera for kind, sequence in sequences.items()}
    for kind in ("new_tsukuba", "sevenscenes"):
        assert cameras[kind] == scale_known_camera(KNOWN_CAMERAS[kind], W)
    assert cameras["tum"].focals == pytest.approx((520.9, 521.0))
    assert len(cameras["tum"].distortion) == 5
    assert cameras["kitti_odometry"].center == (21.5, 14.5)
    assert cameras["calibrated"].focal == 56
    assert [s.layout for s in find_sequences(data, "tum")] == ["tum"]


def test_depth_is_read_unchanged(data):
    tum = found(data / "a", "tum").load()
    assert [path is not None for path in tum.depths] == [True, True, False, True]
    assert tum.depth(2) is None
    np.testing.assert_array_equal(tum.depth(3), np.full((H, W), 2, np.float32))  # 1/5000 m
    own = found(data / "b", "calibrated").load(2)
    np.testing.assert_array_equal(np.isnan(own.depth(1)), HOLE)
    assert np.nanmax(own.depth(1)) == 1.25
    scenes = found(data / "c", "sevenscenes").load()
    assert scenes.depth(0).shape == (H, W)


def test_missing_poses_of_frames(data):
    sequence = found(data / "a", "sevenscenes")
    (data / "a" / "frame-000003.pose.txt").unlink()
    (data / "a" / "frame-000001.depth.png").unlink()
    loaded = sequence.load()
    assert loaded.posed.tolist() == [True, True, True, False, True]
    assert loaded.depth(1) is None
    sequence = found(data / "b", "calibrated")
    lines = (data / "b" / "poses.txt").read_text().splitlines()
    (data / "b" / "poses.txt").write_text("\n".join([*lines[:3], " ".join(["nan"] * 12)]))
    assert sequence.load().posed.tolist() == [True, True, True, False]
    (data / "b" / "poses.txt").unlink()
    assert not sequence.load().posed.any()


@pytest.mark.parametrize(
    ("kind", "file", "text", "words"),
    [
        ("calibrated", "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0", "has 1 poses, but there are 4"),
        ("new_tsukuba", "poses_camera_to_world_3x4_cm.txt", "1 0 0 0 0 1 0 0 0 0 1 0", "has 1 row"),
        ("tum", "rgbd_freiburg2_desk/rgb.txt", "1 a\nx b", "line 2 is 'x b': expected a time"),
        ("tum", "rgbd_freiburg2_desk/rgb.txt", "1 a\n1 b", "times[1] is 1.0"),
        ("kitti_odometry", "poses/07.txt", "1 0 0 0 0 1 0 0 0 0 1 0", "has 1 poses, but there"),
        ("kitti_odometry", "sequences/07/times.txt", "0\n", "times are (1,): expected (4,)"),
    ],
)
def test_damage_is_named(data, kind, file, text, words):
    sequence = found(data, kind)
    (data / file).write_text(text)
    with pytest.raises(FormatError, match=re.escape(words)) as error:
        sequence.load()
    assert str(data / file) in str(error.value)


def test_other_folders_are_no_sequences(data):
    MAKE["calibrated"](data / "own")
    for missing in ("camera.txt", "images"):
        (data / "own" / missing).rename(data / "kept")
        with pytest.raises(FileNotFoundError, match="holds no sequence whose path or depth"):
            find_sequences(data)
        (data / "kept").rename(data / "own" / missing)
    (sequence,) = find_sequences(data)
    for step, error, words in (
        (0, ValueError, "step is 0: expected a positive whole number"),
        (4, FormatError, "has 1 frames at a step of 4"),
    ):
        with pytest.raises(error, match=words):
            sequence.load(step)
    with pytest.raises(ValueError, match="layout is 'kitti': expected one of 'new_tsukuba'"):
        find_sequences(data, "kitti")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        find_sequences(data / "gone")


def test_a_path_alone_is_a_truth(data):
    MAKE["calibrated"](data)
    for file in (data / "depth").iterdir():
        file.unlink()
    (data / "depth").rmdir()
    (sequence,) = find_sequences(data)
    assert sequence.load().depths == (None,) * 4


def test_real_sequences(shared_data):
    lengths = {"new_tsukuba": 1.53, "tartanair": 2.92, "hololens": 6.36, "sevenscenes": 0.317,
               "tum_fr1_rpy": 0.280, "fountain": 16.95, "kitti_odometry_06": 59.86}  # fmt: skip
    sequences = {sequence.name: sequence for sequence in find_sequences(shared_data)}
    assert set(lengths) <= set(sequences)
    for name, length in lengths.items():
        assert path_length(sequences[name].load().poses) == pytest.approx(length, rel=5e-3)


@pytest.mark.parametrize("name", ["tartanair", "hololens", "sevenscenes"])
def test_real_depth_moved_by_real_poses_is_the_depth_of_the_next_frame(shared_data, name):
    (sequence,) = find_sequences(shared_data / name)
    loaded = sequence.load(3)
    camera = loaded.camera
    shares = []
    for k in range(0, len(loaded.frames) - 1, 4):
        here, there = (undistort_depth(loaded.depth(index), camera) for index in (k, k + 1))
        center = camera.center_for(*here.shape)
        rows, columns = np.nonzero(np.isfinite(here))
        rays = [(columns - center[0]) / camera.focal, (rows - center[1]) / camera.focal]
        points = np.stack([*rays, np.ones(len(rows))]) * here[rows, columns]
        motion = motion_between(loaded.poses[k], loaded.poses[k + 1])
        x, y, z = motion[:3, :3] @ points + motion[:3, 3:]
        x, y = (np.rint(camera.focal * v / z + c) for v, c in zip((x, y), center, strict=True))
        seen = (x >= 0) & (x < here.shape[1]) & (y >= 0) & (y < here.shape[0])
        expected = there[y[seen].astype(int), x[seen].astype(int)]
        shares.append(np.mean(np.abs(expected - z[seen]) <= 0.03 * z[seen]))
    # Edges, what is hidden and what the sensor missed are the rest.
    assert np.median(shares) > 0.7
