"""Small files to start from, made by the writers of the project or in memory."""

import functools
import io
import json
import struct
from dataclasses import asdict, fields
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from PIL import Image

from tisfm import Camera, Settings
from tisfm.camera_file import write_camera
from tisfm.formats import write_depth_png, write_dpt, write_flo, write_kitti_flow, write_png
from tisfm.formats.label_picture import write_label_png
from tisfm.formats.npz import write_npz
from tisfm.interpretation import Interpretation
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.path_check import PairEvidence, PathCheck
from tisfm.status import History, Status
from tisfm.trajectory import write_kitti, write_tum

H, W = 8, 11
FRAMES = 3
_random = np.random.default_rng(5)
GREY = _random.integers(0, 256, (H, W), np.uint8)
COLOUR = _random.integers(0, 256, (H, W, 3), np.uint8)
LABELS = _random.integers(0, 4, (H, W), np.uint8)
POSES = np.tile(np.eye(4), (FRAMES, 1, 1))
POSES[:, 0, 3] = range(FRAMES)
TWELVE = b"".join(b"1 0 0 %d 0 1 0 0 0 0 1 0\n" % k for k in range(FRAMES))


def written(write, *arguments, suffix="", **options):
    """Return the bytes of the file that a writer leaves."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"seed{suffix}"
        write(path, *arguments, **options)
        return path.read_bytes()


def pictures():
    found = [written(write_png, GREY), written(write_png, COLOUR)]
    found.append(written(write_png, COLOUR.astype(np.uint16) * 257))
    found.append(written(write_label_png, LABELS))
    for suffix in (".bmp", ".jpg", ".tif", ".webp", ".ppm", ".pgm"):
        found.append(bytes(cv2.imencode(suffix, GREY if suffix == ".pgm" else COLOUR)[1]))
    for suffix in (".tif", ".pfm", ".hdr"):
        found.append(bytes(cv2.imencode(suffix, COLOUR.astype(np.float32) / 255)[1]))
    for kind, more in (
        ("TIFF", {"compression": "tiff_adobe_deflate"}),
        ("TIFF", {"compression": "packbits"}),
        ("JPEG", {"progressive": True, "exif": _exif()}),
        ("PNG", {"exif": _exif()}),
        ("WEBP", {"lossless": True}),
        ("JPEG2000", {"num_resolutions": 1}),
    ):
        file = io.BytesIO()
        Image.fromarray(COLOUR).save(file, kind, **more)
        found.append(file.getvalue())
    return found


def _exif():
    exif = Image.Exif()
    exif[274] = 6
    exif.get_ifd(0x8769).update({37386: 5.0, 41989: 35})
    return exif


def labels():
    return [written(write_label_png, LABELS), written(write_png, LABELS)]


def depth_png():
    return [written(write_depth_png, LABELS + 1.0, scale=100.0)]


def kitti_flow():
    return [written(write_kitti_flow, _random.normal(size=(H, W, 2)))]


def flo():
    return [written(write_flo, np.ones((2, 3, 2), np.float32))]


def dpt():
    return [written(write_dpt, np.ones((2, 3), np.float32))]


def cam():
    return [struct.pack("<f21d", 202021.25, 500, 0, 5, 0, 500, 4, 0, 0, 1, *range(12))]


def kitti_calibration():
    line = b"500 0 5 0 0 500 4 0 0 0 1 0\n"
    return [b"P0: " + line + b"P2: " + line, b"P_rect_02: " + line]


def calibration():
    return [
        b"fx fy cx cy k1 k2 p1 p2\n500 500 5 4 0.1 0 0 0\n",
        b"fx fy cx cy depth_scale\n500 500 5 4 5000\n",
    ]


def one_pose():
    return [b"1 0 0 1\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"]


def twelve():
    return [written(write_kitti, POSES), TWELVE, b"\xef\xbb\xbf" + TWELVE]


def tum():
    return [written(write_tum, POSES, np.arange(FRAMES)), b"1 0 0 0 0 0 0 1\n2.5 1 0 0 0 1 0 0\n"]


def camera():
    about = {"origin": "estimated", "focal_std": 2.0, "seen": True, "message": "found"}
    return [
        written(write_camera, Camera(500.0), (H, W)),
        written(
            write_camera, Camera((500.0, 510.0), (5, 4), (0.1, 0, 0, 0), readout=0.5), (H, W), about
        ),
        written(write_camera, Camera(500.0), (H, W), about),
    ]


@functools.cache
def interpretations():
    """A field and a rigid motion, as they are and compact, without computing either."""
    shared = dict(
        rho=np.full((6, H, W), 0.25, np.float32),
        flow=np.ones((H, W, 2), np.float32),
        inverse_depth=np.ones((H, W), np.float32),
        confidence=np.full((H, W), 0.5, np.float32),
        occlusion=np.zeros((H, W), bool),
        frame=GREY,
        camera=Camera(500.0),
        status=Status("converged", "well"),
        history=History(
            level=np.zeros(1, np.int32),
            warp=np.zeros(1, np.int32),
            energy=np.ones(1),
            half_quadratic=np.ones(1),
            change=np.ones(1),
        ),
        version="0",
    )
    field = dict(inverse_depth_std=None, motions=None, labels=None)
    rigid = dict(
        inverse_depth_std=np.ones((H, W), np.float32),
        motions=np.ones((1, 6)),
        labels=np.zeros((H, W), np.int32),
        focal_deviation=np.inf,
    )
    return [
        written(_save, Interpretation(**shared, **own, settings=Settings(motion=motion)), compact)
        for own, motion in ((field, "field"), (rigid, "camera"))
        for compact in (False, True)
    ]


def _save(path, result, compact):
    result.save(path, compact=compact)


def depth_of_frame():
    halves = np.ones((H, W), np.float16)
    parts = {"inverse_depth": halves, "inverse_depth_std": halves, "scale": np.array(0.5)}
    return [written(write_npz, parts)]


def path_of_frames():
    piece, times = np.zeros(FRAMES, np.int32), np.arange(FRAMES, dtype=np.float64)
    arrays = {"poses": POSES, "piece": piece, "times": times, "unit": np.ones(1)}
    arrays |= {f"{name}_deviation": np.ones((FRAMES, 3)) for name in ("position", "rotation")}
    return [written(write_npz, arrays)]


def objects():
    thing = MovingObject(
        id=1,
        frames=(0, 1),
        boxes=np.ones((2, 4), np.int32),
        poses=POSES[:2],
        extent=np.ones(3),
        scale_from="size",
    )
    return [json.dumps({"format": 1, "objects": [thing.as_json()]}).encode()]


def reconstructions(motion="objects"):
    numbers = [field.name for field in fields(PairEvidence)]
    pair = PairEvidence(**dict.fromkeys(numbers, 1))
    about = {
        "format": 6,
        "version": "0",
        "camera": asdict(Camera(500.0)),
        "calibration": {"origin": "guessed", "focal_std": None},
        "settings": asdict(Settings(motion=motion)),
        "shape": [H, W],
        "names": [f"{k}" for k in range(FRAMES)],
        "status": [["converged", ""]] * FRAMES,
        "depth_error": [0.02, None, *[0.2] * (FRAMES - 2)],
        "depth_share": [1.0, 0.0, *[0.3] * (FRAMES - 2)],
        "grade": ["good", "no depth", *["poor"] * (FRAMES - 2)],
        "zoom": [1.0] * FRAMES,
        "notes": [],
        "keyframes": [0, 2],
        "skipped": [[7, "damaged"]],
        "checks": [PathCheck(pairs=(pair,), fixed_share=0.0, infinity_motion=3.0).as_json()],
    }
    return [json.dumps(about).encode()]


def disparities():
    found = []
    for save in (np.save, np.savez, np.savez_compressed):
        for array in (LABELS, LABELS.astype(np.float32)):
            file = io.BytesIO()
            save(file, array)
            found.append(file.getvalue())
    return found


@functools.cache
def videos():
    found = []
    for suffix, code in ((".avi", "MJPG"), (".mp4", "mp4v"), (".avi", "XVID"), (".mkv", "VP80")):
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"seed{suffix}"
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 25, (32, 32))
            for _ in range(4 * writer.isOpened()):
                writer.write(_random.integers(0, 256, (32, 32, 3), np.uint8))
            writer.release()
            if path.exists():
                found.append(path.read_bytes())
    return [data for data in found if data]
