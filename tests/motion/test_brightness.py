"""Statuses that doubt a result, for two frames of different brightness."""

from types import SimpleNamespace

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import walk
from tisfm.motion.depth_checks import DOUBTFUL_STATUSES, with_brightness_advice
from tisfm.status import Status


def test_a_doubt_says_that_one_frame_is_darker():
    shot = walk(2)
    dark = np.rint(0.7 * shot.frames[1].astype(float)).astype(np.uint8)

    def found(frame1, motion, **changes):
        settings = tisfm.Settings.preset("fast", motion=motion, **changes)
        return tisfm.interpret(shot.frames[0], frame1, camera=shot.camera, settings=settings).status

    assert "The light changed" in found(dark, "camera").message  # it is undone
    doubt = found(dark, "camera", gradient=0.0)
    assert doubt in DOUBTFUL_STATUSES and "Frame 0 is 1.4" in doubt.message
    assert "bring both frames to one brightness" in doubt.message
    assert "bright" not in found(shot.frames[1], "camera").message
    assert "bright" not in found(dark, "field").message  # brightness hardly disturbs this
    for frame1, told in ((dark[::-1, ::-1], True), (shot.frames[1][::-1, ::-1], False)):
        doubt = found(frame1, "field")
        assert doubt in DOUBTFUL_STATUSES and ("times as bright" in doubt.message) == told


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"motion": "field"}, "one brightness, or set brightness=0"),
        ({"motion": "camera"}, "one brightness, or set brightness=0 and depth_brightness=0"),
        ({"motion": "camera", "brightness": 0.0}, "one brightness, or set depth_brightness=0"),
        ({"motion": "field", "brightness": 0.0}, "one brightness"),
        ({"motion": "field", "gradient": 0.0}, "one brightness"),
    ],
)
def test_advice_about_brightness(changes, advice):
    settings = tisfm.Settings.preset("fast", **changes)
    doubt = Status("unrelated", "why")

    def told(level0, level1, status=doubt):
        grey = [np.full((8, 8), level, np.float32) for level in (level0, level1)]
        pyramid = SimpleNamespace(frames0=[grey[0]], frames1=[grey[1]])
        return with_brightness_advice(status, pyramid, settings)

    assert told(100, 200) == "unrelated"
    assert told(100, 200).message.startswith("why. Frame 1 is 2 times as bright as frame 0: ")
    assert told(100, 80).message.endswith(advice)
    assert "Frame 0 is 1.25 times as bright as frame 1" in told(100, 80).message
    assert "Frame 0 is 200 times" in told(100, 0.5).message
    for levels in ((100, 110), (110, 100), (0, 100), (-50, 100), (np.inf, 100), (np.nan, 100)):
        assert told(*levels) is doubt
    well = Status("converged", "it is well")
    assert told(100, 200, well) is well
