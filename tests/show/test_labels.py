"""Labels as colours over a picture."""

import numpy as np
import pytest
from matplotlib.legend import Legend

from tests.show.drawn import scene
from tisfm.show import draw_labels, label_colors, label_overlay


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


def test_large_labels_take_no_longer():
    """A label of many digits has its colour, which that of the same category has, at once."""
    huge = np.full((4, 5), 15 * 10**16 + 1)
    huge[:, :2] = 0
    small = np.minimum(huge, 1)
    frame = np.zeros((4, 5), np.uint8)
    assert np.array_equal(label_overlay(frame, huge), label_overlay(frame, small))
    axes = draw_labels(frame, huge)
    (_, patch) = axes.figure.findobj(Legend)[0].get_patches()
    assert patch.get_facecolor()[:3] == tuple(label_colors(2)[1] / 255)
    assert np.array_equal(
        label_overlay(frame, np.full((4, 5), 200, np.uint8)),
        label_overlay(frame, np.full((4, 5), 200)),
    )


def test_labels_name_wrong_arguments():
    frame = np.zeros((4, 5), np.uint8)
    with pytest.raises(TypeError, match="labels has dtype float64, expected integers"):
        label_overlay(frame, np.zeros((4, 5)))
    with pytest.raises(ValueError, match=r"labels is \(4, 6\) but image is \(4, 5\)"):
        label_overlay(frame, np.zeros((4, 6), int))
    with pytest.raises(ValueError, match=r"labels is \(4, 5, 1\), expected \(H, W\)"):
        label_overlay(frame, np.zeros((4, 5, 1), int))
    with pytest.raises(ValueError, match="labels has -1, expected integers from 0"):
        label_overlay(frame, np.full((4, 5), -1))
