"""What the tests of sources and sequences share: frames, and sources of them."""

import weakref
from itertools import product

import cv2
import numpy as np
import pytest

import tisfm
from tisfm.formats import write_png
from tisfm.sources import FrameSource

H, W = 24, 40
QUICK = tisfm.Settings(warps=1, outer_iterations=1, sweeps=2)


def make_frames(count, height=H, width=W):
    """Frames of a texture that moves by one pixel; they can be told apart."""
    noise = np.random.default_rng(3).uniform(0, 255, (height, width + count)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    return [texture[:, count - k :][:, :width].astype(np.uint8) for k in range(count)]


FRAMES = make_frames(6)


def numbered(folder):
    return [folder / f"frame{number}.png" for number in (1, 2, 9, 10, 11)]


def make_video(path, codec, count=6):
    frames = make_frames(count, 48, 64)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip(f"this build of OpenCV cannot write {codec} video")
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    return frames


def check_frames(source, expected, step=1):
    """Check the frames of a source, pair by pair, and return the names of the pairs."""
    pairs = list(FrameSource(source, step=step))
    assert len(pairs) == len(expected) - 1
    for pair, frame0, frame1 in zip(pairs, expected[:-1], expected[1:], strict=True):
        np.testing.assert_array_equal(pair.frame0, frame0)
        np.testing.assert_array_equal(pair.frame1, frame1)
    assert [pair.name1 for pair in pairs[:-1]] == [pair.name0 for pair in pairs[1:]]
    return [pair.name0 for pair in pairs]


class Counted:
    """A generator's frames, counted while any part of the program still holds them."""

    def __init__(self, count):
        self.count, self.made, self.alive, self.most = count, 0, 0, 0

    def __iter__(self):
        for k in range(self.count):
            # A new array each time: with a copy kept here, it would be alive for that reason.
            yield self._make(k)

    def _make(self, k):
        frame = FRAMES[k % len(FRAMES)].copy()
        self.made += 1
        self.alive += 1
        self.most = max(self.most, self.alive)
        weakref.finalize(frame, self._gone)
        return frame

    def _gone(self):
        self.alive -= 1


@pytest.fixture
def folder(tmp_path):
    """A folder of five frames whose natural order is not the alphabetical one."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, frame in zip((1, 2, 9, 10, 11), FRAMES, strict=False):
        write_png(folder / f"frame{number}.png", frame)
    return folder


CODECS = [("video.avi", "MJPG"), ("video.mp4", "mp4v")]


@pytest.fixture(params=product(CODECS, ("av", "opencv")), ids=lambda p: f"{p[0][1]}, {p[1]}")
def video(request, tmp_path, monkeypatch):
    (name, codec), decoder = request.param
    if decoder == "av":
        pytest.importorskip("av")
    else:
        monkeypatch.setattr("tisfm.sources.video.has_av", lambda: False)
    return tmp_path / name, make_video(tmp_path / name, codec)
