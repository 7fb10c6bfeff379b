"""Paths from above and from the side: axes, truth, pieces, frames without a pose."""

from itertools import pairwise

import numpy as np
import pytest

from tests.show.test_draw_maps import empty, words
from tisfm.rigid import pose_matrix
from tisfm.show import draw_labels, draw_object_paths, draw_path, label_colors, save_figure


def poses_at(places, rotation=None):
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, 3] = places
    if rotation is not None:
        poses[:, :3, :3] = rotation
    return poses


def walk(count=30):
    """To the right, forward and up: X, −Y and Z all grow, and differ."""
    t = np.linspace(0, 1, count)
    return np.stack([t, -0.5 * t**2, 2 * t + 0.1 * np.sin(9 * t)], axis=1)


def moved(places, scale=3.0):
    """Return the same path in another world and unit."""
    turn = pose_matrix([0, 0, 0, 0.3, -0.8, 0.5])[:3, :3]
    return poses_at(scale * places @ turn.T + np.array([5.0, -2, 7]), turn)


def line(axes, label):
    return next(x.get_xydata() for x in axes.get_lines() if x.get_label() == label)


def shaded(axes):
    """Return the points of the paths that are drawn from dark to light."""
    return [
        np.concatenate([c.get_segments()[0][:1], [s[1] for s in c.get_segments()]])
        for c in axes.collections
        if hasattr(c, "get_segments") and len(c.get_segments())
    ]


@pytest.mark.parametrize(("view", "across", "up"), [("above", 0, 2), ("side", 2, 1)])
def test_views_show_two_axes(view, across, up):
    figure = empty()
    left, right = figure.subplots(1, 2)
    places = walk()
    assert draw_path(poses_at(places), axes=left, view=view, unit="m", title="A") is left
    assert not right.has_data()
    (drawn,) = shaded(left)
    np.testing.assert_allclose(drawn[:, 0], places[:, across])
    np.testing.assert_allclose(drawn[:, 1], -places[:, 1] if up == 1 else places[:, 2])
    text = words(left)
    assert "Z, forward (m)" in text and ("X, right (m)" if view == "above" else "up (m)") in text
    assert left.get_aspect() == 1
    ends = [x.get_xydata()[0] for x in left.get_lines() if x.get_marker() in ("o", "s")]
    np.testing.assert_allclose(ends, drawn[[0, -1]])


def test_early_is_dark_and_late_is_light():
    axes = draw_path(poses_at(walk()))
    (path,) = [c for c in axes.collections if hasattr(c, "get_segments")]
    light = path.get_colors()[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(light) >= -1e-3).all() and light[-1] > light[0] + 0.3


@pytest.mark.parametrize("view", ["above", "side"])
def test_the_truth_is_in_the_axes_of_its_first_camera(view):
    """A truth in another world and unit lies on the path that is the same but for a similarity."""
    places = walk()
    axes = draw_path(poses_at(places), truth=moved(places), view=view, unit="m")
    (drawn,) = shaded(axes)
    truth = line(axes, "truth")
    np.testing.assert_allclose(drawn, truth, atol=1e-9)
    alone = draw_path(moved(places), view=view)
    np.testing.assert_allclose(truth, shaded(alone)[0], atol=1e-9)
    np.testing.assert_allclose(np.ptp(truth, axis=0), 3 * np.ptp(shaded(
        draw_path(poses_at(places), view=view))[0], axis=0))  # fmt: skip
    assert "rmse" in words(axes) and "truth" in words(axes)


def test_the_error_is_that_of_the_aligned_path():
    places = walk()
    rng = np.random.default_rng(0)
    noisy = places + 0.01 * rng.normal(size=places.shape)
    axes = draw_path(poses_at(noisy), truth=moved(places), unit="m")
    text = next(t.get_text() for t in axes.get_legend().get_texts() if "rmse" in t.get_text())
    assert float(text.split()[-2]) == pytest.approx(3 * 0.01 * 3**0.5, rel=0.25)


def test_frames_without_a_pose_are_left_out():
    places = walk()
    given, truth = poses_at(places), moved(places)
    given[5:9] = np.nan
    truth[20:] = np.nan
    axes = draw_path(given, truth=truth)
    assert len(shaded(axes)[0]) == 26 and len(line(axes, "truth")) == 20
    assert len(shaded(draw_path(given))[0]) == 26


def test_pieces_are_aligned_each_on_its_own():
    places = walk()
    given = poses_at(places)
    given[12:, :3, 3] = 5 - 0.3 * places[12:]
    piece = np.repeat([0, 1], [12, 18])
    piece[29] = -1
    axes = draw_path(given, truth=moved(places), piece=piece)
    first, second = shaded(axes)
    truth = line(axes, "truth")
    assert len(first) == 12 and len(second) == 17
    np.testing.assert_allclose(first, truth[:12], atol=1e-6)
    # The second is mirrored, which no similarity undoes, but it has its own place and scale.
    assert np.abs(second.mean(axis=0) - truth[12:29].mean(axis=0)).max() < 0.1
    alone = draw_path(given, piece=piece)
    (largest,) = shaded(alone)
    assert len(largest) == 17 and "largest of 2 pieces" in words(alone)


@pytest.mark.parametrize("truth", [False, True])
def test_empty_and_straight_paths_and_paths_at_rest(tmp_path, truth):
    nothing = np.full((4, 4, 4), np.nan)
    axes = draw_path(nothing, truth=nothing if truth else None)
    assert "no" in words(axes) and not shaded(axes)
    for given in (nothing[:0], poses_at(np.zeros((1, 3))), poses_at(np.ones((5, 3)))):
        axes = draw_path(given, truth=given if truth else None)
        save_figure(tmp_path / "a.png", axes.figure, dpi=40)
    straight = poses_at(np.outer(np.arange(6.0), [0, 0, 1]))
    axes = draw_path(straight, truth=straight if truth else None)
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    assert np.ptp(limits, axis=1)[0] == pytest.approx(np.ptp(limits, axis=1)[1])
    save_figure(tmp_path / "a.png", axes.figure, dpi=40)


