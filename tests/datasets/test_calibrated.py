"""Folders of images with camera, poses and depth maps."""

import numpy as np
import pytest

from tests.datasets.made import HOLE, MOTION, make_calibrated
from tisfm.datasets import find_pairs
from tisfm.formats import FormatError


def calibrate(root, heading, numbers):
    (root / "camera.txt").write_text(f"{heading}\n{numbers}\n")


def test_depth_camera_and_pose(data):
    make_calibrated(data)
    calibrate(data, "cx cy depth_scale fx fy k1 k2 p1 p2", "20 15 5000 50 56 .1 .01 0 .001")
    loaded = find_pairs(data)[1].load()
    assert loaded.camera.focals == pytest.approx((50, 56)) and loaded.camera.center == (20, 15)
    assert loaded.camera.distortion == (0.1, 0.01, 0, 0.001)
    np.testing.assert_array_equal(np.isnan(loaded.depth), HOLE)
    np.testing.assert_allclose(loaded.depth[~HOLE], 0.25)
    np.testing.assert_allclose(loaded.pose, MOTION, atol=1e-6)


def test_without_a_scale_depth_is_in_millimetres(data):
    make_calibrated(data)
    np.testing.assert_allclose(np.nanmax(find_pairs(data)[0].load().depth), 1.25)


@pytest.mark.parametrize("names", ["0123", ["9", "10", "11", "100"]])
def test_poses_belong_to_images_in_natural_order(data, names):
    make_calibrated(data, names)
    pairs = find_pairs(data, step=2)
    assert [(pair.name, pair.pose_rows) for pair in pairs] == [
        (names[0], (0, 2)),
        (names[1], (1, 3)),
    ]
    np.testing.assert_allclose(pairs[0].load().pose, MOTION @ MOTION, atol=1e-6)


def test_either_poses_or_depth_suffice(data):
    make_calibrated(data)
    (data / "depth" / "1.png").unlink()
    pairs = find_pairs(data)
    assert [pair.knows_depth for pair in pairs] == [True, False, True]
    assert pairs[1].load().depth is None and pairs[1].load().pose is not None
    (data / "poses.txt").unlink()
    pairs = find_pairs(data)
    assert [pair.name for pair in pairs] == ["0", "2"]
    assert not any(pair.knows_pose for pair in pairs) and pairs[0].load().pose is None


@pytest.mark.parametrize("missing", ["camera.txt", "images"])
def test_without_camera_or_images_there_is_no_pair(data, missing):
    make_calibrated(data)
    (data / missing).rename(data / "other")
    with pytest.raises(FileNotFoundError, match=r"calibrated: images/ with camera\.txt"):
        find_pairs(data)


@pytest.mark.parametrize(
    ("heading", "numbers", "words"),
    [
        ("", "", "is not a calibration: expected a heading such as fx fy cx cy"),
        ("fx fy cx cy", "", "is not a calibration"),
        ("fx fy cx cy", "1 2 3", "is not a calibration"),
        ("fx fy cx cy", "1 2 3 4\n1 2 3 4", "is not a calibration"),
        ("1 2 3 4", "1 2 3 4", "has the heading 1 2 3 4: expected each of fx fy cx cy once"),
        ("fx fy cx", "1 2 3", "has the heading fx fy cx:"),
        ("fx fy cx cy fx", "1 2 3 4 5", "has the heading"),
        ("fx fy cx cy", "1 2 x 4", r"could not convert .* 'x', expected numbers"),
        ("fx fy cx cy k1 k2 p1", "1 1 1 1 0 0 0", "no usable camera: distortion has 3"),
        ("fx fy cx cy k1 p1", "1 1 1 1 0 0", "has k1 p1: expected k1 k2"),
        ("fx fy cx cy", "-1 2 3 4", "states no usable camera: focal.0. is -1"),
        ("fx fy cx cy", "1 2 nan 4", "states no usable camera: center.0. is nan"),
        ("fx fy cx cy depth_scale", "1 1 1 1 0", "the depth_scale 0, expected a positive"),
    ],
)
def test_calibrations_that_are_refused(data, heading, numbers, words):
    make_calibrated(data)
    calibrate(data, heading, numbers)
    with pytest.raises(FormatError, match=words) as caught:
        find_pairs(data)[0].load()
    assert "camera.txt" in str(caught.value)


def test_too_few_poses(data):
    make_calibrated(data)
    rows = (data / "poses.txt").read_text().splitlines()
    (data / "poses.txt").write_text("\n".join(rows[:3]))
    pairs = find_pairs(data)
    assert pairs[1].load().pose is not None
    with pytest.raises(FormatError, match="has 3 rows, so there is no pose of frame 3"):
        pairs[2].load()
