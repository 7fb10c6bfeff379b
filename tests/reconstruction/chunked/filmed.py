"""A film in files, and functions that make chunks in this process."""

from functools import cache

import cv2
import numpy as np

import tisfm
from tests.reconstruction.films import along
from tests.rendered import room_film

FAST = tisfm.Settings.preset("fast", motion="camera")
COUNT, CHUNK = 24, 12  # frames of the film, and of a chunk: there are three chunks


@cache
def film():
    """Return a film of a slow steady camera."""
    return room_film(along(COUNT, np.array((0.06, 0, 0.025, 0, 0.006, 0))), 120, 160, samples=1)


@cache
def smaller_film():
    """Return a film of the same camera with tiny frames, for tests with given poses."""
    return room_film(film().poses, 60, 80, samples=1)


def write_frames(folder, frames):
    """Write frames f00.png, f01.png, …"""
    folder.mkdir()
    for k, frame in enumerate(frames):
        cv2.imwrite(str(folder / f"f{k:02d}.png"), frame)
    return folder


def in_turn(function, items):
    """Call a function with each item in this process."""
    for number, item in enumerate(items):
        yield number, function(item)


def contents(folder):
    """Return the files below a folder by name, without timings."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "timings.csv"
    }
