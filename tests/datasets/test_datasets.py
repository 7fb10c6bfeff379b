"""Datasets: every layout is found and read, and what is missing or damaged is named."""

import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

import tisfm
from tisfm.datasets import LAYOUTS, find_pairs
from tisfm.datasets.calibration import COLOUR_OFFSET, DEPTH_CAMERA, STATED, for_width
from tisfm.formats import FormatError, read_image, write_flo, write_kitti_flow, write_png
from tisfm.metrics import pose_errors
from tisfm.rigid import pose_matrix
from tisfm.scenes import Box, Plane, Scene, Texture, static_scene

H, W = 30, 44
SCENE = static_scene("sideways", H, W)
COLOUR = [np.dstack([frame, 255 - frame, frame // 2]) for frame in (SCENE.frame0, SCENE.frame1)]
FLOW = np.round(SCENE.flow * 64) / 64  # as KITTI's PNG stores it
OCCLUDED = ~SCENE.visible
HOLE = np.zeros((H, W), bool)
HOLE[3:6, 4:9] = True


def unknown(flow, mask, value=np.nan):
    """Return the flow with a value where a mask is set."""
    out = flow.copy()
    out[mask] = value
    return out


def put(path, data, *, write=write_png):
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, data)


def put_frames(*paths, frames=COLOUR):
    for path, frame in zip(paths, frames, strict=True):
        put(path, frame)


def mask_picture(mask):
    return np.where(mask, 255, 0).astype(np.uint8)


def make_middlebury(root):
    for name in ("Blocks", "Room"):
        put_frames(root / name / "frame10.png", root / name / "frame11.png")
        put(root / name / "flow10.flo", unknown(FLOW, HOLE, 1.7e9), write=write_flo)
    put_frames(root / "NoTruth" / "frame10.png", root / "NoTruth" / "frame11.png")


def make_middlebury_original(root):
    put_frames(*(root / "other-data" / "Blocks" / f"frame{k}.png" for k in (10, 11)))
    put(
        root / "other-gt-flow" / "Blocks" / "flow10.flo",
        unknown(FLOW, HOLE, 1.7e9),
        write=write_flo,
    )


def make_kitti(root, images="image_2", calibration="calib_cam_to_cam"):
    for k in (0, 12):
        put_frames(*(root / "training" / images / f"{k:06d}_{n}.png" for n in (10, 11)))
        truth = unknown(FLOW, HOLE)
        put(root / "training" / "flow_occ" / f"{k:06d}_10.png", truth, write=write_kitti_flow)
        visible = unknown(truth, OCCLUDED)
        put(root / "training" / "flow_noc" / f"{k:06d}_10.png", visible, write=write_kitti_flow)
        text = root / "training" / calibration / f"{k:06d}.txt"
        text.parent.mkdir(exist_ok=True)
        key = "P_rect_{:02d}" if calibration == "calib_cam_to_cam" else "P{}"
        lines = ["calib_time: 09-Jan-2012 13:57:47"]
        for camera in range(4):
            focal = 700 + camera
            values = [focal, 0, 22, -3, 0, focal, 15, 0.2, 0, 0, 1, 0]
            lines.append(f"{key.format(camera)}: " + " ".join(f"{v:.6e}" for v in values))
        text.write_text("\n".join(lines))


def make_sintel(root, passes=("clean", "final")):
    training = root / "training"
    for name in passes:
        for k in (1, 2, 3):
            put(training / name / "alley_1" / f"frame_{k:04d}.png", COLOUR[min(k, 2) - 1])
    for k in (1, 2):
        stem = f"alley_1/frame_{k:04d}"
        put(training / "flow" / f"{stem}.flo", FLOW, write=write_flo)
        put(training / "occlusions" / f"{stem}.png", mask_picture(OCCLUDED))
        put(training / "invalid" / f"{stem}.png", mask_picture(HOLE))
        cam = training / "camdata_left" / f"{stem}.cam"
        cam.parent.mkdir(parents=True, exist_ok=True)
        intrinsics = [1120.0, 0, 21.5, 0, 1120.0, 14.5, 0, 0, 1]
        cam.write_bytes(struct.pack("<f9d12d", 202021.25, *intrinsics, *range(12)))


def make_sintel_flat(root):
    put_frames(root / "frame_0002.png", root / "frame_0003.png")
    put(root / "gt" / "frame_0002.flo", FLOW, write=write_flo)
    put(root / "gt" / "frame_0002.png", COLOUR[0])
    put(root / "gt" / "occlusions" / "frame_0002.png", mask_picture(OCCLUDED))
    put(root / "gt" / "invalid" / "frame_0002.png", mask_picture(HOLE))


def make_yosemite(root):
    for k in (8, 9, 10):
        put(root / f"yos{k}.tif", COLOUR[k % 2][..., 0], write=write_tiff)
    put(root / "flow09_derived.flo", unknown(FLOW, HOLE, 1e10), write=write_flo)
    put(root / "sky_mask_derived.png", mask_picture(HOLE))


def write_tiff(path, image):
    assert cv2.imwrite(str(path), image)


def make_stereo(root):
    put_frames(root / "scene_left.png", root / "scene_right.png")
    disparity = np.where(HOLE, np.inf, 3.25).astype(np.float32)
    np.savez(root / "scene_disp.npz", disparity)
    put_frames(root / "left.png", root / "right.png")
    put(root / "disparity.png", np.where(HOLE, 0, 7).astype(np.uint8))
    put(root / "mask.png", np.dstack([mask_picture(~OCCLUDED)] * 3))
    put_frames(root / "lonely_left.png", root / "lonely_right.png")  # no truth: no pair


def world_poses(motion, count):
    """Return poses, camera to world, of a camera before which the scene moves each frame."""
    poses = [pose_matrix([0.3, -2, 1, 0.4, -0.2, 0.1])]
    while len(poses) < count:
        poses.append(poses[-1] @ np.linalg.inv(motion))
    return poses


MOTION = pose_matrix(SCENE.motions[0])
POSES = world_poses(MOTION, 5)


def write_rows(path, poses=POSES):
    rows = [" ".join(f"{value:.9g}" for value in pose[:3].ravel()) for pose in poses]
    path.write_text("\n".join(rows) + "\n")


def make_new_tsukuba(root):
    for k in range(4):
        put(root / f"rgb_{k:05d}.png", COLOUR[k % 2])
    write_rows(root / "poses_camera_to_world_3x4_cm.txt")


def make_sevenscenes(root, numbers=range(5), suffix="png"):
    raw = np.full((H, W), 1250, np.uint16)
    raw[HOLE], raw[0] = 65535, 0
    for k in numbers:
        put(root / f"frame-{k:06d}.color.{suffix}", COLOUR[k % 2], write=write_picture)
        put(root / f"frame-{k:06d}.depth.png", raw)
        np.savetxt(root / f"frame-{k:06d}.pose.txt", POSES[k])


def write_picture(path, image):
    assert cv2.imwrite(str(path), image[..., ::-1])


MAKERS = {
    "middlebury": make_middlebury,
    "middlebury original": make_middlebury_original,
    "kitti": make_kitti,
    "sintel": make_sintel,
    "sintel flat": make_sintel_flat,
    "yosemite": make_yosemite,
    "stereo": make_stereo,
    "new_tsukuba": make_new_tsukuba,
    "sevenscenes": make_sevenscenes,
}
NAMES = {
    "middlebury": ["data/Blocks", "data/Room"],
    "middlebury original": ["data/Blocks"],
    "kitti": ["data/000000", "data/000012"],
    "sintel": [f"data {name}/alley_1/frame_{k:04d}" for name in ("clean", "final") for k in (1, 2)],
    "sintel flat": ["data/frame_0002"],
    "yosemite": ["data/yos9"],
    "stereo": ["data/data", "data/scene"],
    "new_tsukuba": [f"data/rgb_{k:05d}" for k in range(3)],
    "sevenscenes": [f"data/frame-{k:06d}" for k in range(2)],
}
WITH_FLOW = set(MAKERS) - {"new_tsukuba", "sevenscenes"}
WITH_DEPTH = {"stereo", "sevenscenes"}
WITH_POSE = {"stereo", "new_tsukuba", "sevenscenes"}


@pytest.fixture(params=MAKERS)
def kind(request):
    return request.param


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    return folder


def label(pair):
    return f"{pair.dataset}/{pair.name}"


# Every layout


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
        assert LAYOUTS[other].expected in str(caught.value)
        assert LAYOUTS[layout].expected not in str(caught.value)


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


# What belongs to one layout


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
    [
        ("image_2", "calib_cam_to_cam", 702),
        ("colored_0", "calib", 702),
        ("image_0", "calib", 700),
    ],
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


# Sequences with poses


@pytest.mark.parametrize("kind", ["new_tsukuba", "sevenscenes"])
@pytest.mark.parametrize("step", [None, 1, 2, 3])
def test_pairs_of_a_sequence(data, kind, step):
    MAKERS[kind](data)
    pairs = find_pairs(data, step=step)
    gap = step or {"new_tsukuba": 1, "sevenscenes": 3}[kind]
    count = {"new_tsukuba": 4, "sevenscenes": 5}[kind] - gap
    assert [pair.name[-5:] for pair in pairs] == [f"{k:05d}" for k in range(count)]
    expected = np.linalg.matrix_power(MOTION, gap)
    for k, pair in enumerate(pairs):
        assert f"{k + gap:05d}" in pair.frame1.name
        loaded = pair.load()
        np.testing.assert_array_equal(loaded.frame0, COLOUR[k % 2])
        np.testing.assert_allclose(loaded.pose, expected, atol=1e-6)
        assert pose_errors(loaded.pose, expected).direction < 1e-3
    with pytest.raises(FileNotFoundError):
        find_pairs(data, step=5)


def test_the_step_is_of_sequences_alone(data):
    make_middlebury(data)
    assert find_pairs(data, step=7) == find_pairs(data)
    for step in (0, -1, 1.0, True):
        with pytest.raises(ValueError, match=f"step is {step}: expected a positive whole number"):
            find_pairs(data, step=step)


def test_frames_that_are_missing_leave_out_their_pairs(data):
    make_new_tsukuba(data)
    (data / "rgb_00001.png").unlink()
    assert [pair.name for pair in find_pairs(data)] == ["rgb_00002"]
    make_sevenscenes(data / "other", numbers=(0, 1, 4))
    assert [pair.name for pair in find_pairs(data / "other")] == ["frame-000001"]


def test_cameras_of_sequences(data):
    make_new_tsukuba(data)
    make_sevenscenes(data)
    scale = W / 640
    for pair in find_pairs(data):
        camera, whole = pair.load().camera, STATED[pair.layout]
        assert camera.focal == pytest.approx(whole.focal * scale)
        assert camera.center == pytest.approx(((320.5) * scale - 0.5, 240.5 * scale - 0.5))
        assert for_width(whole, 640) == whole


def test_sevenscenes_as_they_are_distributed(data):
    make_sevenscenes(data / "chess" / "seq-01")
    make_sevenscenes(data / "chess" / "photos", suffix="jpg")
    pairs = find_pairs(data)
    assert [pair.dataset for pair in pairs] == ["photos"] * 2 + ["chess seq-01"] * 2
    for pair in pairs:
        pair.load()
        pair.frame0.write_bytes(pair.frame0.read_bytes()[:-9])
        with pytest.raises(FormatError, match=pair.frame0.name):
            pair.load()


def test_depth_is_that_of_the_colour_camera(data):
    """Rendered for the depth camera beside it, it is what the colour camera sees."""
    height, width = 120, 160
    views = []
    for camera, shift in ((STATED["sevenscenes"], 0.0), (DEPTH_CAMERA, COLOUR_OFFSET)):
        wall = Plane(texture=Texture(wavelength=0.1), point=(shift, 0, 2.5), normal=(0.3, 0.2, -1))
        box = Box(
            texture=Texture(wavelength=0.1), center=(0.2 + shift, 0, 1.0), size=(0.3, 0.25, 0.2)
        )
        scene = Scene(
            objects=[wall, box], camera=for_width(camera, width), height=height, width=width
        )
        views.append(scene.render(samples=1).depth)
    expected, raw = views
    make_sevenscenes(data, numbers=(0, 3))
    for k in (0, 3):
        put(data / f"frame-{k:06d}.color.png", np.zeros((height, width), np.uint8))
    write_png(data / "frame-000000.depth.png", np.rint(1000 * raw).astype(np.uint16))
    (pair,) = find_pairs(data)
    depth = pair.load().depth
    known = np.isfinite(depth)
    # The colour camera sees more at the edges, and behind the box to its left.
    assert 0.75 < known.mean() < 0.85
    error = np.abs(depth - expected)[known]
    assert np.median(error) < 0.005 and (error < 0.03).mean() > 0.99
    as_it_is = np.abs(raw - expected)
    assert np.median(as_it_is) > 0.015 and (as_it_is < 0.03).mean() < 0.7


def test_depth_that_is_missing(data):
    make_sevenscenes(data)
    loaded = find_pairs(data)[0].load()
    assert np.unique(loaded.depth[np.isfinite(loaded.depth)]).tolist() == [1.25]
    for value in (0, 65535):
        write_png(data / "frame-000000.depth.png", np.full((H, W), value, np.uint16))
        with pytest.raises(FormatError, match=rf"000000\.depth\.png has no known depth .* {H * W}"):
            find_pairs(data)[0].load()
    write_png(data / "frame-000000.depth.png", np.zeros((H, W), np.uint8))
    with pytest.raises(FormatError, match=r"depth\.png holds .* uint8, expected a depth map"):
        find_pairs(data)[0].load()


POSE_ROW = "1 0 0 5 0 1 0 6 0 0 1 7"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{POSE_ROW}\n1 2 3\n", "line 2 has 3 numbers, expected 12"),
        (f"{POSE_ROW}\n\n{POSE_ROW} 0\n", "line 3 has 13 numbers, expected 12"),
        (POSE_ROW.replace("5", "five"), "line 1: .*five.*, expected numbers"),
        (POSE_ROW, "has 1 rows, so there is no pose of frame 1"),
        (f"{POSE_ROW}\n{POSE_ROW.replace('6', 'nan')}", "row 1 is not finite"),
        (f"{POSE_ROW}\n{POSE_ROW.replace('7', '-inf')}", "row 1 is not finite"),
        (f"{POSE_ROW}\n{POSE_ROW.replace('1', '2')}", "row 1 holds no rotation"),
        (f"{POSE_ROW}\n0 1 0 5 1 0 0 6 0 0 1 7", "row 1 holds no rotation"),
    ],
)
def test_rows_that_are_no_poses(data, text, message):
    make_new_tsukuba(data)
    (data / "poses_camera_to_world_3x4_cm.txt").write_text(text)
    with pytest.raises(FormatError, match=f"poses_camera_to_world_3x4_cm.txt.* {message}"):
        find_pairs(data)[0].load()


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["1 0 0 5", "0 1 0 6", "0 0 1 7"], "has 3 rows of numbers, expected a 4 × 4 matrix"),
        (["1 0 0", "0 1 0", "0 0 1"], "line 1 has 3 numbers, expected 4"),
        (["1 0 0 5", "0 1 0 6", "0 0 1 7", "0 0 1 1"], r"has the last row .*, expected 0 0 0 1"),
        (["nan nan nan nan"] * 4, "is not finite: there is no pose of this frame"),
        (["1 0 0 5", "0 1 0 6", "0 0 2 7", "0 0 0 1"], "holds no rotation"),
        (["-1.#IND 0 0 5", "0 1 0 6", "0 0 1 7", "0 0 0 1"], "line 1: .*expected numbers"),
    ],
)
def test_matrices_that_are_no_poses(data, rows, message):
    make_sevenscenes(data)
    (data / "frame-000003.pose.txt").write_text("\n".join(rows))
    first, second = find_pairs(data)
    with pytest.raises(FormatError, match=rf"frame-000003\.pose\.txt.* {message}"):
        first.load()
    second.load()


