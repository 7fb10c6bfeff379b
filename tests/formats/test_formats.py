"""Files: what is written is read back, and what is not whole is refused."""

import contextlib
import io
import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image, PngImagePlugin

from tisfm.formats import (
    IMAGE_SUFFIXES,
    FormatError,
    atomic_write,
    choose_depth_scale,
    read_depth_png,
    read_dpt,
    read_flo,
    read_image,
    read_kitti_flow,
    write_depth_png,
    write_dpt,
    write_flo,
    write_kitti_flow,
    write_png,
)

# The folder of a test is shared by the examples of one property: each overwrites the last.
PROPERTY = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
# Subnormal numbers are left out: a library loaded beside us may have switched them off.
FINITE_OR_NOT = st.floats(width=32, allow_subnormal=False)
SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9)


def contents(folder: Path) -> set[str]:
    """Names of everything in a folder, hidden files included."""
    return set(os.listdir(folder))


# Atomic writing


def test_atomic_write_replaces_on_success(tmp_path):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with atomic_write(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert contents(tmp_path) == {"file.bin"}


@pytest.mark.parametrize("fault", [RuntimeError, KeyboardInterrupt, SystemExit, FileNotFoundError])
def test_atomic_write_leaves_nothing_after_a_failure(tmp_path, fault):
    path = tmp_path / "file.bin"
    with pytest.raises(fault, match="inside"), atomic_write(path) as file:
        file.write(b"half")
        raise fault("inside")
    assert contents(tmp_path) == set()
    path.write_bytes(b"old")
    with pytest.raises(fault, match="inside"), atomic_write(path) as file:
        file.write(b"half")
        raise fault("inside")
    assert contents(tmp_path) == {"file.bin"}
    assert path.read_bytes() == b"old"


def test_atomic_write_explains_a_missing_folder(tmp_path):
    with (
        pytest.raises(FileNotFoundError, match="missing does not exist; create it first"),
        atomic_write(tmp_path / "missing" / "file.bin"),
    ):
        pytest.fail("the block must not run")


def test_atomic_write_explains_a_path_below_a_file(tmp_path):
    (tmp_path / "plain").write_bytes(b"x")
    with (
        pytest.raises(NotADirectoryError, match="plain is not a folder"),
        atomic_write(tmp_path / "plain" / "file.bin"),
    ):
        pytest.fail("the block must not run")


def test_atomic_write_explains_missing_permission(tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o500)
    if os.access(folder, os.W_OK):
        pytest.skip("this user may write everywhere")
    with (
        pytest.raises(PermissionError, match="a folder of your own"),
        atomic_write(folder / "file.bin"),
    ):
        pytest.fail("the block must not run")


def test_atomic_write_refuses_folders_and_devices(tmp_path):
    with pytest.raises(IsADirectoryError, match="is a folder"), atomic_write(tmp_path):
        pytest.fail("the block must not run")
    if os.path.exists("/dev/null"):
        with pytest.raises(OSError, match="device"), atomic_write("/dev/null"):
            pytest.fail("the block must not run")


@pytest.mark.skipif(os.name == "nt", reason="permissions and links of POSIX")
def test_atomic_write_honours_the_umask_and_follows_links(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "target", tmp_path / "link"
    link.symlink_to(target)
    with atomic_write(link) as file:
        file.write(b"x")
    assert link.is_symlink()
    assert target.read_bytes() == b"x"
    (tmp_path / "plain").write_bytes(b"x")
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_atomic_write_takes_the_longest_names(tmp_path):
    path = tmp_path / ("n" * 255)
    with atomic_write(path) as file:
        file.write(b"x")
    assert path.read_bytes() == b"x"


# Optical flow

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


def test_flo_refuses_what_is_no_flow(tmp_path):
    for shape in [(4, 5), (4, 5, 3), (0, 5, 2), (4, 5, 2, 1)]:
        with pytest.raises(ValueError, match=r"expected \(H, W, 2\)"):
            write_flo(tmp_path / "a.flo", np.zeros(shape))
    with pytest.raises(TypeError, match="complex128"):
        write_flo(tmp_path / "a.flo", np.zeros((4, 5, 2), complex))
    assert contents(tmp_path) == set()


# Pictures


def smooth(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Make a picture with something to compress in it."""
    noise = np.random.default_rng(3).random(shape, np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return (blurred * np.iinfo(dtype).max).astype(dtype)


def encoded(suffix: str, image: np.ndarray, **options) -> bytes:
    """Encode with OpenCV, or with Pillow where options say how."""
    if options:
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, **options)
        return buffer.getvalue()
    done, data = cv2.imencode(suffix, image[..., ::-1] if image.ndim == 3 else image)
    assert done
    return data.tobytes()


GREY8, GREY16 = smooth((21, 34), np.uint8), smooth((21, 34), np.uint16)
COLOUR8, COLOUR16 = smooth((21, 34, 3), np.uint8), smooth((21, 34, 3), np.uint16)
FLOAT = GREY16.astype(np.float32) / 7
FILES = {
    "png-grey8": (encoded(".png", GREY8), GREY8),
    "png-grey16": (encoded(".png", GREY16), GREY16),
    "png-colour8": (encoded(".png", COLOUR8), COLOUR8),
    "png-colour16": (encoded(".png", COLOUR16), COLOUR16),
    "pgm-8": (encoded(".pgm", GREY8), GREY8),
    "pgm-16": (encoded(".pgm", GREY16), GREY16),
    "ppm": (encoded(".ppm", COLOUR8), COLOUR8),
    "bmp-grey": (encoded(".bmp", GREY8), GREY8),
    "bmp-colour": (encoded(".bmp", COLOUR8), COLOUR8),
    "tiff-grey8": (encoded(".tiff", GREY8), GREY8),
    "tiff-grey16": (encoded(".tiff", GREY16), GREY16),
    "tiff-colour16": (encoded(".tiff", COLOUR16), COLOUR16),
    "tiff-float": (encoded(".tiff", FLOAT), FLOAT),
    "tiff-float-colour": (encoded(".tiff", np.dstack([FLOAT] * 3)), np.dstack([FLOAT] * 3)),
    "tiff-plain": (encoded("", COLOUR8, format="TIFF"), COLOUR8),
    "tiff-deflate": (encoded("", GREY16, format="TIFF", compression="tiff_deflate"), GREY16),
    "jpeg-grey": (encoded(".jpg", GREY8), None),
    "jpeg-colour": (encoded(".jpg", COLOUR8), None),
    "jpeg-progressive": (encoded("", COLOUR8, format="JPEG", progressive=True), None),
    "webp": (encoded("", COLOUR8, format="WEBP"), None),
}


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
def test_damaged_pictures_raise_nothing_else(tmp_path, data):
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
def test_readers_explain_what_is_not_a_file(tmp_path, reader):
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
def test_text_is_no_picture(tmp_path, reader):
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


def test_png_refuses_what_is_no_picture(tmp_path):
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


# Depth


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
def test_kitti_flow_refuses_what_it_cannot_hold(tmp_path, value):
    flow = np.zeros((3, 4, 2))
    flow[1, 2, 1] = value
    with pytest.raises(ValueError, match=r"outside -512 to 511\.984375 px.*at 1 pixels.*NaN"):
        write_kitti_flow(tmp_path / "a.png", flow)
    assert contents(tmp_path) == set()


def test_kitti_flow_refuses_what_is_no_flow(tmp_path):
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


def test_dpt_refuses_what_is_no_depth(tmp_path):
    for shape in [(4,), (4, 5, 1), (0, 5), (1, 100_000)]:
        with pytest.raises(ValueError, match=r"expected \(H, W\)"):
            write_dpt(tmp_path / "a.dpt", np.zeros(shape))
    with pytest.raises(TypeError, match="complex128"):
        write_dpt(tmp_path / "a.dpt", np.zeros((4, 5), complex))
    assert contents(tmp_path) == set()
