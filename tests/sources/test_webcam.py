"""A camera, played by a class in place of OpenCV's."""

import itertools
from typing import ClassVar

import cv2
import numpy as np
import pytest

from tests.sources.made import FRAMES
from tisfm.sources import FrameSource
from tisfm.sources.webcam import webcam_number


class Camera:
    """Takes a frame every tenth of a second, keeps four, and drops what comes after."""

    made: ClassVar = []
    clock = 0.0
    ends = None

    def __init__(self, number):
        self.number, self.open, self.taken, self.waiting = number, number != 7, 0, []
        self.made.append(self)

    def isOpened(self):
        return self.open

    def get(self, property):
        return 10.0 if property == cv2.CAP_PROP_FPS else 0.0

    def grab(self):
        self._expose()
        if not self.waiting:
            type(self).clock = (self.taken + 1) / 10
            self._expose()
        self.frame = self.waiting.pop(0)
        return self.ends is None or self.frame < self.ends

    def _expose(self):
        while (self.taken + 1) / 10 <= self.clock:
            if len(self.waiting) < 4:
                self.waiting.append(self.taken)
            self.taken += 1

    def retrieve(self):
        grey = FRAMES[self.frame % 6]
        return True, np.dstack([grey, grey // 2, np.full_like(grey, self.frame)])  # blue first

    def release(self):
        self.open = False


@pytest.fixture(autouse=True)
def camera(monkeypatch):
    monkeypatch.setattr(Camera, "made", [])
    monkeypatch.setattr(Camera, "clock", 0.0)
    monkeypatch.setattr(Camera, "ends", None)
    monkeypatch.setattr(cv2, "VideoCapture", Camera)
    monkeypatch.setattr("tisfm.sources.webcam.time.monotonic", lambda: Camera.clock)
    return Camera


@pytest.mark.parametrize(
    ("source", "number"), [("webcam", 0), ("webcam:0", 0), ("webcam:12", 12), ("WebCam:1", 1)]
)
def test_names_of_cameras(camera, source, number):
    FrameSource(source)
    assert [one.number for one in camera.made] == [number]
    assert not camera.made[0].open  # but while it is read


@pytest.mark.parametrize("source", ["webcam:", "webcam:-1", "webcam:a", "webcams", "0", "a/webcam"])
def test_other_names_are_no_webcam(source):
    assert webcam_number(source) is None
    with pytest.raises(FileNotFoundError, match="there is no file or folder"):
        FrameSource(source)


def test_a_file_named_like_a_webcam_is_read(folder, monkeypatch):
    folder.rename(folder.with_name("webcam"))
    monkeypatch.chdir(folder.parent)
    assert FrameSource("webcam").count == 5


def test_a_camera_that_is_not_there():
    with pytest.raises(OSError, match="there is no webcam:7 that can be opened"):
        FrameSource("webcam:7")


def test_frames_in_time(camera):
    frames = list(FrameSource("webcam", stop=5).frames())
    assert [frame.index for frame in frames] == list(range(5))
    assert [frame.name for frame in frames][:2] == ["webcam_000000", "webcam_000001"]
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(5) / 10, atol=1e-9)
    np.testing.assert_array_equal(frames[2].image[..., 2], FRAMES[2])
    assert [frame.image[0, 0, 0] for frame in frames] == list(range(5))  # red
    assert not camera.made[-1].open


def test_waiting_frames_are_dropped(camera):
    """Who takes a second for a frame gets the one that comes next, at its own time."""
    frames = FrameSource("webcam").frames()
    for _ in range(5):
        before = camera.clock
        frame = next(frames)
        assert 0 < camera.clock - before <= 0.1 + 1e-9
        assert (frame.image[0, 0, 0] + 1) / 10 == pytest.approx(camera.clock)
        assert frame.time == pytest.approx(camera.clock - 0.1)
        camera.clock += 1.03
    frames.close()
    assert not camera.made[-1].open


def test_steps_count_the_frames_that_are_taken():
    frames = itertools.islice(FrameSource("webcam", start=2, step=3).frames(), 3)
    assert [frame.index for frame in frames] == [2, 5, 8]


def test_the_number_of_frames_is_not_known():
    with pytest.raises(TypeError, match="the length of webcam:0 is not known"):
        len(FrameSource("webcam"))


def test_a_camera_that_is_unplugged(camera):
    camera.ends = 3
    found = []
    with pytest.raises(OSError, match="webcam:0 gives no more frames: check that it is still"):
        for frame in FrameSource("webcam").frames():
            found.append(frame.index)
    assert found == [0, 1, 2]
    assert not camera.made[-1].open
