"""Frames in, interpretations out, two frames at a time."""

import gc

import numpy as np
import pytest

import tisfm
from tests.sources.made import FRAMES, QUICK, Counted


def test_every_pair_is_interpreted(folder):
    camera = tisfm.Camera(50.0)
    results = list(tisfm.interpret_sequence(folder, camera=camera, settings=QUICK))
    assert len(results) == 4
    for result, frame0, frame1 in zip(results, FRAMES, FRAMES[1:], strict=False):
        expected = tisfm.interpret(frame0, frame1, camera=camera, settings=QUICK)
        np.testing.assert_array_equal(result.rho, expected.rho)
        assert result.camera == camera and result.settings == QUICK


@pytest.mark.parametrize("step", [1, 3])
def test_two_frames_are_alive_at_a_time(step):
    frames = Counted(12)
    gc.disable()  # what only the collector frees would be held in a cycle
    try:
        results = tisfm.interpret_sequence(frames, settings=QUICK, step=step)
        for _ in results:
            pass
    finally:
        gc.enable()
    assert frames.made == 12
    assert frames.most == 2
    assert frames.alive == 0


def test_frames_are_taken_as_they_are_needed():
    frames = Counted(12)
    results = tisfm.interpret_sequence(frames, settings=QUICK)
    assert frames.made == 0
    next(results)
    assert frames.made == 2
    next(results)
    assert frames.made == 3
    results.close()


def test_a_sequence_without_end():
    def forever():
        while True:
            yield from FRAMES

    results = tisfm.interpret_sequence(forever(), settings=QUICK)
    assert [next(results).status for _ in range(3)]
