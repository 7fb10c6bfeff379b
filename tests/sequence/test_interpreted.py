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


def test_frames_are_read_on_demand():
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


def test_masks_are_those_of_their_frames():
    masks = np.ones((len(FRAMES), *FRAMES[0].shape[:2]), bool)
    masks[2, :8] = False
    results = list(tisfm.interpret_sequence(FRAMES, settings=QUICK, mask=masks))
    for k, result in enumerate(results):
        expected = tisfm.interpret(*FRAMES[k : k + 2], settings=QUICK, mask=masks[k : k + 2])
        np.testing.assert_array_equal(result.rho, expected.rho)
        np.testing.assert_array_equal(result.occlusion, expected.occlusion)
        assert (result.occlusion[:8].mean() > 0.8) == (k in (1, 2))
    assert len(results) == len(FRAMES) - 1
    every_second = list(tisfm.interpret_sequence(FRAMES, settings=QUICK, mask=masks, step=2))
    assert every_second[1].occlusion[:8].all()  # of frames 2 and 4


def test_one_mask_is_for_all_frames():
    mask = np.ones(FRAMES[0].shape[:2], bool)
    mask[:8] = False
    for result in tisfm.interpret_sequence(FRAMES, settings=QUICK, mask=mask):
        assert result.occlusion[:8].all() and not result.confidence[:8].any()


@pytest.mark.parametrize(
    ("mask", "error", "words"),
    [(np.ones((3, 5)), ValueError, "frame_000000 is"), ("gone", FileNotFoundError, "gone"),
     (np.zeros(FRAMES[0].shape[:2]), ValueError, "frame_000000 and frame_000001: mask is black"),
     (np.ones((2, *FRAMES[0].shape[:2])), ValueError, "2 masks")],
    ids=["size", "path", "black", "number"],
)  # fmt: skip
def test_other_values_than_masks_are_refused(mask, error, words):
    with pytest.raises(error, match=words):
        next(tisfm.interpret_sequence(FRAMES, settings=QUICK, mask=mask))
