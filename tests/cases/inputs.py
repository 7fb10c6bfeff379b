"""Small inputs of the kinds that failed once: a film of a room, in folders and in videos.

Everything is rendered when a test asks for it. Unless another size is asked for, frames of the room
are 240 × 320 px, grey, with a focal length of 192 px.
"""

from fractions import Fraction
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

import tisfm
from tests.rendered import room_film
from tisfm.formats import write_png

HEIGHT, WIDTH, FOCAL, RATE = 240, 320, 192.0, 25


def walk(count, velocity=(0.06, 0.01, 0.02), turn=(0.0, 0.008, 0.0), wobble=0.01):
    """Return a path of even speed that shakes a little, (count, 4, 4), camera to world.

    `velocity` is in m/frame, `turn` in rad/frame; `wobble`, rad/frame, is how far it shakes.
    """
    poses, pose = [], np.eye(4)
    for k in range(count):
        poses.append(pose)
        shaken = wobble * np.array([np.sin(0.7 * k), np.sin(0.45 * k + 1), 0.5 * np.sin(0.9 * k)])
        pose = pose @ tisfm.rigid.pose_matrix([*velocity, *(np.array(turn) + shaken)])
    return np.array(poses)


@cache
def room(count=16, height=HEIGHT, width=WIDTH, samples=1):
    """Return the frames of `walk` through a room, (count, height, width) uint8, read-only.

    The focal length is 0.6 times the width.
    """
    film = room_film(walk(count), height, width, samples=samples)
    frames = np.array([np.clip(np.rint(frame), 0, 255) for frame in film.frames]).astype(np.uint8)
    frames.flags.writeable = False
    return frames


@cache
def sliding(count=6, height=48, width=64):
    """Return frames of a texture that moves by 2 px/frame, (count, height, width) uint8.

    They are quick to make: for tests of readers, which need no path.
    """
    rng = np.random.default_rng(0)
    wide = cv2.GaussianBlur(rng.normal(size=(height, width + 2 * count)), (0, 0), 1.5)
    wide = np.clip(128 + 50 * wide / wide.std(), 0, 255).astype(np.uint8)
    frames = np.stack([wide[:, 2 * k : 2 * k + width] for k in range(count)])
    frames.flags.writeable = False
    return frames


def write_folder(folder, frames, names=None):
    """Write frames as PNG into a new folder, as f000.png, f001.png, … or by `names`."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    for k, frame in enumerate(frames):
        write_png(folder / (f"f{k:03d}.png" if names is None else names[k]), frame)
    return folder


def write_film(
    path, *streams, times=None, aspect=None, default=None, rotation=0, rate=RATE, codec="libx264"
):
    """Write a film with PyAV, each of `streams` a sequence of (H, W) uint8 frames.

    `times` are those of the frames, in 1/rate s, by default 0, 1, 2, …; `aspect` is the width of a
    pixel over its height; `default` is the number of the stream that is marked as default;
    `rotation` is the rotation that a camera writes into the file, degrees.
    """
    import av

    with av.open(str(path), "w") as file:
        written = []
        for number, frames in enumerate(streams):
            stream = file.add_stream(codec, rate=rate, options={"crf": "12", "bf": "0"})
            stream.height, stream.width = frames[0].shape
            stream.pix_fmt = "yuv420p"
            stream.codec_context.time_base = Fraction(1, rate)
            if aspect is not None:
                stream.codec_context.sample_aspect_ratio = Fraction(aspect)
            if rotation:
                if not hasattr(stream, "set_display_rotation"):
                    pytest.skip("this PyAV cannot write a rotation")
                stream.set_display_rotation(rotation)
            if default is not None:
                stream.disposition = 1 if number == default else 0
            written.append(stream)
        for k in range(len(streams[0])):
            for stream, frames in zip(written, streams, strict=True):
                frame = av.VideoFrame.from_ndarray(frames[k], "gray").reformat(format="yuv420p")
                frame.pts = k if times is None else times[k]
                frame.time_base = Fraction(1, rate)
                file.mux(stream.encode(frame))
        for stream in written:
            file.mux(stream.encode())
    return path
