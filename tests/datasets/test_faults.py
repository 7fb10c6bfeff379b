"""What is missing, damaged or of another size is named."""

import contextlib
import tracemalloc

import numpy as np
import pytest

from tests.datasets.made import (
    MAKERS,
    H,
    W,
    make_kitti,
    make_middlebury,
    make_new_tsukuba,
    make_sevenscenes,
    make_sintel,
    make_stereo,
    write_tiff,
)
from tests.draws import examples, long_draw_too, nightly_except
from tisfm.datasets import find_pairs
from tisfm.datasets.depth_files import read_disparity
from tisfm.formats import FormatError, write_flo, write_kitti_flow, write_png

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
        (f"{POSE_ROW}\n{POSE_ROW.replace('1', '2')}", "row 1 is not a rotation"),
        (f"{POSE_ROW}\n0 1 0 5 1 0 0 6 0 0 1 7", "row 1 is not a rotation"),
    ],
)
def test_wrong_pose_rows_are_named(data, text, message):
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
        (["1 0 0 5", "0 1 0 6", "0 0 2 7", "0 0 0 1"], "is not a rotation"),
        (["-1.#IND 0 0 5", "0 1 0 6", "0 0 1 7", "0 0 0 1"], "line 1: .*expected numbers"),
    ],
)
def test_wrong_pose_matrices_are_named(data, rows, message):
    make_sevenscenes(data)
    (data / "frame-000003.pose.txt").write_text("\n".join(rows))
    first, second = find_pairs(data)
    with pytest.raises(FormatError, match=rf"frame-000003\.pose\.txt.* {message}"):
        first.load()
    second.load()


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
        if path in (pair.frame0, pair.frame1) and kind not in (
            "new_tsukuba",
            "calibrated",
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


def test_truth_without_known_motion_is_refused(data):
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
        ({"a": np.full((H, W), None)}, "holds object, expected uint8, uint16 or float"),
        ({}, "holds 0 arrays, expected one"),
    ],
)
def test_wrong_disparity_arrays_are_named(data, arrays, message):
    make_stereo(data)
    np.savez(data / "scene_disp.npz", **arrays)
    with pytest.raises(FormatError, match=rf"scene_disp\.npz {message}"):
        find_pairs(data)[1].load()


@pytest.mark.parametrize("count", nightly_except(1, of=[1, 3]))
def test_only_disparity_maps_are_unpacked(tmp_path, count):
    path = tmp_path / "disp.npz"
    arrays = {f"part{k}": np.zeros((1000, 1000, 20)) for k in range(count)}
    np.savez_compressed(path, **arrays)
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match=r"holds (3 arrays|\(1000, 1000, 20\))"):
            read_disparity(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6  # an eighth of one of them
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed, np.save])
def test_too_little_memory_is_a_memory_error(tmp_path, monkeypatch, save):
    path = tmp_path / ("disp.npy" if save is np.save else "disp.npz")
    save(path, np.ones((H, W)))

    def no_memory(*arguments, **options):
        raise MemoryError

    monkeypatch.setattr(np.lib.format, "read_magic", no_memory)
    with pytest.raises(MemoryError):
        read_disparity(path)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed, np.save])
@long_draw_too
def test_damaged_arrays_are_named(tmp_path, save):
    path = tmp_path / ("disp.npy" if save is np.save else "disp.npz")
    save(path, np.arange(20, dtype=np.uint8).reshape(4, 5) + 1)
    whole = path.read_bytes()
    np.testing.assert_array_equal(read_disparity(path).ravel(), np.arange(20) + 1)
    for end in range(0, len(whole), examples(5, 1)):
        path.write_bytes(whole[:end])
        with pytest.raises(FormatError, match=path.name):
            read_disparity(path)
    for place in range(0, len(whole), examples(5, 1)):
        for flip in (1, 0x80, 0xFF):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :])
            with contextlib.suppress(FormatError):
                read_disparity(path)


@pytest.mark.parametrize("shape", ["(10000000, 100000000)", "(3, 4", "(-3, 4)", "(3, 5)"])
def test_headers_of_arrays_are_not_believed(tmp_path, shape):
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}}}".encode()
    path = tmp_path / "disp.npy"
    start = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    path.write_bytes(start + bytes(12))
    with pytest.raises(FormatError, match=r"disp\.npy"):
        read_disparity(path)


def test_arrays_may_be_stored_by_columns(tmp_path):
    disparity = np.asfortranarray(np.arange(12, dtype=np.float32).reshape(3, 4))
    for save, name in ((np.save, "a.npy"), (np.savez, "a.npz"), (np.savez_compressed, "b.npz")):
        save(tmp_path / name, disparity)
        np.testing.assert_array_equal(read_disparity(tmp_path / name), disparity)


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
def test_wrong_calibration_is_named(data, text, message):
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
