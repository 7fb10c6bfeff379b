"""Files that readers failed with, or could: each is refused by a clear error, or read."""

import io
import json
import os
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.fuzz import seeds
from tests.fuzz.mutation import repaired
from tests.fuzz.targets import TARGETS
from tests.interpretation_file.stored import rewritten
from tisfm.camera_file import read_camera
from tisfm.datasets.calibration import read_calibration
from tisfm.datasets.depth_files import read_disparity
from tisfm.datasets.pose_files import read_poses
from tisfm.formats import FormatError, read_depth_png, read_flo, read_image
from tisfm.formats.image_headers import MAX_IMAGE_PIXELS
from tisfm.formats.label_picture import has_colour_palette, read_label_picture
from tisfm.interpretation import Interpretation
from tisfm.sources import video_checks
from tisfm.sources.source import FrameSource
from tisfm.sources.video import OpenCvVideo, has_av, open_video
from tisfm.trajectory import read_trajectory, read_tum

BOM = b"\xef\xbb\xbf"
READERS = (read_flo, read_image, read_depth_png, read_tum, read_camera, Interpretation.load)


def file_of(folder, data, name="x"):
    path = folder / name
    path.write_bytes(data)
    return path


def refused(name, data, folder, *words, error=FormatError):
    """Check that a reader of the fuzzer refuses bytes in one line with these words."""
    with pytest.raises(error) as caught:
        TARGETS[name].read(file_of(folder, data, f"x{TARGETS[name].suffix}"))
    text = str(caught.value)
    assert "\n" not in text and str(folder) in text
    for word in words:
        assert word in text, text


# What is no regular file


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("read", [*READERS, open_video, FrameSource])
def test_pipes_and_devices_are_refused(read, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, "/dev/zero"):
        with pytest.raises(OSError, match=rf"{path} is a device or a pipe, not a file"):
            read(str(path))


# Texts


@pytest.mark.parametrize("read", [read_poses, read_trajectory])
def test_poses_after_a_byte_order_mark(read, tmp_path):
    found = read(file_of(tmp_path, BOM + seeds.TWELVE))
    assert len(getattr(found, "poses", found)) == seeds.FRAMES


def test_other_texts_after_a_byte_order_mark(tmp_path):
    with_mark, without = (file_of(tmp_path, mark + seeds.camera()[0]) for mark in (BOM, b""))
    assert read_camera(with_mark) == read_camera(without)
    assert read_calibration(file_of(tmp_path, BOM + seeds.calibration()[0])).camera is not None
    assert TARGETS["kitti_calibration"].read(
        file_of(tmp_path, BOM + seeds.kitti_calibration()[0], "x.txt")
    )


@pytest.mark.parametrize("text", [b"\0" * 96, b"\xff" * 96, b"1 " * 100_000, b"1" * 10**6])
@pytest.mark.parametrize("name", ["poses", "tum", "trajectory", "calibration", "pose"])
def test_texts_of_other_kinds_are_refused(name, text, tmp_path):
    refused(name, text, tmp_path)


# JSON

NESTED = (b"[" * 10**5, b'{"a":' * 10**5)


@pytest.mark.parametrize("text", [*NESTED, b"1" * 5000, b"\xff\xfe\0", b"nul", b"[]", b"5"])
@pytest.mark.parametrize("name", ["reconstruction", "objects", "camera"])
def test_invalid_json_is_refused(name, text, tmp_path):
    refused(name, text, tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"shape": [10**9, 10**9]},
        {"shape": [float("inf"), 1]},
        {"shape": [0, 5]},
        {"keyframes": [float("inf")]},
        {"keyframes": [[]]},
        {"calibration": []},
        {"calibration": {"origin": "guessed", "focal_std": None, "seen": True, "radial": "k"}},
        {"camera": []},
        {"camera": {"focal": 10**400}},
        {"skipped": [[float("nan"), ""]]},
        {"status": [5, 5, 5]},
    ],
)
def test_records_with_wild_values(change, tmp_path):
    about = json.loads(seeds.reconstructions()[0]) | change
    refused("reconstruction", json.dumps(about).encode(), tmp_path, "reconstruction.json")


