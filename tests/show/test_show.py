"""Pictures: known colours, exact shifts, what hides what, and figures that can be drawn."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from tisfm.show import (
    ERROR_RANGE,
    UNCERTAINTY_RANGE,
    anaglyph,
    color_wheel,
    comparison_figure,
    depth_error_figure,
    depth_grey,
    dubois,
    error_figure,
    error_to_color,
    flow_figure,
    flow_radius,
    flow_to_color,
    inverse_depth_limit,
    label_colors,
    label_overlay,
    panel_figure,
    quiver_points,
    rigid_figure,
    save_figure,
    second_view,
    uncertainty_to_color,
    usual_length,
)
from tisfm.show.anaglyph import _MATRICES

PROPERTY = settings(max_examples=60, deadline=None)


def one_vector(u: float, v: float) -> np.ndarray:
    """Make a flow of a single pixel."""
    return np.array([[[u, v]]], np.float32)


# Grey levels


def test_limit_counts_finite_positive_values_only():
    values = np.full((10, 12), np.nan)
    values[0, :4] = [1.0, 2.0, 3.0, 4.0]
    values[1, :5] = [0.0, -7.0, np.inf, -np.inf, np.nan]
    assert inverse_depth_limit(values, 100) == 4.0
    assert inverse_depth_limit(values, 0) == 1.0
    assert inverse_depth_limit(values, 50) == 2.5
    assert inverse_depth_limit(-np.ones((2, 3))) == 0.0
    with pytest.raises(ValueError, match="percentile is 101"):
        inverse_depth_limit(values, 101)


def test_grey_is_linear_in_inverse_depth():
    values = np.array([[0.0, 1.0, 2.0, 4.0, 5.0], [-1.0, np.nan, np.inf, -np.inf, 1e300]])
    assert depth_grey(values, limit=4.0).tolist() == [[0, 64, 128, 255, 255], [0, 0, 0, 0, 255]]


def test_grey_of_a_sequence_shares_one_range():
    first = np.linspace(0.1, 1, 60).reshape(6, 10)
    second = first.copy()
    second[0, 0] = 30.0
    second[-2:] = 9.0  # something near comes into view
    shared = inverse_depth_limit(first)
    unchanged = first == second
    assert np.array_equal(
        depth_grey(first, limit=shared)[unchanged], depth_grey(second, limit=shared)[unchanged]
    )
    assert not np.array_equal(depth_grey(first)[unchanged], depth_grey(second)[unchanged])


def test_grey_without_depth_is_black():
    for values in (np.zeros((3, 4)), np.full((3, 4), np.nan), -np.ones((3, 4))):
        assert not depth_grey(values).any()
    assert not depth_grey(np.ones((3, 4)), limit=0.0).any()


@pytest.mark.parametrize("limit", [-1.0, np.nan, np.inf])
def test_limits_are_checked(limit):
    with pytest.raises(ValueError, match="limit is"):
        depth_grey(np.ones((3, 4)), limit=limit)
    with pytest.raises(ValueError, match="limit is"):
        flow_to_color(np.ones((3, 4, 2)), limit=limit)
    with pytest.raises(ValueError, match="limit is"):
        anaglyph(np.ones((3, 4)), np.ones((3, 4)), limit=limit)
    with pytest.raises(ValueError, match="max_disparity is"):
        anaglyph(np.ones((3, 4)), np.ones((3, 4)), max_disparity=limit)


# Flow as colours


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


# The second view


def slow_second_view(image: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Draw every pixel in turn into a depth buffer, then fill each empty place by the nearest.

    A stretched surface (neighbours that land two places apart) also fills the place between.
    """
    height, width = shifts.shape
    result = np.empty_like(image)
    for y in range(height):
        place: dict[int, tuple[int, int]] = {}
        for x in range(width):
            targets = [x - shifts[y, x]]
            if x + 1 < width and x + 1 - shifts[y, x + 1] == targets[0] + 2:
                targets.append(targets[0] + 1)
            for target in targets:
                if 0 <= target < width and place.get(target, (-1, 0))[0] < shifts[y, x]:
                    place[target] = int(shifts[y, x]), x
        for target in range(width):
            if place:
                nearest = min(place, key=lambda other: (abs(other - target), other))
                result[y, target] = image[y, place[nearest][1]]
            else:
                result[y, target] = image[y, width - 1]
    return result


