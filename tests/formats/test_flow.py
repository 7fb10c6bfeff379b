"""Files of optical flow: what is written is read back, and what is not whole is refused."""

import struct

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.formats.written import COLOUR8, FINITE_OR_NOT, GREY8, GREY16, PROPERTY, SHAPES, contents
from tisfm.formats import (
    FormatError,
    read_flo,
    read_kitti_flow,
    write_flo,
    write_kitti_flow,
    write_png,
)

FLO_BYTES = b"PIEH" + struct.pack("<ii4f", 2, 1, 1.0, -2.0, 0.5, 1e10)


def test_flo_bytes(tmp_path):
    path = tmp_path / "a.flo"
    flow = np.array([[[1.0, -2.0], [0.5, 1e10]]], np.float32)
    write_flo(path, flow)
    assert path.read_bytes() == FLO_BYTES
    assert np.array_equal(read_flo(path), flow)


@PROPERTY
@given(
    flow=SHAPES.flatmap(lambda shape: hnp.arrays(np.float32, (*shape, 2), elements=FINITE_OR_NOT))
)
def test_flo_round_trip(tmp_path, flow):
    write_flo(tmp_path / "a.flo", flow)
    back = read_flo(tmp_path / "a.flo")
    assert back.dtype == np.float32
    assert back.flags.writeable
    assert np.array_equal(back, flow, equal_nan=True)


@pytest.mark.parametrize("dtype", [">f4", "<f8", "int16"])
def test_flo_converts_other_numbers(tmp_path, dtype):
    flow = np.arange(24).reshape(3, 4, 2).astype(dtype)
    write_flo(tmp_path / "a.flo", flow[:, ::-1])
    assert np.array_equal(read_flo(tmp_path / "a.flo"), flow[:, ::-1])


@pytest.mark.parametrize("length", range(1, len(FLO_BYTES)))
def test_flo_refuses_every_truncation(tmp_path, length):
    (tmp_path / "a.flo").write_bytes(FLO_BYTES[:length])
    with pytest.raises(FormatError, match=r"a\.flo is cut off"):
        read_flo(tmp_path / "a.flo")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (FLO_BYTES + b"\0", r"too long: 29 bytes, expected 28 for 2 x 1 px"),
        (b"P" + FLO_BYTES[::-1], r"not a \.flo file"),
        (b"HEIP" + FLO_BYTES[4:], "big-endian"),
        (b"PIEH" + struct.pack("<ii", -1, 5), "impossible size.*width -1, height 5"),
        (b"PIEH" + struct.pack("<ii", 5, 0), "impossible size"),
        (b"PIEH" + struct.pack("<ii", 2**31 - 1, 2**31 - 1), "impossible size"),
    ],
)
def test_flo_names_the_fault(tmp_path, data, message):
    (tmp_path / "a.flo").write_bytes(data)
    with pytest.raises(FormatError, match=message) as caught:
        read_flo(tmp_path / "a.flo")
    assert "a.flo" in str(caught.value)


def test_flo_refuses_other_arrays(tmp_path):
    for shape in [(4, 5), (4, 5, 3), (0, 5, 2), (4, 5, 2, 1)]:
        with pytest.raises(ValueError, match=r"expected \(H, W, 2\)"):
            write_flo(tmp_path / "a.flo", np.zeros(shape))
    with pytest.raises(TypeError, match="complex128"):
        write_flo(tmp_path / "a.flo", np.zeros((4, 5, 2), complex))
    assert contents(tmp_path) == set()


# Optical flow in KITTI's PNG

KITTI_STEPS = st.integers(0, 2**16 - 1)  # file values: a motion is (value - 2¹⁵) / 64


@PROPERTY
@given(stored=SHAPES.flatmap(lambda s: hnp.arrays(np.uint16, (*s, 3), elements=KITTI_STEPS)))
def test_kitti_flow_round_trip(tmp_path, stored):
    """Whatever the file can hold comes back as it was, NaN included."""
    flow = (stored[..., :2].astype(np.float32) - 2**15) / 64
    flow[stored[..., 2] % 2 == 0] = np.nan
    write_kitti_flow(tmp_path / "a.png", flow)
    back = read_kitti_flow(tmp_path / "a.png")
    assert back.dtype == np.float32
    assert np.array_equal(back, flow, equal_nan=True)


@PROPERTY
@given(
    flow=SHAPES.flatmap(
        lambda shape: hnp.arrays(np.float64, (*shape, 2), elements=st.floats(-512, 511.98))
    )
)
def test_kitti_flow_rounds_to_the_nearest_step(tmp_path, flow):
    write_kitti_flow(tmp_path / "a.png", flow)
    assert np.abs(read_kitti_flow(tmp_path / "a.png") - flow).max() <= 1 / 128


def test_kitti_flow_values_of_the_file(tmp_path):
    """The order of the channels, and NaN in either component, as KITTI's own reader has it."""
    flow = np.array([[[0, 0], [1, -2], [-512, 511.984375], [np.nan, 3], [4, np.nan]]])
    write_kitti_flow(tmp_path / "a.png", flow)
    raw = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert raw.dtype == np.uint16
    half = 2**15
    assert raw.tolist() == [
        [[half, half, 1], [half + 64, half - 128, 1], [0, 65535, 1], [0, 0, 0], [0, 0, 0]]
    ]
    # Valid is whatever is not zero.
    write_png(tmp_path / "b.png", np.array([[[half, half, 65535]]], np.uint16))
    assert read_kitti_flow(tmp_path / "b.png").tolist() == [[[0, 0]]]


@pytest.mark.parametrize("value", [512.0, -512.01, 1e10, np.inf, -np.inf])
def test_kitti_flow_refuses_values_out_of_range(tmp_path, value):
    flow = np.zeros((3, 4, 2))
    flow[1, 2, 1] = value
    with pytest.raises(ValueError, match=r"outside -512 to 511\.984375 px.*at 1 pixels.*NaN"):
        write_kitti_flow(tmp_path / "a.png", flow)
    assert contents(tmp_path) == set()


def test_kitti_flow_refuses_other_arrays(tmp_path):
    for shape in [(4, 5), (4, 5, 3), (0, 5, 2)]:
        with pytest.raises(ValueError, match=r"expected \(H, W, 2\)"):
            write_kitti_flow(tmp_path / "a.png", np.zeros(shape))
    with pytest.raises(TypeError, match="complex128"):
        write_kitti_flow(tmp_path / "a.png", np.zeros((4, 5, 2), complex))
    for image, kind in [(GREY16, "1 x uint16"), (COLOUR8, "3 x uint8"), (GREY8, "1 x uint8")]:
        write_png(tmp_path / "b.png", image)
        with pytest.raises(FormatError, match=rf"b\.png is a picture of {kind}, expected 3 x"):
            read_kitti_flow(tmp_path / "b.png")
    assert contents(tmp_path) == {"b.png"}


def test_kitti_flow_refuses_every_truncation(tmp_path):
    write_kitti_flow(tmp_path / "a.png", GREY8[:8, :10].reshape(8, 5, 2))
    data = (tmp_path / "a.png").read_bytes()
    for length in range(1, len(data)):
        (tmp_path / "a.png").write_bytes(data[:length])
        with pytest.raises(FormatError, match=r"a\.png"):
            read_kitti_flow(tmp_path / "a.png")
