"""One visual language: maps that are even and rise, categories that are told apart by all."""

import numpy as np
import pytest

from tests.show.vision import VISIONS, distances, seen
from tisfm.show import (
    UNKNOWN_COLOR,
    color_ramp,
    confidence_to_color,
    depth_to_color,
    error_to_color,
    label_colors,
    uncertainty_to_color,
)
from tisfm.show.palette import CONTRAST_COLOR, RESULT_COLOR, TEXT_COLOR

QUANTITIES = ("depth", "confidence", "error")


def test_grey_is_kept_for_colour_blind_eyes():
    """The matrices are those of the paper, or it would not."""
    greys = np.repeat(np.arange(0, 256, 51)[:, None], 3, axis=1)
    for vision in VISIONS:
        assert np.abs(seen(greys, vision) - seen(greys, "usual")).max() < 0.5
    red_green = np.array([[213, 94, 0], [0, 158, 115]])
    assert distances(red_green, red_green, "deuteranopia")[0, 1] < 60
    assert distances(red_green, red_green, "usual")[0, 1] > 90


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_maps_rise_evenly(quantity, vision):
    ramp = color_ramp(quantity)
    assert ramp.shape == (256, 3) and ramp.dtype == np.uint8
    lightness = seen(ramp[::5], vision)[:, 0]
    assert (np.diff(lightness) > 0).all() and np.ptp(lightness) > 70
    if vision == "usual":
        apart = np.linalg.norm(np.diff(seen(ramp[::15], vision), axis=0), axis=1)
        assert apart.max() < 3.5 * apart.min()


@pytest.mark.parametrize("vision", VISIONS)
def test_the_colour_of_unknown_pixels_is_unique(vision):
    for quantity in QUANTITIES:
        assert distances([UNKNOWN_COLOR], color_ramp(quantity), vision).min() > 20


@pytest.mark.parametrize("vision", VISIONS)
def test_categories_are_distinguishable(vision):
    colors = label_colors(16)
    apart = distances(colors, colors, vision) + 1000 * np.eye(16)
    assert apart.min() > 15
    lines = [
        [int(c[k : k + 2], 16) for k in (1, 3, 5)]
        for c in (RESULT_COLOR, CONTRAST_COLOR, TEXT_COLOR)
    ]
    assert (distances(lines, lines, vision) + 1000 * np.eye(3)).min() > 40


def test_hues_of_old_would_not_be():
    """That the test above can fail: two saturated hues that look alike without a cone."""
    old = np.array([[255, 90, 25], [140, 160, 25]], np.uint8)
    assert distances(old, old, "usual")[0, 1] > 60
    assert min(distances(old, old, v)[0, 1] for v in VISIONS) < 25


def test_colours_of_labels_repeat_after_the_last():
    colors = label_colors(40)
    assert np.array_equal(colors[16:31], colors[1:16])
    assert len({tuple(c) for c in colors[:16]}) == 16
    assert not (colors[1:] == colors[0]).all(axis=1).any()


def test_quantities_have_names():
    with pytest.raises(ValueError, match="quantity is 'deep', expected one of depth, confidence"):
        color_ramp("deep")


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (5, 7)])
def test_unknown_pixels_have_one_grey(shape):
    nothing = np.full(shape, np.nan)
    for picture in (
        depth_to_color(nothing),
        confidence_to_color(nothing),
        error_to_color(nothing),
        uncertainty_to_color(nothing, nothing),
    ):
        assert picture.shape == (*shape, 3) and picture.dtype == np.uint8
        assert (picture == UNKNOWN_COLOR).all()


def test_depth_has_the_colours_of_its_map():
    ramp = color_ramp("depth")
    values = np.array([[0.0, 1.0, 2.0, 4.0, 9.0, -1.0, np.inf, np.nan, 1e300]])
    shown = depth_to_color(values, limit=4.0)[0]
    expected = [ramp[0], ramp[64], ramp[128], ramp[255], ramp[255], ramp[0]]
    assert np.array_equal(shown[:6], expected)
    assert (shown[6:8] == UNKNOWN_COLOR).all() and (shown[8] == ramp[255]).all()
    assert (depth_to_color(np.zeros((2, 3))) == ramp[0]).all()
    assert np.array_equal(depth_to_color([[1.0, 2, 3]]), depth_to_color([[2.0, 4, 6]]))
    with pytest.raises(ValueError, match="limit is -1"):
        depth_to_color(values, limit=-1)
    with pytest.raises(ValueError, match=r"inverse_depth is \(3,\)"):
        depth_to_color([1, 2, 3])


def test_confidence_has_the_colours_of_its_map():
    ramp = color_ramp("confidence")
    shown = confidence_to_color([[0.0, 0.5, 1.0, 2.0, -1.0]])[0]
    assert np.array_equal(shown, ramp[[0, 128, 255, 255, 0]])
    with pytest.raises(ValueError, match=r"confidence is \(2, 2, 2\)"):
        confidence_to_color(np.ones((2, 2, 2)))