@PROPERTY
@given(
    shifts=hnp.arrays(
        np.int64,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14),
        elements=st.integers(0, 8),
    ),
    colour=st.booleans(),
)
def test_second_view_is_that_of_a_depth_buffer(shifts, colour):
    shape = (*shifts.shape, 3) if colour else shifts.shape
    image = np.arange(math.prod(shape), dtype=np.uint16).reshape(shape)
    inverse_depth = shifts / 4
    expected = slow_second_view(image, shifts)
    assert np.array_equal(second_view(image, inverse_depth, displacement=4.0), expected)
    # The other way round is the mirror image.
    flipped = second_view(image[:, ::-1], inverse_depth[:, ::-1], displacement=-4.0)
    assert np.array_equal(flipped[:, ::-1], expected)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.int32])
def test_second_view_of_a_plane_is_an_exact_shift(dtype):
    image = np.random.default_rng(0).integers(0, 200, (7, 20, 3)).astype(dtype)
    view = second_view(image, np.full((7, 20), 0.5), displacement=6.0)
    assert view.dtype == dtype
    assert np.array_equal(view[:, :-3], image[:, 3:])
    assert (view[:, -3:] == image[:, -1:]).all()
    view = second_view(image, np.full((7, 20), 0.5), displacement=-6.0)
    assert np.array_equal(view[:, 3:], image[:, :-3])


def test_near_covers_far_and_holes_are_filled():
    image = np.arange(1, 13, dtype=np.uint8)[None]
    inverse_depth = np.zeros((1, 12))
    inverse_depth[0, 6:8] = 3.0
    view = second_view(image, inverse_depth, displacement=1.0)
    #       the near pair 7, 8 lands on 4, 5; the hole it leaves takes 6 from the left, 9 from right
    assert view.tolist() == [[1, 2, 3, 7, 8, 6, 6, 9, 9, 10, 11, 12]]


def test_nothing_behind_shines_through_a_stretched_surface():
    # Near, sloping surface on the right, whose shift falls by 1 every third pixel; far on the left.
    near = 6 - np.arange(12) // 3
    shifts = np.concatenate([np.zeros(8), near])[None]
    image = np.concatenate([np.full(8, 9), np.full(12, 200)])[None].astype(np.uint8)
    view = second_view(image, shifts, displacement=1.0)
    assert (view[0, 2:] == 200).all()


def test_second_view_ignores_what_is_no_depth():
    image = np.random.default_rng(1).integers(0, 255, (3, 5), np.uint8)
    for value in (np.nan, np.inf, -np.inf, -3.0, 0.0):
        view = second_view(image, np.full((3, 5), value), displacement=2.0)
        assert np.array_equal(view, image)
    far_out = second_view(image, np.full((3, 5), 1e300), displacement=1e300)
    assert (far_out == image[:, -1:]).all()


@PROPERTY
@given(
    inverse_depth=hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12),
        elements=st.floats(width=32, allow_subnormal=False),
    ),
    displacement=st.floats(-50, 50),
)
def test_constant_picture_stays_constant(inverse_depth, displacement):
    image = np.full((*inverse_depth.shape, 3), 77, np.uint8)
    view = second_view(image, inverse_depth, displacement=displacement)
    assert view.shape == image.shape
    assert (view == 77).all()


def test_second_view_does_not_change_its_input():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    inverse_depth = rng.random((1080, 1920), dtype=np.float32)
    before = image.copy(), inverse_depth.copy()
    second_view(image, inverse_depth, displacement=50.0)
    assert np.array_equal(image, before[0])
    assert np.array_equal(inverse_depth, before[1])


def test_second_view_names_what_is_wrong():
    with pytest.raises(ValueError, match=r"inverse_depth is \(3, 5\) but image is \(3, 4\)"):
        second_view(np.zeros((3, 4)), np.zeros((3, 5)), displacement=1.0)
    with pytest.raises(ValueError, match=r"image is \(3, 4, 2\), expected"):
        second_view(np.zeros((3, 4, 2)), np.zeros((3, 4)), displacement=1.0)
    with pytest.raises(ValueError, match="displacement is nan"):
        second_view(np.zeros((3, 4)), np.zeros((3, 4)), displacement=np.nan)
    with pytest.raises(TypeError, match="inverse_depth has dtype complex128"):
        second_view(np.zeros((3, 4)), np.zeros((3, 4), complex), displacement=1.0)


# Anaglyphs


@pytest.mark.parametrize("name", ["2009", "crt"])
def test_rows_of_the_matrices_sum_to_one(name):
    left, right = (np.array(matrix) for matrix in _MATRICES[name])
    assert np.abs((left + right).sum(axis=1) - 1).max() <= 0.0011


