"""Errors of flow and depth as colours and figures."""

import numpy as np
import pytest
from PIL import Image

from tests.draws import nightly_except
from tisfm.show import (
    ERROR_RANGE,
    depth_error_figure,
    error_figure,
    error_to_color,
    flow_figure,
    save_figure,
)


def test_error_colors_brighten_with_every_doubling():
    error = np.array([[0.0, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16, 1e9, np.inf]])
    color = error_to_color(error)[0].astype(int)
    luma = color @ [0.299, 0.587, 0.114]
    assert luma[0] == luma[1] < 40 and luma[-1] == luma[-2] == luma[-3] > 200
    steps = np.diff(luma[1:-2])
    assert (steps > 0).all() and steps.max() < 2.5 * steps.min()
    assert (error_to_color(error, limits=(1, 2))[0, 6] == color[-1]).all()


def test_unknown_errors_are_grey():
    error = np.array([[np.nan, 0.0, 1.0]], np.float32)
    assert error_to_color(error)[0, 0].tolist() == [200, 200, 200]
    every = error_to_color(np.geomspace(*ERROR_RANGE, 4000)[None])[0].astype(int)
    assert np.abs(every - 200).max(axis=1).min() > 40  # nothing else is near that grey


@pytest.mark.parametrize("limits", [(0, 1), (1, 1), (2, 1), (np.nan, 1), (1, np.inf), (-1, 1)])
def test_error_limits_are_checked(limits):
    for draw in (error_to_color, error_figure):
        with pytest.raises(ValueError, match=r"limits is \(.*0 < low < high"):
            draw(np.ones((3, 4)), limits=limits)


@pytest.mark.parametrize(
    "shape", nightly_except((90, 20), of=[(60, 80), (20, 90), (90, 20), (1, 1)])
)
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
    luma = [picture.astype(int).sum(axis=2) for picture in (recovered, true)]
    assert (luma[0][10:20, 10:20] < luma[1][10:20, 10:20]).all()
    assert (true[:5] == 200).all() and (recovered[30] == 200).all()
    unknown = (error == 200).all(axis=2)
    assert unknown[:5].all() and unknown[30].all() and not unknown[alike].any()
    assert (error[alike] == error_to_color([[0.0]])[0, 0]).all()
    expected = error_to_color([[0.5]], limits=(1 / 64, 1.0))[0, 0]
    assert (np.abs(error[10:20, 10:20].astype(int) - expected) <= 6).all()  # a level of the map
    wider = panels_of(depth_error_figure(depth, truth, limits=(0.5, 2)))[2]
    assert (wider[10:20, 10:20] == error_to_color([[0.0]])[0, 0]).all()


def test_depth_figures_name_wrong_arguments():
    with pytest.raises(ValueError, match=r"truth is \(40, 60\) but depth is \(40, 59\)"):
        depth_error_figure(np.ones((40, 59)), np.ones((40, 60)))
    with pytest.raises(ValueError, match=r"no pixel of the \(4, 6\) depth"):
        depth_error_figure(np.full((4, 6), np.nan), np.ones((4, 6)))
    with pytest.raises(ValueError, match="0 < low < high"):
        depth_error_figure(np.ones((4, 6)), np.ones((4, 6)), limits=(1, 0.5))
