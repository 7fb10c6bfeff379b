"""Figures of a pair: drawn at any size, nothing overlaps, one range for a sequence."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from tests.pairwise import pairwise
from tests.show.drawn import drawn_parts, overlapping, scene, written
from tisfm.show import (
    comparison_figure,
    depth_error_figure,
    depth_grey,
    flow_to_color,
    panel_figure,
    save_figure,
)


@pytest.mark.parametrize(
    ("size", "extras"),
    [
        ((1, 7), ("baseline", "truth", "depth")),
        ((37, 91), ()),
        ((12, 700), ("baseline",)),
        pytest.param((16, 16), ("baseline",), marks=pytest.mark.nightly),
        pytest.param((1, 1), (), marks=pytest.mark.nightly),
        pytest.param((300, 40), ("baseline", "truth", "depth"), marks=pytest.mark.nightly),
    ],
)
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
    assert len(np.unique(shown.astype(np.int64) @ (1, 256, 65536))) > 20


@pairwise(size=((48, 64), (64, 36), (400, 30), (20, 700)), more=(3, 0, 1, 2), short=True)
def test_titles_and_panels_do_not_overlap(size, more):
    frame, inverse_depth, flow = scene(*size)
    extras = {"baseline_flow": flow, "truth_flow": flow, "truth_inverse_depth": inverse_depth}
    extras = dict(list(extras.items())[:more])
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


def test_long_arrows_are_cut():
    frame, inverse_depth, flow = scene(60, 80)
    flow[:] = 0.3, -0.4

    def longest(factor):
        figure = comparison_figure(frame, inverse_depth, factor * flow, flow_limit=0.5)
        (arrows,) = drawn_parts(figure)[1][:1]
        return np.hypot(arrows.U, arrows.V).max()

    assert np.isclose(longest(2), 2 * longest(1))
    assert np.isclose(longest(1e6), 3 * longest(1))


def test_figures_without_motion_are_drawn(tmp_path):
    frame, inverse_depth, flow = scene(20, 30)
    for values, color in ((np.zeros_like(flow), 255), (np.full_like(flow, np.nan), 0)):
        figure = comparison_figure(frame[..., 0] / 255, 0 * inverse_depth, values)
        save_figure(tmp_path / "figure.png", figure, dpi=40)
        panels, arrows = drawn_parts(figure)
        shown = [np.asarray(axes.get_images()[0].get_array()) for axes in panels]
        assert not shown[1].any()  # depth
        assert (shown[3] == color).all()  # flow: white where nothing moves, black where unknown
        assert arrows == []


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


def test_depths_have_their_scales():
    frame, inverse_depth, flow = scene(20, 30)
    plain = written(comparison_figure(frame, inverse_depth / 119, flow))
    assert {"depth Z\n(relative)", "≤ 119", "200", "500", "1000", "∞"} <= set(plain)
    both = comparison_figure(
        frame, inverse_depth, flow, truth_inverse_depth=0.1 * inverse_depth, unit="m"
    )
    assert {"depth Z\n(m)", "≤ 1", "true Z\n(its unit)", "≤ 10"} <= set(written(both))
    grey = [panel.get_images()[0].get_array() for panel in drawn_parts(both)[0]]
    expected = np.repeat(np.arange(255, -1, -1)[:, None, None], 3, axis=2)
    assert sum(bar.shape == (256, 1, 3) and np.array_equal(bar, expected) for bar in grey) == 2
    error = written(depth_error_figure(7 / inverse_depth, 1 / inverse_depth, unit="cm"))
    assert {"depth Z\n(cm)", "≤ 1", "2", "≥ 100 %"} <= set(error)


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
