"""Compact files of a result: what is rounded, how small they are, and what is refused."""

import dataclasses
import io
import json
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

import tisfm
from tests.interpretation_file.stored import about, about_of, entries_of, rewritten
from tests.interpretation_file.test_refused import refused
from tests.test_interpretation import H, W
from tisfm.formats.npz import write_npz
from tisfm.interpretation import Interpretation
from tisfm.scenes import static_scene
from tisfm.status import Status

STEP = 2.0**-10
FLOATS = ("rho", "flow", "inverse_depth", "inverse_depth_std", "confidence")
EXACT = ("occlusion", "labels", "frame", "motions")


@pytest.fixture
def compact(result, tmp_path):
    path = tmp_path / "compact.npz"
    result.save(path, compact=True)
    return path


@pytest.fixture
def compact_rigid(rigid, tmp_path):
    path = tmp_path / "compact.npz"
    rigid.save(path, compact=True)
    return path


def assert_close(found, result):
    for name in ("rho", "flow"):
        exact = getattr(result, name)
        most = min(STEP, 2.0**-12 * np.abs(exact).max()) / 2
        assert np.abs(getattr(found, name) - exact).max() <= most
    assert np.abs(found.confidence - result.confidence).max() <= STEP
    np.testing.assert_array_equal(found.confidence > 0, result.confidence > 0)
    for name in ("inverse_depth", "inverse_depth_std"):
        if getattr(result, name) is not None:
            np.testing.assert_allclose(
                getattr(found, name), getattr(result, name), rtol=2.0**-12, atol=0
            )
    for name in EXACT:
        np.testing.assert_array_equal(getattr(found, name), getattr(result, name))
    for name in (*FLOATS, *EXACT):
        if getattr(result, name) is not None:
            array = getattr(found, name)
            assert array.dtype == getattr(result, name).dtype and array.flags.writeable
    assert found.settings == result.settings and found.camera == result.camera
    assert found.status == result.status and found.version == result.version
    for name, expected in vars(result.history).items():
        np.testing.assert_array_equal(getattr(found.history, name), expected)


def test_a_field_comes_back_rounded(result, compact):
    assert_close(Interpretation.load(compact), result)


def test_rigid_motions_come_back_rounded(rigid, compact_rigid):
    assert_close(Interpretation.load(compact_rigid), rigid)


def test_a_colour_frame_comes_back(result, tmp_path):
    frame = np.random.default_rng(2).integers(0, 256, (H, W, 3), np.uint8)
    dataclasses.replace(result, frame=frame).save(tmp_path / "x.npz", compact=True)
    np.testing.assert_array_equal(Interpretation.load(tmp_path / "x.npz").frame, frame)


@pytest.mark.parametrize("largest", [0.0, 1e-30, 1e-3, 40.0, 5e4])
def test_motions_of_all_sizes(result, tmp_path, largest):
    flow = result.flow / np.abs(result.flow).max() * np.float32(largest)
    changed = dataclasses.replace(result, flow=flow)
    changed.save(tmp_path / "x.npz", compact=True)
    assert_close(Interpretation.load(tmp_path / "x.npz"), changed)


def test_the_file_is_a_quarter(tmp_path):
    """A rendered scene of 240 × 320 px: noise of the last bits is left out."""
    scene = static_scene("sideways", 240, 320)
    result = tisfm.interpret(scene.frame0, scene.frame1, settings=tisfm.Settings.preset("fast"))
    result.save(tmp_path / "whole.npz")
    result.save(tmp_path / "compact.npz", compact=True)
    sizes = [(tmp_path / f"{name}.npz").stat().st_size for name in ("whole", "compact")]
    assert sizes[1] < 0.3 * sizes[0]


def test_saving_twice_gives_the_same_bytes(result, compact, tmp_path):
    result.save(tmp_path / "again.npz", compact=True)
    assert (tmp_path / "again.npz").read_bytes() == compact.read_bytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_a_diverged_result_is_unchanged(result, tmp_path, value):
    flow = result.flow.copy()
    flow[3, 4] = value
    wild = dataclasses.replace(result, flow=flow, status=Status("diverged", "wild"))
    wild.save(tmp_path / "x.npz", compact=True)
    np.testing.assert_array_equal(Interpretation.load(tmp_path / "x.npz").flow, flow)
    assert about_of(tmp_path / "x.npz")["packed"] == {}


# What is refused


def packed_about(path, name, **changes):
    """Change what a file says of how an array is packed."""
    known = about_of(path)["packed"]
    about(path, packed=known | {name: known[name] | changes})


