"""`tisfm.interpret_sequence` with several processes."""

import warnings

import numpy as np
import pytest

import tisfm
from tests.cli.command_line import make_frames
from tisfm.formats import write_png

COUNT = 7


@pytest.fixture
def film(tmp_path):
    """A folder of frames."""
    for k, frame in enumerate(make_frames(COUNT, seed=5)):
        write_png(tmp_path / f"f{k}.png", frame)
    return tmp_path


def interpret(source, **options):
    settings = tisfm.Settings.preset("fast", motion=options.pop("motion", "field"))
    return list(tisfm.interpret_sequence(source, settings=settings, **options))


@pytest.mark.parametrize("options", [{}, {"start": 1, "step": 2}, {"motion": "camera"}])
def test_two_workers_give_the_results_of_one_process(quick_workers, film, options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the focal length is a guess
        one, two = (interpret(film, workers=workers, **options) for workers in (1, 2))
    frames = range(COUNT)[options.get("start", 0) :: options.get("step", 1)]
    assert len(one) == len(two) == len(frames) - 1
    for first, second in zip(one, two, strict=True):
        assert np.array_equal(first.flow, second.flow)
        assert np.array_equal(first.inverse_depth, second.inverse_depth)
        assert first.camera == second.camera and first.status == second.status


def test_an_error_comes_after_the_results_before_it(quick_workers, film):
    write_png(film / "f4.png", np.zeros((5, 6), np.uint8))
    found, settings = [], tisfm.Settings.preset("fast")
    results = tisfm.interpret_sequence(film, settings=settings, workers=2)
    with pytest.raises(ValueError, match="must have the same size"):
        found.extend(results)
        found += results
    assert len(found) <= 3


def test_a_skipped_frame_is_warned_of(quick_workers, film):
    data = (film / "f4.png").read_bytes()
    (film / "f4.png").write_bytes(data[: len(data) // 2])
    with pytest.warns(UserWarning, match="the frame is skipped"):
        assert len(interpret(film, workers=2, bad_frames="skip")) == COUNT - 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"workers": 0}, "workers is 0"),
        ({"window": 3}, "leave out workers"),
        ({"mask": np.ones((24, 40))}, "mask is not a path"),
    ],
)
def test_options_that_workers_cannot_share(film, options, words):
    with pytest.raises(ValueError, match=words):
        tisfm.interpret_sequence(film, **{"workers": 2, **options})


def test_arrays_are_not_shared():
    with pytest.raises(ValueError, match="which several workers cannot read"):
        tisfm.interpret_sequence(make_frames(3), workers=2)