@pytest.mark.parametrize(
    "change", [{"boxes": [[2**40] * 4] * 2}, {"id": float("inf")}, {"extent": [10**400] * 3}]
)
def test_objects_with_wild_values(change, tmp_path):
    about = json.loads(seeds.objects()[0])
    about["objects"][0] |= change
    refused("objects", json.dumps(about).encode(), tmp_path, "objects.json")


def test_cameras_with_wild_values(tmp_path):
    about = json.loads(seeds.camera()[1])
    for change in (
        {"height": 10**400},
        {"width": True},
        {"focal": 10**400},
        {"focal_std": 10**400},
    ):
        refused("calibrated_camera", json.dumps(about | change).encode(), tmp_path)
    with pytest.raises(FormatError, match="its frames are"):
        read_camera(file_of(tmp_path, json.dumps(about | {"height": 10**400}).encode()), (8, 11))


# Archives


def test_characters_beyond_unicode(tmp_path):
    path = file_of(tmp_path, seeds.interpretations()[0], "x.npz")
    rewritten(path, about=np.array([0x110000, 0xFFFFFFFF], np.uint32).view("<U2")[0])
    with pytest.raises(FormatError, match="not a complete interpretation"):
        Interpretation.load(path)


@pytest.mark.parametrize("name", ["path", "depth_of_frame"])
def test_parts_that_are_packed(name, tmp_path):
    """Zeros that fill gigabytes take megabytes."""
    path = file_of(tmp_path, TARGETS[name].seeds()[0], "x.npz")
    rewritten(path, np.savez_compressed)
    refused(name, path.read_bytes(), tmp_path, "compressed")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("depth_of_frame", {"scale": np.ones(2)}),
        ("depth_of_frame", {"scale": np.array("1")}),
        ("depth_of_frame", {"scale": np.array(np.nan)}),
        ("depth_of_frame", {"inverse_depth": np.ones((2, 2), np.float16)}),
        ("path", {"poses": np.full((seeds.FRAMES, 4, 4), 2.0)}),
        ("path", {"piece": np.array(["a"] * seeds.FRAMES)}),
        ("path", {"times": np.ones(seeds.FRAMES, complex)}),
    ],
)
def test_arrays_of_another_kind(name, change, tmp_path):
    path = file_of(tmp_path, TARGETS[name].seeds()[0], "x.npz")
    rewritten(path, **change)
    refused(name, path.read_bytes(), tmp_path)


def test_a_packed_disparity_that_is_too_large(tmp_path):
    file = io.BytesIO()
    np.savez_compressed(file, np.broadcast_to(np.uint8(0), (2**7, 2**7)))
    data = file.getvalue()
    assert read_disparity(file_of(tmp_path, data, "x.npz")).shape == (2**7, 2**7)
    header = np.lib.format
    file = io.BytesIO()
    about = {"descr": "|u1", "fortran_order": False, "shape": (2**20, 2**20)}
    header.write_array_header_1_0(file, about)
    with pytest.raises(FormatError, match=f"at most {MAX_IMAGE_PIXELS:,}"):
        read_disparity(file_of(tmp_path, file.getvalue(), "x.npy"))


# Pictures


def png(width, height, pixels, bits=1):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", 0)

    header = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    data = chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
    return repaired(b"\x89PNG\r\n\x1a\n" + data)


READ_PICTURES = (read_image, read_depth_png, read_label_picture, has_colour_palette)


@pytest.mark.parametrize("read", READ_PICTURES)
def test_headers_that_lie_about_the_size(read, tmp_path):
    data = png(10_000, 10_000, zlib.compress(bytes(100)), bits=16)
    with pytest.raises(FormatError, match="part of its pixels is missing"):
        read(file_of(tmp_path, data))


@pytest.mark.parametrize("read", READ_PICTURES)
def test_pictures_that_are_too_large(read, tmp_path):
    """Forty megabytes of zeros, packed, which are 320 million pixels."""
    data = png(20_000, 16_000, zlib.compress(bytes(2501 * 16_000), 9))
    assert len(data) < 50_000
    with pytest.raises(FormatError, match="320000000 pixels"):
        read(file_of(tmp_path, data))


