"""Flow as colours and arrows: known hues, lengths, what is unknown, and regular grids."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tisfm.show import color_wheel, flow_radius, flow_to_color, quiver_points, usual_length

PROPERTY = settings(max_examples=60)


def one_vector(u: float, v: float) -> np.ndarray:
    """Make a flow of a single pixel."""
    return np.array([[[u, v]]], np.float32)


@pytest.mark.parametrize(
    ("hues_from_red", "color"),
    [
        (0, (255, 0, 0)),
        (15, (255, 255, 0)),
        (21, (0, 255, 0)),
        (25, (0, 255, 255)),
        (36, (0, 0, 255)),
        (49, (255, 0, 255)),
        (7.5, (255, 128, 0)),
        (30.5, (0, 128, 255)),
        (52, (255, 0, 128)),
    ],
)
@pytest.mark.parametrize("length", [0.5, 3.0])
def test_hues_of_the_wheel(hues_from_red, color, length):
    # Red is motion to the right, and the 55 hues follow clockwise because v points down.
    angle = 2 * math.pi * hues_from_red / 55
    flow = one_vector(length * math.cos(angle), length * math.sin(angle))
    assert np.abs(flow_to_color(flow)[0, 0].astype(int) - color).max() <= 1


def test_directions():
    flow = np.array([[[1, 0], [0, 1], [-1, 0], [0, -1]]], np.float32)
    right, down, left, up = flow_to_color(flow)[0].astype(int)
    assert right.tolist() == [255, 0, 0]
    assert down[0] > 220 and down[1] > 220 and down[2] == 0  # yellow
    assert left[0] == 0 and left[1] > 180 and left[2] == 255  # between cyan and blue
    assert 60 < up[0] < 130 and up[1] == 0 and up[2] == 255  # violet


def test_hue_does_not_jump_with_the_sign_of_v():
    above, below = flow_to_color(np.array([[[1, -1e-6], [1, 1e-6]]]))[0].astype(int)
    assert np.abs(above - below).max() <= 1


def test_saturation_grows_with_length_and_darkens_beyond_the_limit():
    lengths = np.linspace(0, 2, 41, dtype=np.float32)
    flow = np.stack([lengths * np.float32(0.6), lengths * np.float32(-0.8)], axis=1)[None]
    color = flow_to_color(flow, limit=1.0)[0].astype(int)
    assert color[0].tolist() == [255, 255, 255]
    least = color[:20].min(axis=1)
    assert (np.diff(least) < 0).all()
    assert color[19].min() < 20
    full = flow_to_color(flow, limit=float(lengths[-1]))[0, -1].astype(int)
    assert np.abs(color[22:] - 0.75 * full).max() <= 1


def test_default_limit_is_the_greatest_known_length():
    flow = np.random.default_rng(0).normal(size=(9, 11, 2))
    flow[3, 4] = 3.0, -4.0
    flow[5, 5] = np.nan, 0.0
    flow[5, 6] = 2e9, 0.0
    assert np.array_equal(flow_to_color(flow), flow_to_color(flow, limit=5.0))
    assert not np.array_equal(flow_to_color(flow), flow_to_color(flow, limit=6.0))


def test_unknown_flow_is_black_and_no_motion_white():
    flow = np.zeros((2, 3, 2), np.float32)
    flow[0, 0, 0], flow[0, 1, 1], flow[0, 2, 0] = np.nan, 1e10, -np.inf
    for limit in (None, 0.0, 2.0):
        assert flow_to_color(flow, limit=limit).tolist() == [[[0] * 3] * 3, [[255] * 3] * 3]
    assert np.array_equal(np.isnan(flow_radius(flow)), [[True] * 3, [False] * 3])
    assert not flow_to_color(np.full((2, 3, 2), np.nan)).any()


@pytest.mark.parametrize("size", [1, 2, 15, 64])
def test_wheel_shows_the_flow_towards_each_pixel(size):
    wheel = color_wheel(size)
    assert wheel.shape == (size, size, 3)
    if size >= 15:
        middle = size // 2
        assert wheel[0, 0].tolist() == [255, 255, 255]
        assert wheel[middle, middle].min() > 220
        right, left = wheel[middle, -2].astype(int), wheel[middle, 1].astype(int)
        assert right[0] > 250 and right[1:].max() < 60
        assert left[2] > 250 and left[0] < 60
    with pytest.raises(ValueError, match="size is 0"):
        color_wheel(0)


@PROPERTY
@given(height=st.integers(1, 40), width=st.integers(1, 40), step=st.integers(1, 50), data=st.data())
def test_arrows_are_on_a_regular_grid(height, width, step, data):
    flow = np.random.default_rng(height * width).normal(size=(height, width, 2))
    arrows = quiver_points(flow, step)
    for places, length in ((np.unique(arrows.x), width), (np.unique(arrows.y), height)):
        assert len(places) == max(1, length // step)
        assert (np.diff(places) == step).all()
        # As much room before the first as after the last.
        assert 0 <= (length - 1 - places[-1]) - places[0] <= 1
    assert np.array_equal(np.stack([arrows.u, arrows.v], 1), flow[arrows.y, arrows.x])
    chosen = data.draw(st.integers(0, len(arrows.x) - 1))
    flow[arrows.y[chosen], arrows.x[chosen], 0] = np.nan
    assert len(quiver_points(flow, step).x) == len(arrows.x) - 1


def test_arrows_need_a_step():
    with pytest.raises(ValueError, match="step is 0"):
        quiver_points(np.zeros((3, 4, 2)), 0)


def test_usual_length_leaves_out_the_longest():
    flow = np.zeros((10, 10, 2))
    flow[..., 0] = np.arange(100).reshape(10, 10)
    flow[0, 0] = 1e10, 0
    flow[0, 1] = np.nan
    assert usual_length(flow) == pytest.approx(np.percentile(np.arange(2, 100), 98))
    assert usual_length(np.full((3, 4, 2), np.nan)) == 0
