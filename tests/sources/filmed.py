"""Videos made by PyAV: with any times, rotation and damage."""

import random
from fractions import Fraction

import numpy as np
import pytest

from tests.sources.made import make_frames

av = pytest.importorskip("av", reason="PyAV is not installed")

RATE = 30


def colour_frames(count, height=48, width=64):
    """Frames of a texture that moves, red rising to the right and green downwards."""
    red = np.broadcast_to(np.linspace(0, 255, width), (height, width))
    green = np.broadcast_to(np.linspace(0, 255, height)[:, None], (height, width))
    blue = make_frames(count, height, width)
    return [np.stack([red, green, frame], axis=-1).astype(np.uint8) for frame in blue]


def film(
    path,
    frames,
    times=None,
    *,
    codec="libx264",
    pixels="yuv420p",
    rotation=0,
    unit=Fraction(1, 90000),
    options=None,
    **context,
):
    """Write frames at their times, s; by default RATE of them a second."""
    if codec not in av.codecs_available:
        pytest.skip(f"this build of PyAV cannot write {codec}")
    times = [k / RATE for k in range(len(frames))] if times is None else times
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE, options=options or {})
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.codec_context.time_base = pixels, unit
        for name, value in context.items():
            setattr(stream.codec_context, name, value)
        if rotation:
            if not hasattr(stream, "set_display_rotation"):
                pytest.skip("this PyAV cannot write a rotation")
            stream.set_display_rotation(rotation)
        for array, time in zip(frames, times, strict=True):
            frame = av.VideoFrame.from_ndarray(array, format="rgb24")
            frame.pts, frame.time_base = round(time / unit), unit
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def damage(path, count, where=0.5, seed=1):
    """Write noise over some bytes of a file."""
    data, noise = bytearray(path.read_bytes()), random.Random(seed)
    first = int(where * len(data))
    for k in range(first, first + count):
        data[k] = noise.randrange(256)
    path.write_bytes(data)


def cut(path, share):
    """Leave the beginning of a file."""
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
