"""Every layout is found and read, and what belongs to one of them."""

import os

import numpy as np
import pytest

import tisfm
from tests.datasets.made import (
    COLOUR,
    FLOW,
    HOLE,
    MAKERS,
    NAMES,
    OCCLUDED,
    WITH_DEPTH,
    WITH_FLOW,
    WITH_POSE,
    H,
    W,
    label,
    make_kitti,
    make_middlebury,
    make_middlebury_original,
    make_sintel,
    make_stereo,
    make_yosemite,
    write_tiff,
)
from tisfm.datasets import LAYOUTS, find_pairs
from tisfm.formats import write_png
from tisfm.rigid import pose_matrix


def test_pairs_are_found_and_read(data, kind):
    MAKERS[kind](data)
    pairs = find_pairs(data)
    assert [label(pair) for pair in pairs] == NAMES[kind]
    for pair in pairs:
        assert pair.layout == kind.split()[0]
        loaded = pair.load()
        first, second = (loaded.frame0, loaded.frame1)
        assert first.shape[:2] == second.shape[:2] == (H, W)
        assert not np.array_equal(first, second) or "0002" in pair.name
        known = [loaded.flow is not None, loaded.depth is not None, loaded.pose is not None]
        assert known == [kind in kinds for kinds in (WITH_FLOW, WITH_DEPTH, WITH_POSE)]
        assert loaded.pose_given == (pair.layout == "stereo")
        if loaded.flow is not None:
            assert loaded.flow.shape == (H, W, 2) and loaded.flow.dtype == np.float32
            np.testing.assert_array_equal(np.isnan(loaded.flow).any(axis=2), HOLE)
        if loaded.flow is not None and pair.layout != "stereo":
            np.testing.assert_array_equal(loaded.flow[~HOLE], FLOW[~HOLE].astype(np.float32))
        if loaded.depth is not None:
            assert loaded.depth.shape == (H, W) and loaded.depth.dtype == np.float32
        if loaded.pose is not None:
            assert loaded.pose.shape == (4, 4) and loaded.pose.dtype == np.float64
        for mask in (loaded.occlusion, loaded.sky):
            assert mask is None or (mask.shape == (H, W) and mask.dtype == bool)


def test_the_layout_can_be_given(data, kind):
    MAKERS[kind](data)
    layout = kind.split()[0]
    assert find_pairs(data, layout=layout) == find_pairs(data)
    for other in set(LAYOUTS) - {layout}:
        with pytest.raises(FileNotFoundError, match=f"{other}: ") as caught:
            find_pairs(data, layout=other)
        assert LAYOUTS[other].expected_files in str(caught.value)
        assert LAYOUTS[layout].expected_files not in str(caught.value)


def test_from_above_and_from_within(data, kind, tmp_path, monkeypatch):
    MAKERS[kind](data)
    pairs = find_pairs(data)
    assert find_pairs(tmp_path) == pairs
    monkeypatch.chdir(data)
    assert find_pairs(".") == find_pairs("../data/") == pairs
    folder = data / "training" if (data / "training").is_dir() else data
    assert find_pairs(folder) == pairs


def test_several_datasets_below_one_folder(tmp_path):
    for kind, make in MAKERS.items():
        make_in = tmp_path / kind.replace(" ", "_")
        make_in.mkdir()
        make(make_in)
    pairs = find_pairs(tmp_path)
    assert len(pairs) == sum(map(len, NAMES.values()))
    assert {pair.layout for pair in pairs} == set(LAYOUTS)
    assert len({label(pair) for pair in pairs}) == len(pairs)
    only = find_pairs(tmp_path, layout="sintel")
    assert only == [pair for pair in pairs if pair.layout == "sintel"]


def test_frames_are_red_green_blue(data):
    make_middlebury(data)
    loaded = find_pairs(data)[0].load()
    np.testing.assert_array_equal(loaded.frame0, COLOUR[0])
    np.testing.assert_array_equal(loaded.frame1, COLOUR[1])


def test_middlebury_of_one_folder_alone(data):
    make_middlebury(data)
    assert [label(pair) for pair in find_pairs(data / "Room")] == ["data/Room"]
    make_middlebury_original(data / "whole")
    (pair,) = find_pairs(data / "whole" / "other-gt-flow")
    assert label(pair) == "whole/Blocks"
    pair.load()


@pytest.mark.parametrize(
    ("images", "calibration", "focal"),
    [("image_2", "calib_cam_to_cam", 702), ("colored_0", "calib", 702), ("image_0", "calib", 700)],
)
def test_kitti_of_both_years(data, images, calibration, focal):
    make_kitti(data, images, calibration)
    for pair in find_pairs(data):
        loaded = pair.load()
        np.testing.assert_array_equal(loaded.occlusion, OCCLUDED & ~HOLE)
        assert loaded.camera == tisfm.Camera(focal, (22, 15))