def test_a_truth_that_shares_no_frame_is_drawn_alone():
    given, truth = poses_at(walk(4)), moved(walk(4))
    given[:2], truth[2:] = np.nan, np.nan
    axes = draw_path(given, truth=truth)
    assert "no pose to compare" in words(axes) and len(line(axes, "truth")) == 2


def test_long_paths_have_few_points():
    (drawn,) = shaded(draw_path(poses_at(walk(9000))))
    assert len(drawn) <= 2001
    np.testing.assert_allclose(drawn[-1], walk(9000)[-1, [0, 2]])


def test_objects_have_the_colours_of_their_labels():
    objects = {2: poses_at(walk()), 5: poses_at(1 + walk()), 7: np.full((3, 4, 4), np.nan)}
    figure = empty()
    axes = draw_object_paths(objects, axes=figure.add_subplot(), camera=poses_at(-walk()), unit="m")
    colors = label_colors(8)
    for number in (2, 5):
        drawn = next(x for x in axes.get_lines() if x.get_label() == f"object {number}")
        assert drawn.get_color() == "#" + bytes(colors[number].tolist()).hex()
    text = words(axes)
    assert "camera" in text and "object 5" in text and "object 7" not in text and "(m)" in text
    limits = axes.get_xlim()
    assert limits[0] < -1 and limits[1] > 2
    assert "no object has a pose" in words(draw_object_paths({}))
    assert "no object has a pose" in words(draw_object_paths({7: objects[7]}))


@pytest.mark.parametrize("size", [(2.0, 1.7), (38.4, 21.6)])
def test_paths_are_read_at_any_size(size):
    figure = empty(*size)
    figure.set_layout_engine("constrained")
    axes = draw_path(
        poses_at(walk()), truth=moved(walk()), axes=figure.add_subplot(), unit="m", title="Path"
    )
    figure.canvas.draw()
    texts = [*axes.get_legend().get_texts(), axes.xaxis.label, axes.title]
    texts += axes.get_xticklabels()
    heights = [t.get_fontsize() / 72 * 100 for t in texts]
    assert min(heights) >= 9 - 1e-6 and (size[0] < 10 or min(heights) > 40)
    for text in texts[:4]:
        box = text.get_window_extent()
        assert box.x0 >= -2 and box.x1 <= figure.bbox.x1 + 2
        assert box.y0 >= -2 and box.y1 <= figure.bbox.y1 + 2
    legend, title = axes.get_legend().get_window_extent(), axes.title.get_window_extent()
    assert not legend.overlaps(title)
    ticks = [t.get_window_extent() for t in axes.get_xticklabels() if t.get_text()]
    assert all(a.x1 <= b.x0 + 1 for a, b in pairwise(ticks))


def test_paths_are_drawn_into_the_same_axes_again():
    axes = empty().add_subplot()
    counts = []
    for places in (walk(), walk() + 1, 3 * walk()):
        draw_path(poses_at(places), truth=moved(places), axes=axes, unit="$x", title="Path")
        axes.figure.canvas.draw()
        counts.append((len(axes.get_lines()), len(axes.collections), len(axes.get_children())))
    assert len(set(counts)) == 1
    once = draw_path(
        poses_at(3 * walk()), truth=moved(3 * walk()), axes=empty().add_subplot(), unit="$x"
    )
    once.figure.canvas.draw()
    assert axes.get_window_extent().bounds == once.get_window_extent().bounds
    draw_labels(np.zeros((3, 4)), np.zeros((3, 4), int), axes=axes)
    draw_path(poses_at(walk()), axes=axes)
    axes.figure.canvas.draw()
    assert len(axes.figure.axes) == 1 and axes.get_images() == []


def test_dollar_signs_are_dollar_signs():
    """What Matplotlib would take for a formula, and stop at, is written as it is."""
    unit = r"$\nothing$"
    axes = draw_path(poses_at(walk()), truth=moved(walk()), unit=unit)
    assert unit in words(axes)
    assert r"$\no_" in words(draw_labels(np.zeros((2, 2)), np.eye(2, dtype=int), names=[r"$\no_$"]))


def test_arguments_are_checked():
    poses = poses_at(walk(4))
    with pytest.raises(ValueError, match=r"poses has the shape \(4, 3, 4\)"):
        draw_path(poses[:, :3])
    with pytest.raises(ValueError, match="truth has 3 frames but poses have 4"):
        draw_path(poses, truth=poses[1:])
    with pytest.raises(ValueError, match="piece has 3 frames but poses have 4"):
        draw_path(poses, piece=[0, 0, 0])
    with pytest.raises(ValueError, match=r"piece has the shape \(4, 1\), expected \(N,\)"):
        draw_path(poses, piece=np.zeros((4, 1), int))
    with pytest.raises(ValueError, match="piece has dtype float64, expected integers"):
        draw_path(poses, piece=[0.0, 0.5, 1.0, np.nan])
    with pytest.raises(ValueError, match="view is 'below', expected one of above, side"):
        draw_path(poses, view="below")
    with pytest.raises(ValueError, match=r"object 3 has the shape \(4,\)"):
        draw_object_paths({3: np.zeros(4)})
    with pytest.raises(ValueError, match="expected numbers from 0"):
        draw_object_paths({-1: poses})