@pytest.mark.parametrize("linear", [True, False])
@pytest.mark.parametrize("name", ["2009", "crt"])
def test_grey_stays_grey(name, linear):
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    result = dubois(grey, grey, matrices=name, linear=linear).astype(int)
    # A row that sums to 0.999 takes a quarter of a level away, and rounding half of one.
    assert np.abs(result - grey[..., None]).max() <= 1


def test_eyes_see_their_own_view():
    black, white = np.zeros((4, 5), np.uint8), np.full((4, 5), 255, np.uint8)
    assert dubois(white, black)[0, 0].tolist() == [255, 0, 0]
    only_right = dubois(black, white)[0, 0]
    assert only_right[0] == 0 and only_right[1:].min() == 255


def test_options_of_dubois_change_the_result():
    left, right = np.random.default_rng(0).integers(0, 256, (2, 6, 7, 3), dtype=np.uint8)
    results = [
        dubois(left, right, matrices=name, linear=linear)
        for name in ("2009", "crt")
        for linear in (True, False)
    ]
    for i, result in enumerate(results):
        assert all(not np.array_equal(result, other) for other in results[:i])
    coded = np.clip(
        left / 255 @ np.array(_MATRICES["2009"][0]).T
        + right / 255 @ np.array(_MATRICES["2009"][1]).T,
        0,
        1,
    )
    assert np.abs(results[1] - coded * 255).max() <= 0.51
    with pytest.raises(ValueError, match="matrices is 'best', expected one of"):
        dubois(left, right, matrices="best")


def test_pictures_of_any_depth_give_the_same_anaglyph():
    levels = np.random.default_rng(0).integers(0, 256, (2, 6, 7, 3), dtype=np.uint8)
    expected = dubois(*levels)
    assert np.array_equal(dubois(*(levels.astype(np.uint16) * 257)), expected)
    assert np.array_equal(dubois(*(levels / 255)), expected)
    assert np.array_equal(dubois(*levels.astype(np.float32)), expected)


def test_anaglyph_shifts_the_limit_by_the_disparity():
    image = np.random.default_rng(0).integers(0, 256, (8, 100, 3), dtype=np.uint8)
    plane = np.full((8, 100), 0.2)
    expected = dubois(image, second_view(image, plane, displacement=3 / 0.2))
    assert np.array_equal(anaglyph(image, plane), expected)
    expected = dubois(image, second_view(image, plane, displacement=5 / 0.2), linear=False)
    assert np.array_equal(anaglyph(image, plane, max_disparity=5, linear=False), expected)
    # With one limit for a sequence, a plane at half of it shifts half as far; and none goes beyond.
    half = dubois(image, second_view(image, plane, displacement=10))
    assert np.array_equal(anaglyph(image, plane, max_disparity=4, limit=0.4), half)
    whole = anaglyph(image, plane, max_disparity=4)
    assert np.array_equal(anaglyph(image, plane, max_disparity=4, limit=0.1), whole)


def test_anaglyph_without_depth_is_flat():
    image = np.random.default_rng(0).integers(0, 256, (8, 30), dtype=np.uint8)
    for value in (0.0, np.nan, -1.0):
        assert np.array_equal(anaglyph(image, np.full((8, 30), value)), dubois(image, image))


# Figures


