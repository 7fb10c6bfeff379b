"""The course of the energy: every iteration, broken at warps, levels marked."""

from itertools import pairwise

import numpy as np
import pytest

import tisfm
from tests.show.test_draw_maps import empty, words
from tisfm.scenes import two_blocks
from tisfm.show import draw_energy
from tisfm.status import History


def history(level, warp, energy):
    values = np.array(energy, float)
    return History(
        level=np.array(level, np.int32),
        warp=np.array(warp, np.int32),
        energy=values,
        half_quadratic=values + 1,
        change=values / 100,
    )


MADE = history([2, 2, 2, 1, 1, 0, 0], [0, 0, 1, 0, 0, 0, 1], [9, 5, 7, 20, 10, 40, 30])


def lines(axes):
    return {line.get_label(): line.get_xydata() for line in axes.get_lines()}


def test_each_iteration_is_a_point_and_each_warp_a_break():
    figure = empty()
    left, right = figure.subplots(1, 2)
    assert draw_energy(MADE, axes=left, title="A title") is left and not right.has_data()
    drawn = lines(left)["energy"]
    known = np.isfinite(drawn[:, 1])
    assert np.array_equal(drawn[known], np.stack([np.arange(7), MADE.energy], axis=1))
    gaps = [round(drawn[k - 1, 0]) for k in np.flatnonzero(~known)]
    assert gaps == [1, 2, 4, 5]  # after these iterations another warp begins
    assert np.nanmax(lines(left)["half-quadratic"][:, 1]) == 41
    assert left.get_yscale() == "log" and left.get_title() == "A title"
    text = words(left)
    assert "iteration" in text and "energy (any unit)" in text
    assert [t.get_text().removeprefix("level ") for t in left.texts] == ["2", "1", "0"]


def test_other_quantities_and_odd_histories():
    change = draw_energy(MADE, quantity="change")
    drawn = lines(change)["change"]
    assert np.nanmax(drawn[:, 1]) == 0.4 and "relative change" in words(change)
    zero = draw_energy(history([0], [0], [0.0]))
    assert zero.get_yscale() == "linear"
    still = History(**{**vars(MADE), "change": np.zeros(7)})
    assert np.nanmin(lines(draw_energy(still, quantity="change"))["change"][:, 1]) > 0
    none = draw_energy(history([], [], []))
    assert "no iterations" in words(none)
    with pytest.raises(ValueError, match="quantity is 'power', expected one of energy, change"):
        draw_energy(MADE, quantity="power")


@pytest.mark.parametrize("size", [(2.0, 1.6), (38.4, 21.6)])
def test_energy_figures_are_legible_at_any_size(size):
    long = history(np.repeat(np.arange(40)[::-1], 5), np.tile([0, 0, 1, 1, 1], 40), range(1, 201))
    figure = empty(*size)
    figure.set_layout_engine("constrained")
    axes = draw_energy(long, axes=figure.add_subplot())
    figure.canvas.draw()
    heights = {t.get_fontsize() / 72 * 100 for t in (*axes.texts, axes.xaxis.label)}
    assert min(heights) >= 8.9 and (size[0] < 10 or min(heights) > 40)
    boxes = [t.get_window_extent() for t in axes.texts]
    legend = axes.get_legend().get_window_extent()
    assert all(legend.y1 <= box.y0 + 1 for box in boxes)
    for before, after in pairwise(boxes):
        assert before.x1 <= after.x0 + 1


def test_the_history_of_a_pair_is_drawn():
    scene = two_blocks(48, 64)
    result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera)
    drawn = lines(draw_energy(result.history))["energy"]
    known = drawn[np.isfinite(drawn[:, 1])]
    assert np.array_equal(known[:, 1], result.history.energy)
    pieces = np.split(drawn[:, 1], np.flatnonzero(np.isnan(drawn[:, 1])))
    assert all((np.diff(piece[np.isfinite(piece)]) <= 1e-6 * piece[-1]).all() for piece in pieces)
