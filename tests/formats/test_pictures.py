"""Pictures: read as they are, whole or refused."""

import contextlib
import io
import struct
import subprocess

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import EpsImagePlugin, Image

from tests.formats.written import (
    COLOUR8,
    COLOUR16,
    FILES,
    GREY8,
    GREY16,
    PROPERTY,
    SHAPES,
    contents,
    encoded,
    smooth,
)
from tisfm.focal_guess import guess_focal
from tisfm.formats import (
    IMAGE_SUFFIXES,
    FormatError,
    png,
    read_depth_png,
    read_dpt,
    read_flo,
    read_image,
    read_kitti_flow,
    write_depth_png,
    write_png,
)


@pytest.mark.parametrize("name", FILES)
def test_pictures_keep_values_and_type(tmp_path, name):
    data, image = FILES[name]
    (tmp_path / "a").write_bytes(data)
    back = read_image(tmp_path / "a")
    assert back.flags.c_contiguous
    if image is None:  # lossy: the order of the colours must still be right
        image = GREY8 if name == "jpeg-grey" else COLOUR8
        assert back.shape == image.shape
        assert np.abs(back.astype(float) - image).mean() < 20
    else:
        assert back.dtype == image.dtype
        assert np.array_equal(back, image)


@pytest.mark.parametrize("name", FILES)
def test_truncated_pictures_are_refused(tmp_path, name, capfd):
    data, _ = FILES[name]
    (tmp_path / "a").write_bytes(data)
    complete = read_image(tmp_path / "a")
    lengths = {len(data) * tenth // 10 for tenth in range(1, 10)}
    for length in sorted(lengths | set(range(1, 17)) | set(range(len(data) - 16, len(data)))):
        (tmp_path / "a").write_bytes(data[:length])
        if name.startswith("jpeg") and length >= len(data) - 2:
            # The last two bytes only say that the end is reached: all pixels may be there.
            with contextlib.suppress(FormatError):
                assert np.array_equal(read_image(tmp_path / "a"), complete)
            continue
        with pytest.raises(FormatError) as caught:
            read_image(tmp_path / "a")
        assert str(tmp_path / "a") in str(caught.value)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


@PROPERTY
@given(data=st.data())
def test_damaged_pictures_raise_format_errors_only(tmp_path, data):
    good, _ = FILES[data.draw(st.sampled_from(sorted(FILES)))]
    bad = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        # Headers are where a wrong byte does most.
        limit = data.draw(st.sampled_from([64, len(bad)]))
        bad[data.draw(st.integers(0, limit - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "a").write_bytes(bytes(bad))
    try:
        image = read_image(tmp_path / "a")
    except FormatError as error:
        assert "\n" not in str(error)
    else:
        assert image.ndim in (2, 3)


def test_transparency_is_dropped(tmp_path):
    with_alpha = np.dstack([COLOUR8, GREY8])
    Image.fromarray(with_alpha).save(tmp_path / "a.png")
    assert np.array_equal(read_image(tmp_path / "a.png"), COLOUR8)


def test_pictures_of_other_numbers_are_refused(tmp_path):
    (tmp_path / "a.tiff").write_bytes(encoded(".tiff", GREY8.astype(np.float64)))
    with pytest.raises(FormatError, match="float64 pixels, expected uint8, uint16 or float32"):
        read_image(tmp_path / "a.tiff")


def test_reading_restores_the_log_level(tmp_path):
    logging = cv2.utils.logging
    before = logging.getLogLevel()
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(FormatError):
        read_image(tmp_path / "a.png")
    assert logging.getLogLevel() == before


@pytest.mark.parametrize(
    "reader", [read_image, read_flo, read_dpt, read_kitti_flow, read_depth_png]
)
def test_readers_name_missing_files(tmp_path, reader):
    with pytest.raises(FileNotFoundError, match=r"nothing\.xyz does not exist: check the path"):
        reader(tmp_path / "nothing.xyz")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        reader(tmp_path)
    (tmp_path / "empty").write_bytes(b"")
    with pytest.raises(FormatError, match="empty is empty"):
        reader(tmp_path / "empty")
    with pytest.raises(NotADirectoryError, match="cannot be read"):
        reader(tmp_path / "empty" / "below")


@pytest.mark.parametrize("reader", [read_image, read_depth_png])
def test_text_is_refused_as_a_picture(tmp_path, reader):
    (tmp_path / "a.png").write_bytes(b"just some text")
    with pytest.raises(FormatError, match=r"a\.png cannot be read as a"):
        reader(tmp_path / "a.png")


@PROPERTY
@given(
    image=st.tuples(
        SHAPES, st.sampled_from([(), (3,)]), st.sampled_from([np.uint8, np.uint16])
    ).flatmap(lambda drawn: hnp.arrays(drawn[2], drawn[0] + drawn[1]))
)
def test_png_round_trip(tmp_path, image):
    write_png(tmp_path / "a.png", image)
    back = read_image(tmp_path / "a.png")
    assert back.dtype == image.dtype
    assert np.array_equal(back, image)


def test_png_of_a_view(tmp_path):
    write_png(tmp_path / "a.png", COLOUR8[::-2, ::3])
    assert np.array_equal(read_image(tmp_path / "a.png"), COLOUR8[::-2, ::3])


def test_png_refuses_other_arrays(tmp_path):
    with pytest.raises(TypeError, match="float64, expected uint8 or uint16"):
        write_png(tmp_path / "a.png", np.zeros((4, 5)))
    for shape in [(4,), (4, 5, 2), (4, 5, 4), (0, 5), (4, 0, 3)]:
        with pytest.raises(ValueError, match="expected \\(H, W\\) or"):
            write_png(tmp_path / "a.png", np.zeros(shape, np.uint8))
    assert contents(tmp_path) == set()


def test_suffixes_are_what_opencv_reads(tmp_path):
    # JPEG 2000 cannot be written smaller than this.
    grey, colour = np.zeros((48, 64), np.uint8), np.zeros((48, 64, 3), np.uint8)
    for suffix in IMAGE_SUFFIXES:
        image = grey if suffix == ".pgm" else colour
        path = tmp_path / f"a{suffix}"
        path.write_bytes(encoded(suffix, image))
        assert read_image(path).shape == image.shape


# Transparency

ALPHA = np.dstack([COLOUR8, GREY8])
ALPHA[0, :, 3] = 0  # colours that nobody sees are read as well


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_deflate"])
def test_colours_of_a_tiff_are_those_of_the_file(tmp_path, compression):
    Image.fromarray(ALPHA).save(tmp_path / "a.tif", compression=compression)
    back = read_image(tmp_path / "a.tif")
    assert back.flags.c_contiguous and back.flags.writeable
    assert np.array_equal(back, COLOUR8)


def test_a_transparent_tiff_is_turned_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera stood on its side
    Image.fromarray(ALPHA).save(tmp_path / "a.tif", exif=exif)
    Image.fromarray(COLOUR8).save(tmp_path / "b.tif", exif=exif)
    upright = read_image(tmp_path / "b.tif")
    assert upright.shape == (34, 21, 3)
    assert np.array_equal(read_image(tmp_path / "a.tif"), upright)


def tiff(array, alpha):
    """Write the bytes of a TIFF by hand: no library writes every kind of transparency.

    `alpha` is the tag ExtraSamples: 0 unknown, 1 colours multiplied by it, 2 not.
    """
    height, width, channels = array.shape
    data = array.astype(array.dtype.newbyteorder("<")).tobytes()
    entries = {
        256: (4, 1, width), 257: (4, 1, height), 258: (3, channels, 8 * array.itemsize),
        259: (3, 1, 1), 262: (3, 1, 2 if channels > 2 else 1), 273: (4, 1, 0),
        277: (3, 1, channels), 278: (4, 1, height), 279: (4, 1, len(data)), 284: (3, 1, 1),
        338: (3, 1, alpha), 339: (3, channels, 3 if array.dtype.kind == "f" else 1),
    }  # fmt: skip
    start = 8 + 2 + 12 * len(entries) + 4
    directory, values = b"", b""
    for tag, (kind, count, value) in sorted(entries.items()):
        packed = struct.pack(f"<{count}{'HI'[kind == 4]}", *[value] * count)
        if len(packed) > 4:
            packed, values = struct.pack("<I", start + len(values)), values + packed
        directory += struct.pack("<HHI", tag, kind, count) + (
            b"DATA" if tag == 273 else packed.ljust(4, b"\0")
        )
    directory = directory.replace(b"DATA", struct.pack("<I", start + len(values)))
    head = b"II*\0" + struct.pack("<IH", 8, len(entries))
    return head + directory + struct.pack("<I", 0) + values + data


@pytest.mark.parametrize("alpha", [0, 1, 2])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_every_kind_of_transparency(tmp_path, dtype, alpha):
    array = ALPHA.astype(dtype) * dtype(257 if dtype == np.uint16 else 1)
    (tmp_path / "a.tif").write_bytes(tiff(array, alpha))
    back = read_image(tmp_path / "a.tif")
    assert back.dtype == dtype
    assert np.array_equal(back, array[..., :3])


@pytest.mark.parametrize("alpha", [0, 1, 2])
def test_grey_with_transparency(tmp_path, alpha):
    (tmp_path / "a.tif").write_bytes(tiff(np.dstack([GREY8, GREY8[::-1]]), alpha))
    assert np.array_equal(read_image(tmp_path / "a.tif"), GREY8)


# What else Pillow would open

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n%%EOF\n"


def by_pillow(kind):
    buffer = io.BytesIO()
    Image.fromarray(COLOUR8).save(buffer, kind)
    return buffer.getvalue()


OTHERS = {
    "eps": POSTSCRIPT,
    "icns": lambda: by_pillow("ICNS"),
    "pcx": lambda: by_pillow("PCX"),
    "tga": lambda: by_pillow("TGA"),
    "sgi": lambda: by_pillow("SGI"),
    "pdf": lambda: by_pillow("PDF"),
}


@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize("reader", [read_image, guess_focal, read_depth_png])
def test_other_formats_are_not_opened(tmp_path, kind, reader, monkeypatch):
    """Whatever they are called: some of Pillow's readers run other programs."""
    started = []
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *a, **o: started.append(a))
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **o: started.append(a))
    data = OTHERS[kind]
    (tmp_path / "x.png").write_bytes(data if isinstance(data, bytes) else data())
    with pytest.raises(FormatError, match=r"x\.png"):
        reader(tmp_path / "x.png")
    assert not started


# Memory


def exhausted(*arguments, **options):
    raise MemoryError("no more")


def exhausted_opencv(*arguments, **options):
    error = cv2.error("Failed to allocate 9663676416 bytes")
    error.code = cv2.Error.StsNoMem
    raise error


@pytest.mark.parametrize("reader", [read_image, guess_focal, read_depth_png])
def test_too_little_memory_is_a_memory_error(tmp_path, reader, monkeypatch):
    write_depth_png(tmp_path / "a.png", GREY16, scale=1.0)
    monkeypatch.setattr(Image, "open", exhausted)
    with pytest.raises(MemoryError):
        reader(tmp_path / "a.png")


def test_opencv_out_of_memory_is_a_memory_error(tmp_path, monkeypatch):
    write_png(tmp_path / "a.png", GREY8)
    monkeypatch.setattr(cv2, "imdecode", exhausted_opencv)
    with pytest.raises(MemoryError, match=r"not enough memory for .*a\.png"):
        read_image(tmp_path / "a.png")


# PNG as it is written


@pytest.mark.parametrize("reader", ["OpenCV", "Pillow"])
def test_other_readers_read_our_png(tmp_path, reader):
    for image in (GREY8, GREY16, COLOUR8, COLOUR16, GREY8[:1, :1], COLOUR16[:1], GREY16[:, :1]):
        write_png(tmp_path / "a.png", image)
        if reader == "Pillow":
            if image.dtype == np.uint16 and image.ndim == 3:
                continue  # it has no such pictures
            back = np.asarray(Image.open(tmp_path / "a.png"))
        else:
            back = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
            back = back[..., ::-1] if back.ndim == 3 else back
        assert back.dtype == image.dtype
        assert np.array_equal(back, image)


def test_png_of_any_byte_order(tmp_path):
    write_png(tmp_path / "a.png", GREY16.astype(">u2"))
    assert np.array_equal(read_image(tmp_path / "a.png"), GREY16)


def test_png_in_several_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(png, "_MAX_CHUNK", 100)
    write_png(tmp_path / "a.png", COLOUR16)
    assert (tmp_path / "a.png").read_bytes().count(b"IDAT") > 3
    assert np.array_equal(read_image(tmp_path / "a.png"), COLOUR16)


def test_png_is_packed(tmp_path):
    """Not much worse than with the usual library at its usual setting."""
    picture = smooth((200, 300, 3), np.uint8)
    write_png(tmp_path / "a.png", picture)
    assert (tmp_path / "a.png").stat().st_size < 1.3 * len(encoded(".png", picture))
    write_png(tmp_path / "a.png", np.zeros((500, 500), np.uint8))
    assert (tmp_path / "a.png").stat().st_size < 3000