def scene(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make a frame, inverse depth and flow of two planes, seen from a camera that moves forward."""
    rng = np.random.default_rng(height * width)
    y, x = np.mgrid[:height, :width] - np.array([height - 1, width - 1]).reshape(2, 1, 1) / 2
    inverse_depth = np.where((abs(x) < width / 4) & (abs(y) < height / 4), 1.0, 0.3)
    flow = np.stack([x, y], axis=2) * (inverse_depth / max(width, height))[..., None]
    frame = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return frame, inverse_depth, flow


@pytest.mark.parametrize("size", [(16, 16), (1, 1), (1, 7), (37, 91), (300, 40), (12, 700)])
@pytest.mark.parametrize("extras", [(), ("baseline",), ("baseline", "truth", "depth")])
def test_comparison_is_drawn_at_any_size(tmp_path, size, extras):
    frame, inverse_depth, flow = scene(*size)
    figure = comparison_figure(
        frame,
        inverse_depth,
        flow,
        baseline_flow=0.7 * flow if "baseline" in extras else None,
        truth_flow=1.1 * flow if "truth" in extras else None,
        truth_inverse_depth=2 * inverse_depth if "depth" in extras else None,
        title="A heading",
    )
    save_figure(tmp_path / "figure.png", figure, dpi=40)
    with Image.open(tmp_path / "figure.png") as picture:
        picture.load()
        shown = np.asarray(picture.convert("RGB"))
    assert np.allclose(picture.size, figure.get_size_inches() * 40, atol=1)
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 20


def drawn_parts(figure):
    """Return panels (axes with a picture), and the arrows of those that have some."""
    from matplotlib.quiver import Quiver

    panels = [axes for axes in figure.axes if axes.get_images()]
    arrows = [
        artist for axes in panels for artist in axes.collections if isinstance(artist, Quiver)
    ]
    return panels, arrows


def overlapping(boxes):
    """Return the pairs of boxes that overlap by more than a hair."""
    return [
        (i, j)
        for i, a in enumerate(boxes)
        for j, b in enumerate(boxes[:i])
        if min(a.x1, b.x1) - max(a.x0, b.x0) > 0.01 and min(a.y1, b.y1) - max(a.y0, b.y0) > 0.01
    ]


@pytest.mark.parametrize("size", [(48, 64), (64, 36), (400, 30), (20, 700)])
def test_titles_and_panels_do_not_overlap(size):
    frame, inverse_depth, flow = scene(*size)
    for extras in (
        {},
        {"baseline_flow": flow},
        {"baseline_flow": flow, "truth_flow": flow},
        {"baseline_flow": flow, "truth_flow": flow, "truth_inverse_depth": inverse_depth},
    ):
        figure = comparison_figure(
            frame, inverse_depth, flow, title="A heading of some length " * 3, **extras
        )
        renderer = figure.canvas.get_renderer()
        boxes = [axes.get_window_extent(renderer) for axes in figure.axes]
        boxes += [text.get_window_extent(renderer) for text in figure.texts if text.get_text()]
        assert overlapping(boxes) == []
        whole = figure.bbox
        for box in boxes:
            assert box.x0 >= whole.x0 and box.x1 <= whole.x1
            assert box.y0 >= whole.y0 and box.y1 <= whole.y1


def test_all_flows_share_one_scale_and_range():
    frame, inverse_depth, flow = scene(60, 80)
    figure = comparison_figure(
        frame, inverse_depth, flow, baseline_flow=0.5 * flow, truth_flow=flow
    )
    panels, arrows = drawn_parts(figure)
    recovered, baseline, truth, _ = (np.hypot(drawn.U, drawn.V) for drawn in arrows)
    assert np.allclose(baseline, 0.5 * recovered)
    assert np.array_equal(truth, recovered)
    assert len({drawn.scale for drawn in arrows}) == 1
    pictures = [axes.get_images()[0].get_array() for axes in panels]
    colors = pictures[5:8]
    assert np.array_equal(colors[0], colors[2])
    assert colors[1].astype(int).sum() > colors[0].astype(int).sum()  # shorter is nearer to white


def test_one_limit_gives_a_sequence_one_range():
    frame, inverse_depth, flow = scene(60, 80)
    limits = {"depth_limit": 1.0, "flow_limit": 0.5}

    def depth_and_arrows(factor):
        figure = comparison_figure(frame, factor * inverse_depth, factor * flow, **limits)
        panels, arrows = drawn_parts(figure)
        return panels[1].get_images()[0].get_array().astype(int), np.hypot(arrows[0].U, arrows[0].V)

    (whole_grey, whole_length), (half_grey, half_length) = (
        depth_and_arrows(factor) for factor in (1.0, 0.5)
    )
    assert np.abs(half_grey - whole_grey / 2).max() <= 1
    assert np.allclose(half_length, whole_length / 2)


def test_wild_arrows_are_cut():
    frame, inverse_depth, flow = scene(60, 80)
    flow[:] = 0.3, -0.4

    def longest(factor):
        figure = comparison_figure(frame, inverse_depth, factor * flow, flow_limit=0.5)
        (arrows,) = drawn_parts(figure)[1][:1]
        return np.hypot(arrows.U, arrows.V).max()

    assert np.isclose(longest(2), 2 * longest(1))
    assert np.isclose(longest(1e6), 3 * longest(1))


def test_figures_of_nothing_are_drawn(tmp_path):
    frame, inverse_depth, flow = scene(20, 30)
    for values in (np.zeros_like(flow), np.full_like(flow, np.nan)):
        figure = comparison_figure(frame[..., 0] / 255, 0 * inverse_depth, values)
        save_figure(tmp_path / "figure.png", figure, dpi=40)


def test_occlusion_is_red_on_the_frame():
    frame, inverse_depth, flow = scene(60, 80)
    hidden = np.zeros((60, 80), bool)
    hidden[10:30, 50:70] = True

    def first(picture, **options):
        figure = comparison_figure(picture, inverse_depth, flow, **options)
        titles = [text.get_text() for text in figure.texts]
        return drawn_parts(figure)[0][0].get_images()[0].get_array().astype(int), titles

    for picture in (frame, frame[..., 0]):
        plain, titles = first(picture)
        assert "Frame" in titles
        tinted, titles = first(picture, occlusion=hidden)
        assert "Frame (red: not visible in the next)" in titles
        if plain.ndim == 2:
            plain = np.dstack([plain] * 3)
        np.testing.assert_array_equal(tinted[~hidden], plain[~hidden])
        assert (tinted[hidden][:, 0] > tinted[hidden][:, 1] + 40).all()
    with pytest.raises(ValueError, match=r"occlusion is \(60, 79\) but frame is \(60, 80\)"):
        comparison_figure(frame, inverse_depth, flow, occlusion=hidden[:, 1:])


def test_names_replace_titles():
    frame, inverse_depth, flow = scene(20, 30)
    figure = comparison_figure(frame, inverse_depth, flow, names={"frame": "Costs $5 or $6"})
    assert "Costs $5 or $6" in [text.get_text() for text in figure.texts]
    with pytest.raises(ValueError, match="names has fraem, expected any of frame, occlusion"):
        comparison_figure(frame, inverse_depth, flow, names={"fraem": "x"})


def test_comparison_names_the_wrong_size():
    frame, inverse_depth, flow = scene(20, 30)
    with pytest.raises(ValueError, match=r"truth_flow is \(20, 29\) but frame is \(20, 30\)"):
        comparison_figure(frame, inverse_depth, flow, truth_flow=flow[:, 1:])
    with pytest.raises(ValueError, match=r"inverse_depth is \(19, 30\) but frame is \(20, 30\)"):
        comparison_figure(frame, inverse_depth[1:], flow)


def test_panels_of_different_sizes(tmp_path):
    frame, inverse_depth, flow = scene(40, 60)
    panels = [("a", frame), ("b", depth_grey(inverse_depth)[:, :20]), ("", flow_to_color(flow))]
    assert len(panel_figure(panels).axes) == 3
    lefts = {
        columns: len({round(axes.get_position().x0, 3) for axes in figure.axes})
        for columns, figure in (
            (columns, panel_figure(panels * 2, columns=columns)) for columns in (1, 2, 3)
        )
    }
    assert lefts[1] == 2  # one column, the narrow panels in its middle
    assert lefts[3] == 3
    save_figure(tmp_path / "figure.png", panel_figure(panels * 3, title="Nine"), dpi=40)
    with pytest.raises(ValueError, match="panels is empty"):
        panel_figure([])
    with pytest.raises(ValueError, match="columns is 0"):
        panel_figure(panels, columns=0)
    with pytest.raises(ValueError, match=r"panel 'x' is \(3,\)"):
        panel_figure([("x", np.zeros(3))])


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg", ".jpg", ".TIFF"])
def test_figures_are_saved_whole_or_not_at_all(tmp_path, suffix):
    figure = panel_figure([("a", np.zeros((4, 5), np.uint8))])
    save_figure(tmp_path / f"figure{suffix}", figure, dpi=40)
    assert [path.name for path in tmp_path.iterdir()] == [f"figure{suffix}"]
    with pytest.raises(FileNotFoundError, match="create it first"):
        save_figure(tmp_path / "missing" / f"figure{suffix}", figure)


def test_save_figure_checks_its_arguments(tmp_path):
    figure = panel_figure([("a", np.zeros((4, 5), np.uint8))])
    with pytest.raises(ValueError, match=r"suffix '\.xyz', expected one of"):
        save_figure(tmp_path / "figure.xyz", figure)
    with pytest.raises(ValueError, match="dpi is 0"):
        save_figure(tmp_path / "figure.png", figure, dpi=0)
    assert list(tmp_path.iterdir()) == []


def test_matplotlib_is_imported_only_for_figures_and_never_pyplot():
    script = (
        "import sys, numpy as np, tisfm.show as show\n"
        "assert 'matplotlib' not in sys.modules\n"
        "show.panel_figure([('a', np.zeros((4, 5), np.uint8))])\n"
        "assert 'matplotlib.figure' in sys.modules\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


# Flow errors


def test_error_colors_brighten_with_every_doubling():
    error = np.array([[0.0, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16, 1e9, np.inf]])
    color = error_to_color(error)[0].astype(int)
    luma = color @ [0.299, 0.587, 0.114]
    assert luma[0] == luma[1] < 3 and luma[-1] == luma[-2] == luma[-3] > 230
    steps = np.diff(luma[1:-2])
    assert (steps > 0).all() and steps.max() < 3 * steps.min()
    assert (error_to_color(error, limits=(1, 2))[0, 6] == color[-1]).all()


def test_unknown_errors_are_grey():
    error = np.array([[np.nan, 0.0, 1.0]], np.float32)
    assert error_to_color(error)[0, 0].tolist() == [128, 128, 128]
    every = error_to_color(np.geomspace(*ERROR_RANGE, 4000)[None])[0].astype(int)
    assert np.ptp(every, axis=1)[(every > 100).all(axis=1)].min() > 20  # nothing else is grey


@pytest.mark.parametrize("limits", [(0, 1), (1, 1), (2, 1), (np.nan, 1), (1, np.inf), (-1, 1)])
def test_error_limits_are_checked(limits):
    for draw in (error_to_color, error_figure):
        with pytest.raises(ValueError, match=r"limits is \(.*0 < low < high"):
            draw(np.ones((3, 4)), limits=limits)


def test_usual_length_leaves_out_the_longest():
    flow = np.zeros((10, 10, 2))
    flow[..., 0] = np.arange(100).reshape(10, 10)
    flow[0, 0] = 1e10, 0
    flow[0, 1] = np.nan
    assert usual_length(flow) == pytest.approx(np.percentile(np.arange(2, 100), 98))
    assert usual_length(np.full((3, 4, 2), np.nan)) == 0


@pytest.mark.parametrize("shape", [(60, 80), (20, 90), (90, 20), (1, 1)])
def test_figures_of_an_evaluation(tmp_path, shape):
    """Nothing is drawn beyond the edges: they are white."""
    rng = np.random.default_rng(0)
    flow, truth = rng.normal(size=(2, *shape, 2))
    truth[0, 0] = np.nan
    error = np.hypot(*np.moveaxis(flow - truth, -1, 0))
    depth, true_depth = np.exp(rng.normal(size=(2, *shape)))
    for figure in (
        error_figure(error, title="A name"),
        flow_figure(flow, truth, title="A name"),
        depth_error_figure(depth, true_depth, title="A name"),
    ):
        save_figure(tmp_path / "a.png", figure)
        image = np.asarray(Image.open(tmp_path / "a.png").convert("RGB"))
        for edge in (image[:3], image[-3:], image[:, :3], image[:, -3:]):
            assert (edge == 255).all()
        assert (image < 255).any()


def test_figures_of_an_evaluation_share_a_range(tmp_path):
    truth = np.zeros((40, 60, 2))
    truth[..., 0] = 3.0
    with pytest.raises(ValueError, match=r"truth is \(40, 60\) but flow is \(40, 59\)"):
        flow_figure(truth[:, 1:], truth)
    with pytest.raises(ValueError, match="limit is -1"):
        flow_figure(truth, truth, limit=-1.0)
    flow_figure(truth, np.full_like(truth, np.nan))  # nothing known: no range


def panels_of(figure):
    """Return the pictures of a figure, the bar of colours last."""
    return [np.asarray(axes.images[0].get_array()) for axes in figure.axes]


def test_depths_of_an_evaluation_share_a_scale():
    truth = np.linspace(1, 5, 40 * 60).reshape(40, 60)
    truth[:5] = np.nan
    depth = 7 * truth
    depth[10:20, 10:20] *= 1.5
    depth[30] = np.nan
    recovered, true, error = panels_of(depth_error_figure(depth, truth))[:3]
    alike = np.ones((40, 60), bool)
    alike[10:20, 10:20] = alike[30] = alike[:5] = False
    np.testing.assert_array_equal(recovered[alike], true[alike])
    assert (recovered[10:20, 10:20] < true[10:20, 10:20]).all()
    assert (true[:5] == 0).all() and (recovered[30] == 0).all()
    unknown = (error == 128).all(axis=2)
    assert unknown[:5].all() and unknown[30].all() and not unknown[alike].any()
    assert (error[alike] == error_to_color([[0.0]])[0, 0]).all()
    expected = error_to_color([[0.5]], limits=(1 / 64, 1.0))[0, 0]
    assert (np.abs(error[10:20, 10:20].astype(int) - expected) <= 6).all()  # a level of the map
    wider = panels_of(depth_error_figure(depth, truth, limits=(0.5, 2)))[2]
    assert (wider[10:20, 10:20] == error_to_color([[0.0]])[0, 0]).all()


def test_depths_of_an_evaluation_say_what_came():
    with pytest.raises(ValueError, match=r"truth is \(40, 60\) but depth is \(40, 59\)"):
        depth_error_figure(np.ones((40, 59)), np.ones((40, 60)))
    with pytest.raises(ValueError, match=r"no pixel of the \(4, 6\) depth"):
        depth_error_figure(np.full((4, 6), np.nan), np.ones((4, 6)))
    with pytest.raises(ValueError, match="0 < low < high"):
        depth_error_figure(np.ones((4, 6)), np.ones((4, 6)), limits=(1, 0.5))


# Rigid motions


def test_uncertainty_has_the_colours_of_errors():
    inverse_depth = np.array([[1.0, 2.0, 4.0, 0.5]])
    deviation = np.array([[0.01, 0.16, 8.0, 0.02]])
    shown = uncertainty_to_color(inverse_depth, deviation)
    expected = error_to_color(deviation / inverse_depth, limits=UNCERTAINTY_RANGE)
    assert np.array_equal(shown, expected)
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) == 4
    wider = uncertainty_to_color(inverse_depth, deviation, limits=(0.001, 10))
    assert not np.array_equal(shown, wider)


def test_uncertainty_without_depth_is_grey():
    nothing = np.array([[0.0, -1.0, np.nan, np.inf, 1.0, 1.0]])
    deviation = np.array([[1.0, 1.0, 1.0, 1.0, np.inf, np.nan]])
    assert np.all(uncertainty_to_color(nothing, deviation) == 128)
    tiny = uncertainty_to_color([[1e-200]], [[1e200]])
    assert np.array_equal(tiny, uncertainty_to_color([[1.0]], [[1e9]]))


def test_uncertainty_says_what_came():
    with pytest.raises(ValueError, match=r"inverse_depth_std is \(2, 4\) but inverse_depth is"):
        uncertainty_to_color(np.ones((2, 3)), np.ones((2, 4)))
    with pytest.raises(ValueError, match="limits is"):
        uncertainty_to_color(np.ones((2, 3)), np.ones((2, 3)), limits=(1, 0.1))


def test_colours_of_labels_are_far_from_each_other():
    colors = label_colors(12).astype(int)
    assert np.array_equal(colors[:5], label_colors(5))  # no matter how many
    assert len(set(colors[0])) == 1  # the background is grey
    apart = np.abs(colors[:, None] - colors[None]).sum(-1) + 1000 * np.eye(12, dtype=int)
    assert apart.min() > 60
    with pytest.raises(ValueError, match="count is 0"):
        label_colors(0)


@pytest.mark.parametrize("colour", [False, True])
def test_labels_tint_all_but_the_background(colour):
    frame = scene(60, 80)[0]
    picture = frame if colour else frame[..., 0]
    labels = np.zeros((60, 80), np.int32)
    labels[10:30, 20:50] = 1
    labels[35:50, 60:75] = 2
    before = picture.copy()
    shown = label_overlay(picture, labels)
    assert shown.shape == (60, 80, 3) and shown.dtype == np.uint8
    assert np.array_equal(picture, before)
    background = shown[:8, :18]
    assert np.array_equal(background, np.repeat(background[..., :1], 3, axis=2))
    if not colour:
        assert np.array_equal(background[..., 0], picture[:8, :18])
    colors = label_colors(3).astype(int)
    for k, inside in ((1, shown[13:27, 24:46]), (2, shown[38:47, 64:71])):
        grey = np.array([255, 255, 255])
        mean = inside.reshape(-1, 3).mean(0)
        nearest = np.argmin(np.abs(colors - mean).sum(1))
        assert nearest == k and np.abs(mean - grey).max() > 50
    for row, column in ((10, 35), (20, 20), (35, 70)):  # outlines
        assert np.all(shown[row, column] == 255)


def test_outlines_grow_with_the_picture():
    labels = np.zeros((40, 1600), np.int64)
    labels[:, 800:] = 1
    shown = label_overlay(np.zeros((40, 1600), np.uint8), labels)
    assert 2 <= np.count_nonzero((shown[20] == 255).all(-1)) <= 6


def test_labels_say_what_came():
    frame = np.zeros((4, 5), np.uint8)
    with pytest.raises(TypeError, match="labels has dtype float64, expected integers"):
        label_overlay(frame, np.zeros((4, 5)))
    with pytest.raises(ValueError, match=r"labels is \(4, 6\) but image is \(4, 5\)"):
        label_overlay(frame, np.zeros((4, 6), int))
    with pytest.raises(ValueError, match=r"labels is \(4, 5, 1\), expected \(H, W\)"):
        label_overlay(frame, np.zeros((4, 5, 1), int))
    with pytest.raises(ValueError, match="labels has -1, expected integers from 0"):
        label_overlay(frame, np.full((4, 5), -1))


def rigid_parts(height, width, count=1):
    """Return what `rigid_figure` takes, with so many labels."""
    frame, inverse_depth, flow = scene(height, width)
    labels = (np.arange(width) * count // width + np.zeros((height, 1))).astype(np.int32)
    options = {
        "inverse_depth_std": 0.1 * inverse_depth,
        "confidence": np.clip(inverse_depth, 0, 1),
        "labels": labels,
    }
    return (frame, inverse_depth, flow), options


@pytest.mark.parametrize("size", [(48, 64), (64, 36), (400, 30), (20, 700), (1, 1)])
@pytest.mark.parametrize("count", [1, 2, 20])
@pytest.mark.parametrize("truth", [False, True])
def test_parts_of_a_rigid_figure_do_not_overlap(tmp_path, size, count, truth):
    arrays, options = rigid_parts(*size, count=count)
    if truth:
        options |= {"truth_flow": arrays[2], "truth_inverse_depth": arrays[1]}
    figure = rigid_figure(*arrays, title="A heading of some length " * 3, **options)
    renderer = figure.canvas.get_renderer()
    boxes = [axes.get_window_extent(renderer) for axes in figure.axes]
    boxes += [text.get_window_extent(renderer) for text in figure.texts if text.get_text()]
    assert overlapping(boxes) == []
    for box in boxes:
        assert box.x0 >= figure.bbox.x0 and box.x1 <= figure.bbox.x1
        assert box.y0 >= figure.bbox.y0 and box.y1 <= figure.bbox.y1
    inside = [
        (axes.get_window_extent(renderer), text.get_window_extent(renderer))
        for axes in figure.axes
        for text in axes.texts
    ]
    for box, text in inside:
        assert text.x1 <= figure.bbox.x1 and text.y0 >= box.y0 - 5 and text.y1 <= box.y1 + 5
    assert overlapping([text for _, text in inside]) == []
    panels = 6 + 2 * truth + (int(options["labels"].max()) > 0)
    titles = [text.get_text() for text in figure.texts][:-1]
    assert len(titles) == panels
    save_figure(tmp_path / "figure.png", figure, dpi=40)


def rigid_panels(*arrays, **options):
    """Return the pictures of the panels by the first word of their titles."""
    figure = rigid_figure(*arrays, **options)
    panels, _ = drawn_parts(figure)
    titles = [text.get_text() for text in figure.texts]
    return {
        title: np.asarray(panel.get_images()[0].get_array())
        for title, panel in zip(titles, panels, strict=False)
        if title
    }


def test_panels_of_a_rigid_figure():
    arrays, options = rigid_parts(60, 80)
    hidden = np.zeros((60, 80), bool)
    hidden[:20] = True
    limits = {"depth_limit": 2.0, "flow_limit": 0.4}
    shown = rigid_panels(*arrays, occlusion=hidden, **limits, **options)
    assert list(shown) == [
        "Frame (red: not visible in the next)",
        "Depth (near is bright)",
        "Uncertainty of the depth (grey: unknown)",
        "Flow, arrows",
        "Flow, colours",
        "Confidence (white: 1)",
    ]
    frame, depth, uncertainty, _, flow, confidence = shown.values()
    assert (frame[:20, :, 0].mean() > frame[:20, :, 1].mean() + 50).all()
    assert np.array_equal(depth, depth_grey(arrays[1], limit=2.0))
    assert np.all(uncertainty[:20] == 128)
    expected = uncertainty_to_color(arrays[1], options["inverse_depth_std"])
    assert np.array_equal(uncertainty[20:], expected[20:])
    assert np.array_equal(flow, flow_to_color(arrays[2], limit=0.4))
    assert np.array_equal(confidence, depth_grey(options["confidence"], limit=1.0))


def test_a_rigid_figure_without_depth_says_so():
    (frame, inverse_depth, flow), options = rigid_parts(20, 30)
    options["inverse_depth_std"] = np.full_like(inverse_depth, np.inf)
    shown = rigid_panels(frame, 0 * inverse_depth, 0 * flow, **options)
    assert not shown["Depth: none to be seen"].any()
    assert np.all(shown["Uncertainty of the depth (grey: unknown)"] == 128)


def test_a_rigid_figure_names_the_wrong_size():
    (frame, inverse_depth, flow), options = rigid_parts(20, 30)
    options["confidence"] = np.ones((20, 31))
    with pytest.raises(ValueError, match=r"confidence is \(20, 31\) but frame is \(20, 30\)"):
        rigid_figure(frame, inverse_depth, flow, **options)