def test_kitti_without_occlusions(data):
    make_kitti(data)
    for path in (data / "training" / "flow_occ").iterdir():
        path.unlink()
    (data / "training" / "flow_occ").rmdir()
    loaded = find_pairs(data)[0].load()
    assert loaded.occlusion is None
    np.testing.assert_array_equal(np.isnan(loaded.flow).any(axis=2), HOLE | OCCLUDED)


def test_sintel_masks_and_camera(data):
    make_sintel(data)
    pairs = find_pairs(data)
    assert [pair.frame1.name for pair in pairs[:2]] == ["frame_0002.png", "frame_0003.png"]
    for pair in pairs:
        loaded = pair.load()
        np.testing.assert_array_equal(loaded.occlusion, OCCLUDED)
        assert loaded.camera == tisfm.Camera(1120, (21.5, 14.5))


def test_sintel_of_one_pass(data):
    make_sintel(data, passes=("final",))
    assert {pair.dataset for pair in find_pairs(data)} == {"data final"}


def test_yosemite_sky(data):
    make_yosemite(data)
    loaded = find_pairs(data)[0].load()
    np.testing.assert_array_equal(loaded.sky, HOLE)
    assert loaded.occlusion is None and loaded.camera is None
    assert [p.name for p in (find_pairs(data)[0].frame0, find_pairs(data)[0].frame1)] == [
        "yos9.tif",
        "yos10.tif",
    ]


def test_disparity_is_motion_to_the_left(data):
    make_stereo(data)
    whole, scene = (pair.load() for pair in find_pairs(data))
    assert np.unique(whole.flow[~HOLE], axis=0).tolist() == [[-7, 0]]
    assert np.unique(scene.flow[~HOLE], axis=0).tolist() == [[-3.25, 0]]
    np.testing.assert_array_equal(whole.occlusion, OCCLUDED & ~HOLE)
    assert scene.occlusion is None


def test_depth_and_pose_of_a_disparity(data):
    make_stereo(data)
    values = np.where(HOLE, np.inf, 3.25).astype(np.float32)
    values[0, :3] = 0, -2, 6.5
    np.savez(data / "scene_disp.npz", values)
    loaded = find_pairs(data)[1].load()
    no_depth = HOLE.copy()
    no_depth[0, :2] = True  # infinitely far, or behind
    np.testing.assert_array_equal(np.isnan(loaded.depth), no_depth)
    assert loaded.depth[0, 2] == np.float32(1 / 6.5)
    assert np.unique(loaded.depth[1:][~HOLE[1:]]).tolist() == [np.float32(1 / 3.25)]
    np.testing.assert_array_equal(loaded.pose, pose_matrix([-1, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize("name", ["disp.npy", "disp.tif", "gt.png"])
def test_disparity_in_other_files(data, name):
    make_stereo(data)
    (data / "scene_disp.npz").unlink()
    values = np.where(HOLE, np.nan, 3.25).astype(np.float32)
    path = data / f"scene_{name}"
    if name == "disp.npy":
        np.save(path, values)
    elif name == "disp.tif":
        write_tiff(path, values)
    else:  # 16 bits: in 1/256 px
        write_png(path, np.where(HOLE, 0, 3.25 * 256).astype(np.uint16))
    flow = find_pairs(data)[1].load().flow
    assert np.unique(flow[~HOLE], axis=0).tolist() == [[-3.25, 0]]
    assert np.isnan(flow[HOLE]).all()


def test_missing_folders_are_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*gone: check the path"):
        find_pairs(tmp_path / "gone")
    (tmp_path / "file").write_text("text")
    with pytest.raises(NotADirectoryError, match="file is a file: give the folder"):
        find_pairs(tmp_path / "file")
    with pytest.raises(FileNotFoundError, match="holds no pair of frames") as caught:
        find_pairs(tmp_path)
    for name, rule in LAYOUTS.items():
        assert f"{name}: {rule.expected_files}" in str(caught.value)
    with pytest.raises(ValueError, match="layout is 'kity': expected one of 'middlebury', 'kitti'"):
        find_pairs(tmp_path, layout="kity")


@pytest.mark.skipif(os.name == "nt", reason="links are another matter on Windows")
def test_links_are_followed_once(data, tmp_path):
    make_middlebury(data)
    (data / "again").symlink_to(data)  # a loop
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / "inside").symlink_to(data)
    pairs = find_pairs(tmp_path / "link")
    assert [label(pair) for pair in pairs] == ["inside/Blocks", "inside/Room"]


def test_hidden_files_and_folders_are_left_out(data):
    make_middlebury(data)
    (data / "Room").rename(data / ".Room")
    make_stereo(data)
    for name in ("scene_left.png", "scene_right.png"):
        (data / name).rename(data / f".{name}")
    assert [pair.name for pair in find_pairs(data)] == ["data", "Blocks"]
