"""Files of depth: what is written is read back, and what is not whole is refused."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image, PngImagePlugin

from tests.formats.written import FINITE_OR_NOT, GREY8, GREY16, PROPERTY, SHAPES, contents
from tisfm.formats import (
    FormatError,
    choose_depth_scale,
    read_depth_png,
    read_dpt,
    read_image,
    write_depth_png,
    write_dpt,
    write_png,
)


@PROPERTY
@given(
    depth=hnp.arrays(
        np.float32, SHAPES, elements=st.floats(2**-7, 100, width=32) | st.just(np.float32(np.nan))
    ),
    scale=st.floats(100, 600),
)
def test_depth_round_trip(tmp_path, depth, scale):
    write_depth_png(tmp_path / "d.png", depth, scale=scale)
    back = read_depth_png(tmp_path / "d.png")
    assert back.dtype == np.float32
    assert np.array_equal(np.isnan(back), np.isnan(depth))
    # Half a step of the file, and the rounding of float32.
    assert np.nanmax(np.abs(back - depth), initial=0) <= 0.5 / scale + 1e-5


def test_depth_values_of_the_file(tmp_path):
    depth = np.array([[0.0, -1.0, np.nan, np.inf], [-np.inf, 1e-9, 2.0, 1e300]])
    write_depth_png(tmp_path / "d.png", depth, scale=1000.4)
    assert read_image(tmp_path / "d.png").tolist() == [[0, 0, 0, 0], [0, 1, 2001, 65535]]
    assert Image.open(tmp_path / "d.png").info["tisfm:depth_scale"] == "1000.4"
    back = read_depth_png(tmp_path / "d.png", scale=1.0)
    assert np.array_equal(back, [[np.nan] * 4, [np.nan, 1, 2001, 65535]], equal_nan=True)


def test_depth_without_scale_asks_for_it(tmp_path):
    write_png(tmp_path / "d.png", GREY16)
    with pytest.raises(FormatError, match=r"does not state its scale.*give scale"):
        read_depth_png(tmp_path / "d.png")
    assert np.allclose(read_depth_png(tmp_path / "d.png", scale=5000), GREY16 / 5000)


@pytest.mark.parametrize("stated", ["", "0", "-3", "nan", "inf", "much"])
def test_depth_with_a_bad_scale_is_refused(tmp_path, stated):
    text = PngImagePlugin.PngInfo()
    text.add_text("tisfm:depth_scale", stated)
    Image.fromarray(GREY16).save(tmp_path / "d.png", pnginfo=text)
    with pytest.raises(FormatError, match="expected a finite positive number"):
        read_depth_png(tmp_path / "d.png")


def test_depth_reader_refuses_other_files(tmp_path):
    write_png(tmp_path / "d.png", GREY8)
    with pytest.raises(FormatError, match="mode L, expected 16-bit grey"):
        read_depth_png(tmp_path / "d.png", scale=1.0)
    write_depth_png(tmp_path / "d.png", GREY16, scale=2.0)
    data = (tmp_path / "d.png").read_bytes()
    for length in range(1, len(data), 7):
        (tmp_path / "d.png").write_bytes(data[:length])
        with pytest.raises(FormatError, match=r"d\.png"):
            read_depth_png(tmp_path / "d.png")


@pytest.mark.parametrize("scale", [0, -1.0, np.nan, np.inf])
def test_depth_scale_is_checked(tmp_path, scale):
    with pytest.raises(ValueError, match=r"scale is .*expected a finite positive number"):
        write_depth_png(tmp_path / "d.png", GREY16, scale=scale)
    with pytest.raises(ValueError, match=r"scale is .*expected a finite positive number"):
        read_depth_png(tmp_path / "d.png", scale=scale)
    assert contents(tmp_path) == set()


def test_depth_shape_is_checked(tmp_path):
    for shape in [(3,), (3, 4, 1), (0, 4)]:
        with pytest.raises(ValueError, match=r"expected \(H, W\)"):
            write_depth_png(tmp_path / "d.png", np.ones(shape), scale=1.0)


def test_chosen_scale_puts_the_median_at_2000(tmp_path):
    depth = np.array([[0.1, 0.2, 0.7], [np.nan, -5.0, np.inf]], np.float32)
    scale = choose_depth_scale(depth)
    write_depth_png(tmp_path / "d.png", depth, scale=scale)
    assert read_image(tmp_path / "d.png").tolist() == [[1000, 2000, 7000], [0, 0, 0]]
    with pytest.raises(ValueError, match="another pair of the sequence"):
        choose_depth_scale(np.array([[np.nan, 0.0, -1.0]]))


# Depth in Sintel's .dpt

DPT_BYTES = b"PIEH" + struct.pack("<ii3f", 1, 3, 1.0, -2.0, 1e10)


def test_dpt_bytes(tmp_path):
    depth = np.array([[1.0], [-2.0], [1e10]], np.float32)
    write_dpt(tmp_path / "a.dpt", depth)
    assert (tmp_path / "a.dpt").read_bytes() == DPT_BYTES
    assert np.array_equal(read_dpt(tmp_path / "a.dpt"), depth)


@PROPERTY
@given(depth=SHAPES.flatmap(lambda s: hnp.arrays(np.float32, s, elements=FINITE_OR_NOT)))
def test_dpt_round_trip(tmp_path, depth):
    write_dpt(tmp_path / "a.dpt", depth)
    back = read_dpt(tmp_path / "a.dpt")
    assert back.dtype == np.float32
    assert back.flags.writeable
    assert np.array_equal(back, depth, equal_nan=True)


@pytest.mark.parametrize("length", range(1, len(DPT_BYTES)))
def test_dpt_refuses_every_truncation(tmp_path, length):
    (tmp_path / "a.dpt").write_bytes(DPT_BYTES[:length])
    with pytest.raises(FormatError, match=r"a\.dpt is cut off"):
        read_dpt(tmp_path / "a.dpt")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (DPT_BYTES + b"\0", r"too long: 25 bytes, expected 24 for 1 x 3 px"),
        (b"P" + DPT_BYTES[::-1], r"not a \.dpt file"),
        (b"PIEH" + struct.pack("<ii", -1, 5), "impossible size.*width -1, height 5"),
        # Of this size, but two values per pixel.
        (b"PIEH" + struct.pack("<ii4f", 2, 1, 1, 2, 3, 4), r"too long: 28 bytes, expected 20"),
    ],
)
def test_dpt_names_the_fault(tmp_path, data, message):
    (tmp_path / "a.dpt").write_bytes(data)
    with pytest.raises(FormatError, match=message):
        read_dpt(tmp_path / "a.dpt")


def test_dpt_refuses_other_arrays(tmp_path):
    for shape in [(4,), (4, 5, 1), (0, 5), (1, 100_000)]:
        with pytest.raises(ValueError, match=r"expected \(H, W\)"):
            write_dpt(tmp_path / "a.dpt", np.zeros(shape))
    with pytest.raises(TypeError, match="complex128"):
        write_dpt(tmp_path / "a.dpt", np.zeros((4, 5), complex))
    assert contents(tmp_path) == set()