# What is missing or damaged


def files_of(pair):
    paths = (pair.frame0, pair.frame1, pair.truth, pair.occluded, pair.visible, pair.invalid)
    paths = (*paths, pair.sky, pair.calibration, pair.depth, pair.pose0, pair.pose1)
    return [path for path in paths if path is not None]


def test_every_missing_file_is_named(data, kind):
    """Masks of a dataset that has such masks included; only a pair without truth is no pair."""
    MAKERS[kind](data)
    pair = find_pairs(data)[-1]
    for path in files_of(pair):
        kept = path.read_bytes()
        path.unlink()
        with pytest.raises(FileNotFoundError) as caught:
            pair.load()
        assert str(path) in str(caught.value)
        if (
            path in (pair.frame0, pair.frame1) and kind != "new_tsukuba"
        ):  # still found, so that the fault is told
            assert pair.name in [found.name for found in find_pairs(data)]
        path.write_bytes(kept)
    pair.load()


def test_every_damaged_file_is_named(data, kind):
    MAKERS[kind](data)
    pair = find_pairs(data)[-1]
    for path in files_of(pair):
        kept = path.read_bytes()
        for damage in (b"", kept[: len(kept) // 2], b"no such thing" * 30):
            path.write_bytes(damage)
            with pytest.raises(FormatError) as caught:
                pair.load()
            assert path.name in str(caught.value) and "\n" not in str(caught.value)
        path.write_bytes(kept)
    pair.load()


def test_every_other_size_is_named(data, kind):
    MAKERS[kind](data)
    pair = find_pairs(data)[-1]
    smaller = np.zeros((H, W - 1), np.uint8)
    for path in files_of(pair)[1:]:
        if path in (pair.calibration, pair.pose0, pair.pose1):
            continue
        kept = path.read_bytes()
        if path == pair.truth and pair.truth_format == "flo":
            write_flo(path, np.zeros((H, W - 1, 2)))
        elif path.suffix == ".npz":
            np.savez(path, smaller)
        elif pair.truth_format == "kitti" and path in (pair.truth, pair.visible):
            write_kitti_flow(path, np.zeros((H, W - 1, 2)))
        elif path.suffix == ".tif":
            write_tiff(path, smaller)
        elif path == pair.depth:
            write_png(path, smaller.astype(np.uint16))
        else:
            write_png(path, smaller)
        with pytest.raises(
            ValueError, match=f"{W - 1} px but .* {W} px: .*the same size"
        ) as caught:
            pair.load()
        assert str(path) in str(caught.value)
        path.write_bytes(kept)


def test_truth_that_knows_nothing(data):
    make_middlebury(data)
    write_flo(data / "Room" / "flow10.flo", np.full((H, W, 2), 1e10))
    with pytest.raises(ValueError, match=rf"flow10\.flo has no known motion at any of its {H * W}"):
        find_pairs(data)[1].load()


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"a": np.ones((H, W)), "b": np.ones((H, W))}, "holds 2 arrays, expected one"),
        ({"a": np.ones((H, W, 2))}, r"holds \(30, 44, 2\), expected a disparity map"),
        ({"a": np.ones((H, W), np.int64)}, "holds int64, expected uint8, uint16 or float"),
        ({"a": np.array([{}])}, "cannot be read as NumPy arrays"),
    ],
)
def test_arrays_that_are_no_disparity(data, arrays, message):
    make_stereo(data)
    np.savez(data / "scene_disp.npz", **arrays)
    with pytest.raises(FormatError, match=rf"scene_disp\.npz {message}"):
        find_pairs(data)[1].load()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("P2: 1 2 3", "damaged line P2: expected 12 numbers"),
        ("P2: " + "x " * 12, "damaged line P2"),
        ("P3: " + "1 " * 12, "no line P_rect_02 or P2"),
        ("P2: 0 0 1 0 0 0 1 0 0 0 1 0", "no usable camera: focal is 0"),
        ("P2: nan 0 1 0 0 0 1 0 0 0 1 0", "no usable camera: focal is nan"),
    ],
)
def test_calibration_that_is_none(data, text, message):
    make_kitti(data)
    (data / "training" / "calib_cam_to_cam" / "000000.txt").write_text(text)
    with pytest.raises(FormatError, match=f"000000.txt .*{message}"):
        find_pairs(data)[0].load()


