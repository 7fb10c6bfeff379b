"""A short run of random small frames: `python -m tests.fuzz.frames` runs longer ones."""

import dataclasses
import sys
import warnings

import numpy as np
import pytest

import tisfm
from tests.fuzz import frame_cases, frames, promises, small_frames
from tests.fuzz.frame_cases import PRESETS, SCENES, WAYS, drawn, outcome
from tests.pairwise import pairwise

FAST = tisfm.Settings.preset("fast", motion="camera")


@pairwise(
    short=True,
    way=list(WAYS),
    kind=[*small_frames.KINDS, *SCENES],
    preset=list(PRESETS),
    shape=["smallest", "usual", "long", "square"],
)
def test_results_keep_their_promises(way, kind, preset, shape):
    number = sum(len(part) for part in (*way, kind, preset, shape))
    case = drawn(7, number, way=way, kind=kind, preset=preset, shape=shape)
    assert outcome(case) in ("result", "refused"), case


# A case follows from its number.


def test_a_number_determines_a_case():
    assert drawn(3, 5) == drawn(3, 5) != drawn(3, 6)
    one, other = (frame_cases.frames_of(drawn(3, 5)) for _ in range(2))
    for frame, again in zip(one, other, strict=True):
        np.testing.assert_array_equal(frame, again)


@pytest.mark.parametrize("kind", small_frames.KINDS)
@pytest.mark.parametrize("way", small_frames.FOLLOWING)
def test_frames_are_grey_levels(kind, way):
    rng = np.random.default_rng(2)
    for shape in ((4, 4), (5, 40), (33, 21)):
        for frame in small_frames.frames(rng, shape, kind, [way, way]):
            assert frame.shape == shape and frame.dtype == np.float32
            assert frame.min() >= 0 and frame.max() <= 255


# What is wrong is seen.


def raising(case, images, folder):
    raise ZeroDivisionError("in this case")


def warning(case, images, folder):
    warnings.warn("divide by zero", RuntimeWarning, stacklevel=2)


def modifying(case, images, folder):
    images[0][...] = 1


def refusing(case, images, folder):
    raise ValueError("frames 1 and 2: distortion leaves data at 1% of the pixels")


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (raising, "wrong: ZeroDivisionError at test_frames.py"),
        (warning, "wrong: RuntimeWarning"),
        (modifying, "wrong: AssertionError"),
        (refusing, "refused"),
        (lambda case, images, folder: None, "result"),
    ],
)
def test_broken_promises_of_a_case_are_found(call, word, monkeypatch):
    monkeypatch.setitem(frame_cases._CALLS, "interpret", call)
    case = drawn(1, 2, way=("interpret", "camera"), kind="texture")
    assert outcome(case).startswith(word)


@pytest.fixture(scope="module")
def pair():
    """The interpretation of two frames, with depth."""
    rng = np.random.default_rng(4)
    frame = small_frames.texture(rng, 40, 60)
    found = np.stack([np.roll(frame, k, 1)[:, 4:-4] for k in (0, 1)])
    pose = np.eye(4)
    pose[0, 3] = 1
    camera = tisfm.Camera(60.0)
    return tisfm.interpret(*found, camera=camera, settings=FAST, pose=pose), pose


def checked(result, pose):
    promises.check_interpretation(result, (40, 52), FAST, pose=pose)


def with_pixel(result, name, value):
    array = getattr(result, name).copy()
    array[..., 9, 9] = value
    return {name: array}


BROKEN = {
    "confidence is not": lambda r: with_pixel(r, "confidence", 1.5),
    "flow is not finite": lambda r: {"flow": np.full_like(r.flow, np.nan)},
    "has confidence": lambda r: {"occlusion": np.ones_like(r.occlusion)},
    "is not above 0": lambda r: with_pixel(r, "inverse_depth_std", 0),
    "a label has no motion": lambda r: with_pixel(r, "labels", 1),
    "there is depth": lambda r: {"status": tisfm.interpretation.Status("unrelated", "so")},
    "says nothing": lambda r: {"status": tisfm.interpretation.Status("uncertain")},
    "the status is": lambda r: {"status": tisfm.interpretation.Status("good", "so")},
    "motions are not finite": lambda r: {"motions": np.full_like(r.motions, np.nan)},
    "T‖ is": lambda r: {"motions": 2 * r.motions},
    "rho is float64": lambda r: {"rho": r.rho.astype(float)},
    "frame is": lambda r: {"frame": r.frame[1:]},
}


@pytest.mark.parametrize("word", BROKEN)
def test_a_broken_promise_is_seen(word, pair):
    result, pose = pair
    checked(result, pose)
    assert (result.inverse_depth > 0).any()
    with pytest.raises(AssertionError, match=word):
        checked(dataclasses.replace(result, **BROKEN[word](result)), pose)


HANGING = """
import sys
import time
from tests.fuzz import frame_cases, frames

frame_cases.outcome = lambda case: time.sleep(1000)
sys.exit(frames.main(sys.argv[1:]))
"""


@pytest.mark.nightly
def test_a_slow_case_is_ended_and_reported(capfd, monkeypatch):
    """The first case has twice the limit: no second one begins within the seconds of the run."""
    monkeypatch.setattr(frames, "PROGRAM", (sys.executable, "-c", HANGING))
    assert frames.main(["--seconds", "2", "--limit", "1"]) == 1
    said = capfd.readouterr().out
    assert "case 0:" in said and "ended 1" in said and "Timeout" in said
    assert "1 cases, 1 wrong" in said


def test_slow_cases_are_listed(capsys):
    times = {"interpret": [(0.1, k) for k in range(9)] + [(3.0, 9)]}
    assert frames.report({("interpret", "result"): 10}, times, [], 10) == 0
    said = capsys.readouterr().out
    assert "slow: case 9: interpret: 3.0 s, the median of such is 0.10 s" in said
    assert "10 cases, 0 wrong, 1 slow" in said
