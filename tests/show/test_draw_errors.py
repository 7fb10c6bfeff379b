"""Errors and calibration drawn into axes: what is drawn is what the metrics say."""

import numpy as np
import pytest

from tests.show.test_draw_maps import empty, shown, words
from tisfm.metrics import depth_errors, endpoint_error, std_coverage
from tisfm.show import (
    UNKNOWN_COLOR,
    color_ramp,
    draw_calibration,
    draw_depth_error,
    draw_flow_error,
    error_to_color,
)

RAMP = color_ramp("error")


def test_flow_errors_have_the_colours_of_their_length():
    truth = np.zeros((3, 4, 2))
    flow = truth.copy()
    flow[0, :, 0] = (1 / 16, 1.0, 16.0, 100.0)
    flow[1] = (3.0, 4.0)
    truth[2, :2], flow[2, 2] = np.nan, np.nan
    axes = draw_flow_error(flow, truth)
    picture = shown(axes)
    assert np.array_equal(picture[0], RAMP[[0, 128, 255, 255]])
    assert np.array_equal(picture[1], np.repeat(error_to_color([[5.0]])[0], 4, axis=0))
    assert (picture[2, :3] == UNKNOWN_COLOR).all() and (picture[2, 3] == RAMP[0]).all()
    text = words(axes)
    assert "end-point error (px)" in text
    assert "≤ 0.0625 px" in text and "≥ 16 px" in text
    known = np.isfinite(truth).all(axis=2) & np.isfinite(flow).all(axis=2)
    mean = endpoint_error(flow[known][None], truth[known][None])
    assert axes.get_title() == f"mean {mean:.3g} px"
    assert draw_flow_error(flow, truth, title="").get_title() == ""
    wider = shown(draw_flow_error(flow, truth, limits=(1, 2)))
    assert np.array_equal(wider[0], RAMP[[0, 0, 255, 255]])


def test_depth_errors_are_after_scaling():
    truth = np.linspace(1, 5, 60).reshape(6, 10)
    depth = 7 * truth
    depth[0, :3] *= 1.5
    truth[1, 0], depth[1, 1] = np.nan, -1.0
    axes = draw_depth_error(depth, truth)
    picture = shown(axes)
    assert (picture[2:] == RAMP[0]).all()
    expected = error_to_color([[0.5]], limits=(1 / 64, 1))[0, 0].astype(int)
    assert np.abs(picture[0, :3].astype(int) - expected).max() <= 6
    assert (picture[1, :2] == UNKNOWN_COLOR).all()
    assert axes.get_title() == f"mean {100 * depth_errors(depth, truth).abs_rel:.3g} %"
    text = words(axes)
    assert "error of depth (%)" in text and "≥ 100 %" in text and "25 %" in text


def curve(axes):
    """Return the drawn curves by their labels."""
    return {line.get_label(): line.get_xydata() for line in axes.get_lines()}


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_calibration_is_the_coverage(factor):
    rng = np.random.default_rng(0)
    truth = rng.uniform(1, 4, (80, 90))
    deviation = rng.uniform(0.001, 0.02, truth.shape)
    found = 3 * (1 / truth + deviation * rng.normal(size=truth.shape))
    stated = 3 * factor * deviation
    axes = draw_calibration(found, stated, truth, axes=empty().add_subplot(), title="A title")
    lines = curve(axes)
    covered = next(points for name, points in lines.items() if name.startswith("measured"))
    for times in (0.5, 1.0, 2.0, 3.0):
        share = 100 * std_coverage(found, times * stated, truth)
        assert np.interp(times, *covered.T) == pytest.approx(share, abs=0.3)
    normal = lines["normal errors"]
    assert np.interp(1.0, *normal.T) == pytest.approx(68.27, abs=0.01)
    assert np.interp(2.0, *normal.T) == pytest.approx(95.45, abs=0.01)
    below = np.interp(1.0, *covered.T) - 68.27
    assert abs(below) < 3 if factor == 1 else below * (factor - 1) > 10
    text = words(axes)
    assert "error (standard deviations)" in text and "pixels within (%)" in text
    assert f"measured: {100 * std_coverage(found, stated, truth):.0f} % within one" in text


def test_calibration_of_infinite_and_unknown_deviations():
    truth = np.ones((4, 5))
    found = truth.copy()
    found[0] = 1.5
    deviation = np.full(truth.shape, np.inf)
    deviation[1:3] = np.nan
    deviation[3, 0] = 0.0

    def covered():
        return draw_calibration(found, deviation, truth).get_lines()[1].get_ydata()

    assert covered()[0] == covered()[-1] == pytest.approx(50)  # off by nothing, or infinite
    deviation[0] = np.nan
    assert covered()[-1] == pytest.approx(25)
    with pytest.raises(ValueError, match="no pixel"):
        draw_calibration(found, deviation, np.full(truth.shape, np.nan))


def test_sizes_and_limits_are_checked():
    flow = np.ones((2, 3, 2))
    with pytest.raises(ValueError, match=r"truth is \(2, 2\) but flow is \(2, 3\)"):
        draw_flow_error(flow, flow[:, 1:])
    with pytest.raises(ValueError, match=r"truth is \(2, 2\) but depth is \(2, 3\)"):
        draw_depth_error(np.ones((2, 3)), np.ones((2, 2)))
    for draw in (draw_flow_error, lambda a, b, **o: draw_depth_error(a[..., 0], b[..., 0], **o)):
        with pytest.raises(ValueError, match="0 < low < high"):
            draw(flow, flow, limits=(2, 1))
