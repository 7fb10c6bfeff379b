"""`window=3`: what is kept from pair to pair, and when it is dropped."""

import numpy as np
import pytest

import tisfm
from tests.sources.made import FRAMES, QUICK
from tisfm.sources import FrameSource
from tisfm.window import Window


def interpreted(frames, **options):
    return list(tisfm.interpret_sequence(frames, settings=QUICK, **options))


def equal(result, other):
    return np.array_equal(result.rho, other.rho)


@pytest.fixture
def steady():
    """Frames of a texture that moves by a pixel each time."""
    import cv2

    noise = np.random.default_rng(5).uniform(0, 255, (48, 90)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    return [texture[:, 20 - k : 84 - k].astype(np.uint8) for k in range(6)]


def test_pairs_are_the_default(steady):
    results = zip(interpreted(steady), interpreted(steady, window=2), strict=True)
    assert all(equal(*both) for both in results)


def test_the_first_pair_has_no_frame_before(steady):
    pairs, windows = interpreted(steady), interpreted(steady, window=3)
    same = [equal(*both) for both in zip(pairs, windows, strict=True)]
    assert same == [True, False, False, False, False]


def test_a_window_does_not_reach_across_a_cut(steady):
    other = [frame[::-1].copy() for frame in steady[3:]]
    frames = steady[:3] + other
    pairs, windows = interpreted(frames), interpreted(frames, window=3)
    assert pairs[2].status == windows[2].status == "unrelated"
    same = [equal(*both) for both in zip(pairs, windows, strict=True)]
    assert same == [True, False, True, True, False]


def test_a_window_does_not_reach_across_frames_left_out(steady, tmp_path):
    from tisfm.formats import write_png

    for k, frame in enumerate(steady):
        write_png(tmp_path / f"{k}.png", frame)
    (tmp_path / "2.png").write_bytes(b"no picture")
    with pytest.warns(UserWarning, match="skipped"):
        pairs = interpreted(tmp_path, bad_frames="skip")
    with pytest.warns(UserWarning, match="skipped"):
        windows = interpreted(tmp_path, bad_frames="skip", window=3)
    same = [equal(*both) for both in zip(pairs, windows, strict=True)]
    assert same == [True, True, True, False]  # of frames 0-1, 1-3, 3-4 and 4-5


def test_with_steps_pairs_are_as_far_apart_as_before(steady):
    pairs, windows = interpreted(steady, step=2), interpreted(steady, step=2, window=3)
    assert [equal(*both) for both in zip(pairs, windows, strict=True)] == [True, False]


def test_a_pair_that_fails_is_not_relied_on():
    flat = [np.full_like(FRAMES[0], 90)] * 2
    frames = [*flat, *FRAMES[:2]]
    for pair, window in zip(interpreted(frames), interpreted(frames, window=3), strict=True):
        assert equal(pair, window)


def test_kept_frames_can_be_kept_again(steady):
    """From a result that was saved, for runs that go on."""
    pairs = list(FrameSource(steady))
    window = Window()
    results = [pair.interpret(settings=QUICK, window=window) for pair in pairs]
    again = Window()
    pairs[2].store(again, results[2], camera=None)
    assert equal(pairs[3].interpret(settings=QUICK, window=again), results[3])


@pytest.mark.parametrize(
    ("window", "error", "words"),
    [
        (1, ValueError, "window is 1: expected 2 frames, a pair, or 3"),
        (4, ValueError, "window is 4"),
        (2.0, TypeError, "window is 2.0: expected 2 or 3"),
        (True, TypeError, "window is True"),
        ("3", TypeError, "window is '3'"),
    ],
)
def test_windows_that_are_none(window, error, words):
    with pytest.raises(error, match=words):
        tisfm.interpret_sequence(FRAMES, window=window)


@pytest.mark.parametrize("motion", ["camera", "objects"])
def test_rigid_motions_take_pairs(motion):
    settings = tisfm.Settings(motion=motion)
    with pytest.raises(ValueError, match=f'window is 3, but motion="{motion}" takes pairs'):
        tisfm.interpret_sequence(FRAMES, settings=settings, window=3)
    assert tisfm.interpret_sequence(FRAMES, settings=settings, window=2)