@pytest.mark.parametrize(
    "data",
    [
        b"PF\n30000 30000\n-1.0\n" + bytes(100),
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 30000\n" + bytes(100),
        b"#?RADIANCE\n#-Y 1 +X 1\n\n-Y 30000 +X 30000\n" + bytes(100),
        b"P5\n30000 30000\n255\n" + bytes(100),
    ],
)
def test_other_headers_that_lie(data, tmp_path):
    with pytest.raises(FormatError, match="900000000 pixels"):
        read_image(file_of(tmp_path, data))


@pytest.mark.parametrize(
    "header", [b"PF\n9999\x12 99999 9\n", b"Pf\n#1\n9999 9999\n-1\n", b"#?RGBE\n"]
)
def test_sizes_that_opencv_alone_sees(header, tmp_path):
    with pytest.raises(FormatError, match=r"states no size"):
        read_image(file_of(tmp_path, header + bytes(100)))


def test_a_float_tiff_that_lies(tmp_path):
    data = bytearray(cv2.imencode(".tif", np.ones((8, 11, 3), np.float32))[1])
    place = data.index(struct.pack("<HHIH", 256, 3, 1, 11))
    data[place + 8 : place + 10] = struct.pack("<H", 40000)
    place = data.index(struct.pack("<HHIH", 257, 3, 1, 8))
    data[place + 8 : place + 10] = struct.pack("<H", 40000)
    with pytest.raises(FormatError, match="1600000000 pixels"):
        read_image(file_of(tmp_path, bytes(data)))


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_tiff_whose_directory_is_nowhere(order, tmp_path):
    mark = {"<": b"II", ">": b"MM"}[order]
    data = mark + struct.pack(order + "HHHQ", 43, 8, 0, 2**64 - 1) + bytes(40)
    with pytest.raises(FormatError, match="its directory is missing"):
        read_image(file_of(tmp_path, data))


def test_pictures_that_opencv_alone_knows(tmp_path):
    """Of those only floats are read."""
    file = io.BytesIO()
    Image.new("L", (8, 8)).save(file, "GIF")
    with pytest.raises(FormatError, match="unknown format"):
        read_image(file_of(tmp_path, file.getvalue()))


# Videos


@pytest.mark.parametrize(
    "data",
    [
        b"#EXTM3U\n#EXTINF:10,\n/etc/hostname\n#EXT-X-ENDLIST\n",
        b"ffconcat version 1.0\nfile 'other.mp4'\n",
        b"<?xml version='1.0'?><MPD></MPD>",
        b"ID3\3\0\0\0\0\0\0#EXTM3U\n",
    ],
)
def test_playlists_are_refused_as_videos(data, tmp_path):
    with pytest.raises(FormatError, match="list of other files"):
        open_video(str(file_of(tmp_path, data, "film.mp4")))


@pytest.mark.parametrize("data", seeds.videos())
def test_frames_that_are_too_large(data, tmp_path, monkeypatch):
    """By what the file states, and by what its decoder finds."""
    path = str(file_of(tmp_path, data, "film.avi"))
    open_video(path)
    readers = [OpenCvVideo]
    if has_av():
        from tisfm.sources import av_video

        readers.append(av_video.AvVideo)
        with monkeypatch.context() as changed:
            changed.setattr(av_video, "_DECODER_OPTIONS", {"max_pixels": "1000"})
            with pytest.raises(ValueError, match=r"film\.avi"):
                av_video.AvVideo(path)
    monkeypatch.setattr(video_checks, "MAX_FRAME_PIXELS", 1000)
    for read in (*readers, open_video):
        with pytest.raises(FormatError, match="32 × 32 px, more than 1000 pixels"):
            read(path)


def test_an_unknown_codec_is_refused(tmp_path):
    data = next(data for data in seeds.videos() if b"XVID" in data)
    path = str(file_of(tmp_path, data.replace(b"XVID", b"Q?!q").replace(b"xvid", b"Q?!q")))
    with pytest.raises(ValueError, match="unknown format"):
        open_video(path)
    if has_av():
        from tisfm.sources.av_video import AvVideo

        with pytest.raises(ValueError, match=r"cannot be decoded|unknown codec|no frame"):
            AvVideo(path)