def test_a_cam_of_another_tag(data):
    make_sintel(data)
    path = find_pairs(data)[0].calibration
    path.write_bytes(b"\0" * 4 + path.read_bytes()[4:])
    with pytest.raises(FormatError, match=r"its tag is 0\.0, expected 202021\.25"):
        find_pairs(data)[0].load()


def test_folders_that_are_none(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*gone: check the path"):
        find_pairs(tmp_path / "gone")
    (tmp_path / "file").write_text("text")
    with pytest.raises(NotADirectoryError, match="file is a file: give the folder"):
        find_pairs(tmp_path / "file")
    with pytest.raises(FileNotFoundError, match="holds no pair of frames") as caught:
        find_pairs(tmp_path)
    for name, rule in LAYOUTS.items():
        assert f"{name}: {rule.expected}" in str(caught.value)
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


# Real datasets


def test_real_datasets(shared_data):
    pairs = {label(pair): pair for pair in find_pairs(shared_data)}
    sizes = {
        "middlebury/RubberWhale": (388, 584),
        "sintel_alley/frame_0002": (436, 1024),
        "yosemite_clouds/yos9": (252, 316),
        "yosemite_cloudless/yoscloudless_009": (252, 316),
        "stereo/cones": (375, 450),
        "stereo/motorcycle": (500, 741),
        "kitti/kitti": (376, 1241),
        "new_tsukuba/rgb_00073": (480, 640),
        "sevenscenes/frame-000056": (480, 640),
    }
    for name, size in sizes.items():
        assert pairs[name].load().frame0.shape[:2] == size
    cloudless = pairs["yosemite_cloudless/yoscloudless_009"].load()
    np.testing.assert_array_equal(np.isnan(cloudless.flow[..., 0]), cloudless.sky)


def test_real_motion_takes_one_frame_to_the_other(shared_data):
    """Warped by the truth, frame 1 resembles frame 0: no sign or order is mistaken anywhere."""
    for pair in find_pairs(shared_data):
        if pair.dataset not in ("middlebury", "sintel_alley", "stereo", "yosemite_cloudless"):
            continue
        loaded = pair.load()
        y, x = np.mgrid[: loaded.flow.shape[0], : loaded.flow.shape[1]].astype(np.float32)
        flow = np.nan_to_num(loaded.flow)
        frame0, frame1 = (f.astype(np.float32) for f in (loaded.frame0, loaded.frame1))
        warped = cv2.remap(frame1, x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR)
        known = ~np.isnan(loaded.flow).any(axis=2)
        after = np.median(np.abs(warped - frame0)[known])
        assert after < 0.6 * np.median(np.abs(frame1 - frame0)[known]), label(pair)


def test_real_frames_are_as_they_are_read(shared_data):
    folder = Path(shared_data) / "middlebury" / "Venus"
    (pair,) = find_pairs(folder)
    np.testing.assert_array_equal(pair.load().frame1, read_image(folder / "frame11.png"))
