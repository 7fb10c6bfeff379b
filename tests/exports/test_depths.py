"""Depth in the files of others, as others read them."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.exports.made import SHAPE, made, ramp
from tests.trajectory.paths import PATIENT
from tisfm.exports import SequenceFrames, write_depths
from tisfm.exports.float_images import write_exr, write_pfm, write_tiff
from tisfm.exports.frame_maps import SUFFIXES, depth_from_inverse
from tisfm.formats import read_depth_png, read_dpt

KINDS = sorted(SUFFIXES)
SIZES = st.tuples(st.integers(1, 12), st.integers(1, 12))
FLOATS = arrays(
    np.float32, SIZES, elements=st.floats(width=32, allow_nan=True, allow_infinity=True)
)


def exr_channels(path):
    """Return the channels of an EXR file by their names."""
    OpenEXR = pytest.importorskip("OpenEXR")
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def pfm_of(path):
    """Read a grey PFM by its specification."""
    kind, size, scale, rest = path.read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    assert kind == b"Pf" and float(scale) < 0
    return np.frombuffer(rest, "<f4").reshape(height, width)[::-1]


@PATIENT
@given(values=FLOATS)
def test_floats_keep_every_bit(tmp_path_factory, values):
    place = tmp_path_factory.mktemp("floats")
    write_tiff(place / "a.tiff", values)
    write_pfm(place / "a.pfm", values)
    for name in ("a.tiff", "a.pfm"):
        found = cv2.imread(str(place / name), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(found, values)
    np.testing.assert_array_equal(pfm_of(place / "a.pfm"), values)


@PATIENT
@given(values=FLOATS)
def test_exr_keeps_every_bit(tmp_path_factory, values):
    pytest.importorskip("OpenEXR")
    file = tmp_path_factory.mktemp("floats") / "a.exr"
    write_exr(file, {"Z": values, "R": values[::-1]})
    found = exr_channels(file)
    assert sorted(found) == ["R", "Z"] and found["Z"].dtype == np.float32
    np.testing.assert_array_equal(found["Z"], values)
    np.testing.assert_array_equal(found["R"], values[::-1])


def test_colours_of_a_tiff_are_in_their_order(tmp_path):
    values = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    write_tiff(tmp_path / "a.tiff", values)
    found = cv2.imread(str(tmp_path / "a.tiff"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found[..., ::-1], values)


def read(path, kind):
    """Return depth as others read it, NaN for none, and what stands for none."""
    if kind == "exr":
        found = exr_channels(path)["Z"]
    elif kind == "dpt":
        found = read_dpt(path)
    else:
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if kind in ("tum", "kitti"):
        assert found.dtype == np.uint16
        scale = {"tum": 5000, "kitti": 256}[kind]
        stated = read_depth_png(path)
        found = np.where(found == 0, np.nan, found / scale)
        np.testing.assert_array_equal(stated, found.astype(np.float32))
        return found, 0.5 / scale
    none = {"exr": 0, "tiff": np.nan, "pfm": np.inf, "dpt": np.nan}[kind]
    assert found.dtype == np.float32
    missing = np.isnan(found) if np.isnan(none) else found == none
    return np.where(missing, np.nan, found), 0.0


class Drawn:
    """A result of one frame, of some inverse depth."""

    folder, names, advice, unit_advice = "drawn", ("f0",), "none", "none"

    def __init__(self, inverse_depth):
        self._inverse_depth = inverse_depth

    def __len__(self):
        return 1

    def has_depth(self, frame):
        return True

    def inverse_depth(self, frame):
        return self._inverse_depth


@pytest.mark.parametrize("kind", KINDS)
@PATIENT
@given(
    inverse_depth=arrays(
        np.float32,
        SIZES,
        elements=st.one_of(
            st.floats(0.125, 16, width=32), st.sampled_from([np.nan, 0, -1, np.inf])
        ),
    )
)
def test_depth_survives_its_files(tmp_path_factory, kind, inverse_depth):
    if kind == "exr":
        pytest.importorskip("OpenEXR")
    (file,) = write_depths(Drawn(inverse_depth), tmp_path_factory.mktemp("depth"), kind)
    found, rounding = read(file, kind)
    known = (inverse_depth > 0) & np.isfinite(inverse_depth)
    np.testing.assert_array_equal(np.isnan(found), ~known)
    expected = 1 / inverse_depth[known].astype(float)
    np.testing.assert_allclose(found[known], expected, rtol=2e-7, atol=1.0001 * rounding)


@pytest.mark.parametrize("kind", KINDS)
def test_exported_depth_is_unchanged(tmp_path, kind):
    if kind == "exr":
        pytest.importorskip("OpenEXR")
    result = made(tmp_path / "walk")
    (tmp_path / "out").mkdir()
    told = []
    files = write_depths(
        SequenceFrames(result), tmp_path / "out", kind, chosen=range(0, 6, 2),
        progress=lambda done, total: told.append((done, total)),
    )  # fmt: skip
    assert [file.name for file in files] == [f"f{k}{SUFFIXES[kind]}" for k in (0, 2, 4)]
    assert told == [(1, 3), (2, 3), (3, 3)]
    for file, frame in zip(files, (0, 2, 4), strict=True):
        found, rounding = read(file, kind)
        true = result.depth(frame)
        assert found.shape == SHAPE and np.isnan(true).any()
        np.testing.assert_array_equal(np.isnan(found), np.isnan(true))
        np.testing.assert_allclose(found, true, rtol=1e-6, atol=rounding)


def test_the_unit_is_that_of_the_poses(tmp_path):
    result = made(tmp_path / "walk")
    file = write_depths(SequenceFrames(result.rescaled(0, 1, 7.0)), tmp_path, "pfm")[0]
    length = np.linalg.norm(result.poses[1, :3, 3] - result.poses[0, :3, 3])
    found = read(file, "pfm")[0]
    np.testing.assert_allclose(found, result.depth(0) * 7 / length, rtol=1e-5)


def test_values_out_of_range_are_unknown_or_refused(tmp_path):
    result = made(tmp_path / "walk")
    length = np.linalg.norm(result.poses[1, :3, 3] - result.poses[0, :3, 3])
    frames = SequenceFrames(result.rescaled(0, 1, 5 * length))  # 5 to 25
    files = write_depths(frames, tmp_path, "tum")
    found, true = read(files[0], "tum")[0], 5 * result.depth(0)
    beyond = np.nan_to_num(true) > 65535 / 5000
    assert 0.1 < beyond.mean() < 0.5
    np.testing.assert_array_equal(np.isnan(found), beyond | np.isnan(true))
    frames = SequenceFrames(result.rescaled(0, 1, 50 * length))
    with pytest.raises(ValueError, match=r"is beyond 13\.11, the largest.*--scale.*depth-exr"):
        write_depths(frames, tmp_path, "tum")
    frames = SequenceFrames(result.rescaled(0, 1, 0.005 * length))
    with pytest.raises(ValueError, match=r"too small for this 16-bit format"):
        write_depths(frames, tmp_path, "kitti")


def test_frames_without_depth_have_no_file(tmp_path):
    result = made(tmp_path / "walk", with_depth=(1, 4, 5), piece=[0, 0, 0, 0, 0, -1])
    files = write_depths(SequenceFrames(result), tmp_path, "dpt")
    assert [file.name for file in files] == ["f1.dpt", "f4.dpt"]
    none = made(tmp_path / "none", with_depth=())
    with pytest.raises(ValueError, match=r"no frame of .* has depth: reconstruct with --depth-of"):
        write_depths(SequenceFrames(none), tmp_path, "dpt")


def test_frames_of_one_name_have_numbers(tmp_path):
    result = made(tmp_path / "walk", names=("a", "b", "A", "d", "e", "f"))
    names = [file.name for file in write_depths(SequenceFrames(result), tmp_path, "pfm")]
    assert names == [f"{k:06d}.pfm" for k in range(6)]


def test_depth_is_there_where_inverse_depth_is_above_zero():
    values = np.float32([[0, -1, np.nan, np.inf, 1e-45, 2]])
    np.testing.assert_array_equal(depth_from_inverse(values), [[np.nan] * 5 + [0.5]])
    assert np.isnan(depth_from_inverse(ramp(0))).sum() == 12


def test_exr_needs_its_package(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(ImportError, match=r"pip install 'tisfm\[export\]'"):
        write_depths(SequenceFrames(made(tmp_path / "walk")), tmp_path, "exr")
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]