@pytest.mark.parametrize("name", ["rho", "flow", "inverse_depth", "occlusion", "frame"])
@pytest.mark.parametrize(
    "changes",
    [{"shape": [H + 1, W]}, {"shape": []}, {"shape": [10**9, 10**9]}, {"of": "float32"},
     {"of": "int64"}, {"step": -1.0}, {"step": "a"}, {"more": 1}],
    ids=str,
)  # fmt: skip
def test_packings_that_do_not_fit(compact, name, changes):
    packed_about(compact, name, **changes)
    of_frame = name == "frame" and "shape" in changes  # by which the others are then wrong
    refused(compact, "" if of_frame else name)


@pytest.mark.parametrize("packed", [None, [], {"motions": {}}, {"rho": None}, 3], ids=str)
def test_other_packings(compact, packed):
    about(compact, packed=packed)
    refused(compact)


@pytest.mark.parametrize(
    "array",
    [np.zeros(0, np.uint8), np.zeros(9, np.uint8), np.zeros((6, H, W), np.uint8),
     np.zeros(3, np.float32), np.frombuffer(zlib.compress(bytes(7)), np.uint8)],
    ids=lambda array: f"{array.shape}{array.dtype}",
)  # fmt: skip
def test_streams_that_do_not_fit(compact, array):
    rewritten(compact, rho=array)
    refused(compact, "rho")


def test_a_packed_array_that_is_not_there(compact):
    rewritten(compact, rho=None)
    refused(compact)


def test_labels_of_motions_that_are_not_there(rigid, compact_rigid):
    other = dataclasses.replace(rigid, labels=np.full((H, W), 1, np.int32))
    other.save(compact_rigid, compact=True)
    rewritten(compact_rigid, motions=rigid.motions[:1])
    refused(compact_rigid, "labels")


def test_every_byte_may_be_wrong(compact):
    """Each flipped byte of the streams is found by a check sum."""
    data, before, found = bytearray(compact.read_bytes()), Interpretation.load(compact), 0
    for position in range(0, len(data), max(1, len(data) // 200)):
        data[position] ^= 0x5A
        compact.write_bytes(data)
        try:
            loaded = Interpretation.load(compact)
        except ValueError as error:
            assert "\n" not in str(error)
            found += 1
        else:  # of times and permissions, which nobody reads
            for name in (*FLOATS, *EXACT):
                np.testing.assert_array_equal(getattr(loaded, name), getattr(before, name))
        data[position] ^= 0x5A
    assert found > 150


def test_a_small_file_of_a_huge_frame_is_not_unpacked(compact, tmp_path):
    """All that it says agrees, and a zlib stream of zeros is a thousandth of what it holds."""
    height, width = 2**14, 2**12
    zeros = {1: height * width, 2: height * width * 2, 6: height * width * 6}
    entries, known = entries_of(compact), about_of(compact)
    streams = {
        count: np.frombuffer(zlib.compress(bytes(n), 1), np.uint8) for count, n in zeros.items()
    }
    channels = {"rho": (6, height, width), "flow": (height, width, 2)}
    for name, packing in known["packed"].items():
        shape = channels.get(name, (height, width))
        packing["shape"] = list(shape)
        entries[name] = streams[int(np.prod(shape)) // (height * width)]
    entries["about"] = np.array(json.dumps(known))
    write_npz(tmp_path / "bomb.npz", entries)
    assert (tmp_path / "bomb.npz").stat().st_size < 2**22
    tracemalloc.start()
    try:
        refused(tmp_path / "bomb.npz", "pixels packed in")
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()


def test_a_stream_longer_than_its_array_is_not_unpacked(compact):
    rewritten(compact, rho=np.frombuffer(zlib.compress(bytes(2**28), 1), np.uint8))
    tracemalloc.start()
    try:
        refused(compact, "rho is not a zlib stream")
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()


def test_numpy_alone_unpacks_it(result, compact):
    """As the documentation says."""
    with zipfile.ZipFile(compact) as file:
        parts = {name: np.load(io.BytesIO(file.read(name))) for name in file.namelist()}
    packing = json.loads(str(parts["about.npy"]))["packed"]["flow"]
    kind = np.dtype(packing["of"])
    planes = np.frombuffer(zlib.decompress(parts["flow.npy"].tobytes()), np.uint8)
    planes = planes.reshape(-1, *packing["shape"]).astype(np.int64)
    codes = sum(plane << 8 * k for k, plane in enumerate(planes))
    steps = (codes >> 1) ^ -(codes & 1)
    flow = np.cumsum(steps, axis=0).astype(kind) * np.float32(packing["step"])
    np.testing.assert_array_equal(flow, Interpretation.load(compact).flow)
    assert np.abs(flow - result.flow).max() <= STEP / 2
