"""Maps drawn into axes that are given: their pixels, legends, units, and room."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from tests.draws import nightly_except
from tests.show.drawn import scene
from tisfm.show import (
    UNKNOWN_COLOR,
    color_ramp,
    confidence_to_color,
    depth_to_color,
    draw_confidence,
    draw_depth,
    draw_depth_error,
    draw_flow,
    draw_flow_error,
    draw_labels,
    draw_uncertainty,
    error_figure,
    flow_to_color,
    label_overlay,
    save_figure,
    uncertainty_to_color,
)
from tisfm.show.ticks import depth_ticks, doubling_ticks, format_number


def empty(width=6.0, height=4.0, dpi=100):
    figure = Figure(figsize=(width, height), dpi=dpi)
    FigureCanvasAgg(figure)
    return figure


def parts(height=60, width=80):
    frame, inverse_depth, flow = scene(height, width)
    labels = np.zeros((height, width), np.int32)
    labels[: height // 2] = 2
    return {
        "depth": (draw_depth, (inverse_depth,), depth_to_color(inverse_depth)),
        "flow": (
            draw_flow,
            (flow,),
            flow_to_color(flow, limit=np.percentile(np.hypot(*flow.T), 98), beyond="same"),
        ),
        "confidence": (draw_confidence, (inverse_depth,), confidence_to_color(inverse_depth)),
        "uncertainty": (
            draw_uncertainty,
            (inverse_depth, 0.1 * inverse_depth),
            uncertainty_to_color(inverse_depth, 0.1 * inverse_depth),
        ),
        "labels": (draw_labels, (frame, labels), label_overlay(frame, labels)),
        "flow error": (draw_flow_error, (flow, 1.1 * flow), None),
        "depth error": (draw_depth_error, (inverse_depth, inverse_depth**2), None),
    }


NAMES = tuple(parts())


def texts(axes):
    """Return all that is written in the figure of axes, but for what is empty."""
    figure = axes.figure
    figure.canvas.draw()
    return [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]


def words(axes):
    return " | ".join(text.get_text() for text in texts(axes))


def shown(axes):
    return np.asarray(axes.get_images()[0].get_array())


@pytest.mark.parametrize("name", NAMES)
def test_maps_are_drawn_into_given_axes(name):
    draw, arrays, expected = parts()[name]
    figure = empty()
    left, right = figure.subplots(1, 2)
    slot = left.get_position(original=True)
    before = right.get_position().bounds
    assert draw(*arrays, axes=left, title="A $title_") is left
    assert not right.has_data() and right.get_position().bounds == before
    assert left.get_title() == "A $title_"
    if expected is not None:
        assert np.array_equal(shown(left), expected)
    figure.canvas.draw()
    assert set(figure.axes) >= {left, right} and len(figure.axes) > 2  # the legend has its own
    within = slot.transformed(figure.transFigure)
    for axes in set(figure.axes) - {right}:  # picture and legend share the place
        box = axes.get_window_extent()
        assert box.x0 >= within.x0 - 2 and box.x1 <= within.x1 + 2
        assert box.y0 >= within.y0 - 2 and box.y1 <= within.y1 + 2
    assert_has_colors(figure)


def assert_has_colors(figure):
    """Check that a figure that was drawn has more than two colours."""
    levels = np.ascontiguousarray(figure.canvas.buffer_rgba()).view(np.uint32)
    assert len(np.unique(levels)) > 2


def draw_whole(figure):
    figure.canvas.draw()
    assert_has_colors(figure)


SIZES = [
    ((2.0, 1.6), (60, 80)),
    ((2.0, 1.6), (20, 90)),
    ((2.0, 1.6), (90, 20)),
    ((6.0, 4.0), (20, 90)),
    ((38.4, 21.6), (60, 80)),
]


@pytest.mark.parametrize(
    ("name", "size", "shape"),
    [
        pytest.param(
            name, *sizes, marks=[] if (k - number) % 5 in (0, 2) else [pytest.mark.nightly]
        )
        for number, name in enumerate(NAMES)
        for k, sizes in enumerate(SIZES)
    ],
)
def test_legends_are_legible_at_any_size(name, size, shape):
    """From 200 px to 3840: text is 9 px and more, and grows with the picture; nothing overlaps."""
    draw, arrays, _ = parts(*shape)[name]
    figure = empty(*size)
    axes = draw(*arrays, axes=figure.add_axes((0.02, 0.05, 0.96, 0.8)), title="Title")
    found = texts(axes)
    heights = [text.get_fontsize() / 72 * figure.dpi for text in found]
    least = max(9 - 1e-6, 0.015 * min(size) * figure.dpi)
    assert min(heights) >= least and max(heights) < 0.12 * min(size) * figure.dpi
    whole = figure.bbox
    boxes = [text.get_window_extent() for text in found]
    for box in boxes:
        assert box.x0 >= whole.x0 - 2 and box.x1 <= whole.x1 + 2
        assert box.y0 >= whole.y0 - 2 and box.y1 <= whole.y1 + 2
    picture = axes.get_images()[0].get_window_extent()
    assert picture.width * picture.height > 0.12 * min(whole.width, whole.height) ** 2 / 4
    for box in boxes:  # no text lies on the picture
        wide = min(box.x1, picture.x1) - max(box.x0, picture.x0)
        high = min(box.y1, picture.y1) - max(box.y0, picture.y0)
        assert wide <= 2 or high <= 2


def test_legends_have_units():
    _, inverse_depth, flow = scene(60, 80)
    depth = words(draw_depth(inverse_depth, limit=0.5, unit="m"))
    assert "depth Z (m)" in depth and "∞" in depth and "≤ 2" in depth and "| 5 |" in depth
    far = words(draw_depth(inverse_depth, limit=1 / 1234.0))
    assert "≤ 1230" in far and "| 5000 |" in far and "e+" not in far
    assert "rim: ≥ 2.5\npx/frame" in words(draw_flow(flow, limit=2.5))
    assert "rim: ≥ 120\npx/frame" in words(draw_flow(flow, limit=120.4))
    assert "confidence (share)" in words(draw_confidence(inverse_depth))
    deviation = words(draw_uncertainty(inverse_depth, inverse_depth))
    assert "standard deviation of depth (%)" in deviation
    assert "≤ 1 %" in deviation and "≥ 64 %" in deviation and "8 %" in deviation
    other = words(draw_uncertainty(inverse_depth, inverse_depth, limits=(0.05, 0.5)))
    assert "≤ 5 %" in other and "≥ 50 %" in other
    labels = np.array([[0, 2], [5, 5]])
    named = words(draw_labels(np.zeros((2, 2)), labels, names=("wall", "a", "tram")))
    assert "wall" in named and "tram" in named and "5" in named and "| a |" not in named
    many = words(draw_labels(np.zeros((1, 30)), np.arange(30)[None]))
    assert "14 more" in many


def test_scales_of_depth_have_round_numbers():
    """Each tick lies where the inverse of its depth does; all but the nearest are round."""
    for limit in (1 / 119.3, 0.5, 7.0, 1e-9, 3e8, 1.0):
        (far, text), *between, (near, nearest) = depth_ticks(limit)
        assert (far, text, near) == (0, "∞", 1) and nearest == f"≤ {format_number(1 / limit)}"
        assert len(between) >= 3
        shares = [share for share, _ in between]
        assert shares == sorted(shares) and shares[0] > 0 and shares[-1] < 1
        for share, depth in between:
            assert float(depth) * share * limit == pytest.approx(1)
            assert f"{float(depth):.6e}"[0] in "125" and f"{float(depth):.6e}"[1:8] == ".000000"
    assert depth_ticks(0.0) == [(0.0, "∞"), (1.0, "none")]
    assert depth_ticks(1e-307)[-1] == (1.0, "≤ 1e+307")


def test_scales_of_any_width_have_few_ticks():
    for limits in ((1e-300, 1e300), (2.3e-308, 1.7e308), (1.0, 1.0000001), (0.01, 0.64)):
        ticks = doubling_ticks(limits, "%")
        shares = [share for share, _ in ticks]
        assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 1
        assert 2 <= len(ticks) <= 14
        for share, text in ticks[1:-1]:
            expected = np.log2(limits[0]) + share * (np.log2(limits[1]) - np.log2(limits[0]))
            assert np.log2(float(text[:-2])) == pytest.approx(expected, abs=0.01)
    axes = draw_uncertainty(np.ones((4, 5)), np.ones((4, 5)), limits=(1e-300, 1e307))
    assert abs(shown(axes)[0, 0] - color_ramp("error")[126].astype(int)).max() < 8
    draw_whole(axes.figure)
    draw_whole(error_figure(np.ones((4, 5)), limits=(1e-300, 1e300)))


def test_flat_pictures_are_enlarged():
    """A few rows of many columns fill their axes; a usual picture keeps its pixels square."""
    for shape, is_flat in (((2, 100), True), ((100, 2), True), ((20, 100), False)):
        axes = draw_confidence(np.zeros(shape), axes=empty(6, 6).add_subplot())
        axes.figure.canvas.draw()
        box = axes.get_window_extent()
        assert (min(box.width, box.height) > 200) == is_flat
        assert axes.get_aspect() == ("auto" if is_flat else 1)


def test_bars_have_the_colours_of_the_picture():
    """What a bar says is what the picture shows: its ends and its middle."""
    axes = draw_depth(np.ones((40, 50)), limit=2.0)
    figure = axes.figure
    figure.canvas.draw()
    bar = next(a for a in figure.axes if a is not axes and a.get_images())
    drawn = np.asarray(bar.get_images()[0].get_array())
    assert np.array_equal(drawn[::-1, 0], color_ramp("depth"))
    place = dict(zip([t.get_text() for t in bar.get_yticklabels()], bar.get_yticks(), strict=True))
    assert place["∞"] == 0 and place["≤ 0.5"] == 1 and place["1"] == 0.5
    assert np.array_equal(shown(axes)[5, 5], color_ramp("depth")[128])
    wide = draw_depth(np.ones((20, 90)), limit=2.0)
    bar = next(a for a in wide.figure.axes if a is not wide and a.get_images())
    assert np.array_equal(np.asarray(bar.get_images()[0].get_array())[0], color_ramp("depth"))


def test_a_wheel_shows_the_colours_of_flow():
    axes = draw_flow(np.ones((30, 40, 2)), limit=3.0)
    figure = axes.figure
    wheels = [a for a in figure.findobj(type(axes)) if a is not axes and a.get_images()]
    (wheel,) = [np.asarray(a.get_images()[0].get_array()) for a in wheels]
    side = len(wheel)
    right = wheel[side // 2, -3].astype(int)
    assert right[0] > 240 and right[1:].max() < 40
    assert (wheel[side // 2, side // 2] > 240).all()


@pytest.mark.parametrize("shape", nightly_except((1, 300), of=((1, 1), (1, 300), (300, 1), (2, 3))))
def test_maps_without_known_pixels_are_drawn_at_odd_sizes(shape):
    nothing = np.full(shape, np.nan)
    no_flow = np.full((*shape, 2), np.nan)
    for axes in (
        draw_depth(nothing),
        draw_confidence(nothing),
        draw_uncertainty(nothing, nothing),
        draw_flow_error(no_flow, no_flow),
        draw_depth_error(nothing, nothing),
    ):
        assert (shown(axes) == UNKNOWN_COLOR).all()
        draw_whole(axes.figure)
    assert (shown(draw_flow(no_flow)) == 0).all()
    draw_whole(draw_labels(np.zeros(shape), np.zeros(shape, int)).figure)
    assert "no truth" in draw_depth_error(nothing, nothing).get_title()


def test_axes_are_drawn_into_again():
    """As for an animation: the legend is that of the last picture, and takes no more room."""
    figure = empty()
    axes = figure.add_subplot()
    for limit in (1.0, 0.5, 0.25):
        draw_depth(np.full((30, 40), 0.1), axes=axes, limit=limit)
        figure.canvas.draw()
        sizes = axes.get_window_extent().bounds, len(figure.axes), len(axes.get_children())
    draw_depth(np.full((30, 40), 0.1), axes=(once := empty().add_subplot()), limit=0.25)
    once.figure.canvas.draw()
    assert sizes == (
        once.get_window_extent().bounds,
        len(once.figure.axes),
        len(once.get_children()),
    )
    assert "≤ 4" in words(axes) and "≤ 2" not in words(axes)


def test_large_pictures_are_reduced_by_means():
    """A grid that every so many pixels would miss, or would show alone, is grey."""
    checks = np.indices((1200, 1600)).sum(axis=0) % 2
    axes = draw_confidence(checks, axes=empty(2, 1.5).add_subplot())
    mean = color_ramp("confidence")[[0, 255]].mean(axis=0)
    assert shown(axes).shape[1] <= 400
    assert np.abs(shown(axes)[50, 50] - mean).max() < 40


@pytest.mark.nightly
def test_figures_of_their_own_hold_everything(tmp_path):
    for name, (draw, arrays, _) in parts().items():
        axes = draw(*arrays, title=name)
        figure = axes.figure
        for text in texts(axes):
            box = text.get_window_extent()
            assert box.x0 >= 0 and box.x1 <= figure.bbox.x1, name
            assert box.y0 >= 0 and box.y1 <= figure.bbox.y1, name
        save_figure(tmp_path / "a.png", axes.figure)


def test_errors_are_those_of_the_arrays():
    with pytest.raises(ValueError, match=r"inverse_depth is \(3,\)"):
        draw_depth([1, 2, 3])
    with pytest.raises(ValueError, match="limit is -1"):
        draw_flow(np.ones((2, 3, 2)), limit=-1)
    with pytest.raises(ValueError, match="0 < low < high"):
        draw_uncertainty(np.ones((2, 3)), np.ones((2, 3)), limits=(1, 0.5))
    with pytest.raises(ValueError, match=r"labels is \(2, 4\)"):
        draw_labels(np.ones((2, 3)), np.ones((2, 4), int))


def test_no_global_setting_of_matplotlib_changes():
    script = (
        "import sys, numpy as np, tisfm.show as show\n"
        "assert 'matplotlib' not in sys.modules\n"
        "import matplotlib\n"
        "def settings():  # to read that of the backend chooses one\n"
        "    return {k: matplotlib.rcParams[k] for k in matplotlib.rcParams if k != 'backend'}\n"
        "before = settings()\n"
        "show.draw_depth(np.ones((4, 5)))\n"
        "show.draw_flow(np.ones((4, 5, 2)))\n"
        "show.draw_labels(np.ones((4, 5)), np.ones((4, 5), int))\n"
        "show.draw_path(np.eye(4)[None])\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "assert settings() == before\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
