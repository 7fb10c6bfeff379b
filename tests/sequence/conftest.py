"""Fixtures of the tests of sequences."""

import pytest

from tests.sequence.sources import (
    FRAMES,
    make_video,
)
from tisfm.formats import write_png


@pytest.fixture
def folder(tmp_path):
    """A folder of five frames whose natural order is not the alphabetical one."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, frame in zip((1, 2, 9, 10, 11), FRAMES, strict=False):
        write_png(folder / f"frame{number}.png", frame)
    return folder


@pytest.fixture(params=[("video.avi", "MJPG"), ("video.mp4", "mp4v")], ids=["MJPG", "mp4v"])
def video(request, tmp_path):
    name, codec = request.param
    return tmp_path / name, make_video(tmp_path / name, codec)
