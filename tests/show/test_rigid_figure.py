"""Figures of rigid motions, and the uncertainty of their depth as colours."""

import numpy as np
import pytest

from tests.show.drawn import drawn_parts, overlapping, scene, written
from tisfm.show import (
    UNCERTAINTY_RANGE,
    color_ramp,
    confidence_to_color,
    depth_to_color,
    error_to_color,
    flow_to_color,
    rigid_figure,
    save_figure,
    uncertainty_to_color,
)


def test_uncertainty_has_the_colours_of_errors():
    inverse_depth = np.array([[1.0, 2.0, 4.0, 0.5]])
    deviation = np.array([[0.01, 0.16, 8.0, 0.02]])
    shown = uncertainty_to_color(inverse_depth, deviation)
    expected = error_to_color(deviation / inverse_depth, limits=UNCERTAINTY_RANGE)
    assert np.array_equal(shown, expected)
    assert len(np.unique(shown.astype(np.int64) @ (1, 256, 65536))) == 4
    wider = uncertainty_to_color(inverse_depth, deviation, limits=(0.001, 10))
    assert not np.array_equal(shown, wider)


def test_uncertainty_without_depth_is_grey():
    nothing = np.array([[0.0, -1.0, np.nan, np.inf, 1.0, 1.0]])
    deviation = np.array([[1.0, 1.0, 1.0, 1.0, np.inf, np.nan]])
    assert np.all(uncertainty_to_color(nothing, deviation) == 200)
    tiny = uncertainty_to_color([[1e-200]], [[1e200]])
    assert np.array_equal(tiny, uncertainty_to_color([[1.0]], [[1e9]]))


def test_uncertainty_names_wrong_arguments():
    with pytest.raises(ValueError, match=r"inverse_depth_std is \(2, 4\) but inverse_depth is"):
        uncertainty_to_color(np.ones((2, 3)), np.ones((2, 4)))
    with pytest.raises(ValueError, match="limits is"):
        uncertainty_to_color(np.ones((2, 3)), np.ones((2, 3)), limits=(1, 0.1))


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


@pytest.mark.parametrize(
    ("size", "count", "truth"),
    [
        ((48, 64), 20, True),
        ((400, 30), 2, True),
        ((20, 700), 1, False),
        pytest.param((48, 64), 1, False, marks=pytest.mark.nightly),
        pytest.param((64, 36), 2, True, marks=pytest.mark.nightly),
        pytest.param((400, 30), 20, False, marks=pytest.mark.nightly),
        pytest.param((20, 700), 1, True, marks=pytest.mark.nightly),
        pytest.param((20, 700), 20, False, marks=pytest.mark.nightly),
        pytest.param((1, 1), 2, False, marks=pytest.mark.nightly),
    ],
)
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
        "Confidence (yellow: 1)",
    ]
    frame, depth, uncertainty, _, flow, confidence = shown.values()
    assert (frame[:20, :, 0].mean() > frame[:20, :, 1].mean() + 50).all()
    assert np.array_equal(depth, depth_to_color(arrays[1], limit=2.0))
    assert np.all(uncertainty[:20] == 200)
    expected = uncertainty_to_color(arrays[1], options["inverse_depth_std"])
    assert np.array_equal(uncertainty[20:], expected[20:])
    assert np.array_equal(flow, flow_to_color(arrays[2], limit=0.4))
    assert np.array_equal(confidence, confidence_to_color(options["confidence"]))


def test_a_rigid_figure_states_missing_depth():
    (frame, inverse_depth, flow), options = rigid_parts(20, 30)
    options["inverse_depth_std"] = np.full_like(inverse_depth, np.inf)
    shown = rigid_panels(frame, 0 * inverse_depth, 0 * flow, **options)
    assert np.all(shown["Depth: no pixel has a depth"] == color_ramp("depth")[0])
    assert np.all(shown["Uncertainty of the depth (grey: unknown)"] == 200)


def test_depths_of_a_rigid_figure_have_their_scales():
    arrays, options = rigid_parts(30, 40)
    plain = written(rigid_figure(*arrays, depth_limit=0.4, **options))
    assert "depth Z\n(relative)" in plain and {"∞", "10", "5", "≤ 2.5"} <= set(plain)
    options["truth_inverse_depth"] = arrays[1] / 300
    figure = rigid_figure(*arrays, unit="$\\m$", **options)
    both = written(figure)
    assert {"depth Z\n($\\m$)", "≤ 1", "true Z\n(its unit)", "≤ 300", "500"} <= set(both)
    ramp = color_ramp("depth")[::-1, None]
    bars = [panel.get_images()[0].get_array() for panel in drawn_parts(figure)[0]]
    assert sum(bar.shape == ramp.shape and np.array_equal(bar, ramp) for bar in bars) == 2
    assert "none" in written(rigid_figure(arrays[0], 0 * arrays[1], arrays[2], **options))


def test_labels_of_a_rigid_figure_may_be_large():
    arrays, options = rigid_parts(30, 40, count=2)
    options["labels"] = options["labels"].astype(np.int64) * 10**15
    names = written(rigid_figure(*arrays, **options))
    assert "0, background" in names and str(10**15) in names and "1" not in names


def test_a_rigid_figure_names_the_wrong_size():
    (frame, inverse_depth, flow), options = rigid_parts(20, 30)
    options["confidence"] = np.ones((20, 31))
    with pytest.raises(ValueError, match=r"confidence is \(20, 31\) but frame is \(20, 30\)"):
        rigid_figure(frame, inverse_depth, flow, **options)
