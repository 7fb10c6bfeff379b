"""Views of two eyes: the budget, the plane of the screen, holes, borders."""

import numpy as np
import pytest

from tisfm.show import anaglyph, second_view, stereo_view

WIDTH = 80


def stripe_at(view):
    """Return the column of the bright stripe."""
    columns = np.arange(view.shape[1])
    weight = view[view.shape[0] // 2].astype(float) ** 4
    return (columns * weight).sum() / weight.sum()


def stripe(half=1, width=WIDTH):
    image = np.zeros((9, width), np.uint8)
    image[:, width // 2 - half : width // 2 + half + 1] = 255
    return image


@pytest.mark.parametrize("near", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("eye", [1.0, -1.0, 0.5])
@pytest.mark.parametrize("budget", [{"max_disparity": 6.0}, {"disparity": 6 / WIDTH}])
def test_the_budget_is_that_of_the_whole_range(near, eye, budget):
    """To the right eye, what is before the screen moves left, and what is behind it right."""
    depth = np.full((9, WIDTH), near)
    view = stereo_view(stripe(), depth, eye=eye, limit=1.0, crop=False, **budget)
    moved = stripe_at(view) - WIDTH // 2
    assert moved == pytest.approx(6 * eye * (0.5 - near), abs=0.3)
    nearer = stereo_view(stripe(), 9 + depth, eye=eye, limit=1.0, crop=False, **budget)
    assert stripe_at(nearer) - WIDTH // 2 == pytest.approx(-3 * eye, abs=0.3)  # no further


@pytest.mark.parametrize(
    ("screen", "moved"),
    [
        ({"screen_depth": np.inf}, -4),
        ({"screen_depth": 2.0}, 0),
        ({"screen_depth": 1.0}, 4),
        ({"screen_depth": 0.01}, 4),
        ({"screen": 0.5}, 0),
        ({"screen": 0.0}, -2),  # of what has a depth
        ({"screen": 1.0}, 4),
        ({}, 0),
    ],
)
def test_points_in_the_screen_plane_do_not_move(screen, moved):
    depth = np.full((9, WIDTH), 0.5)
    depth[:, :2], depth[:, 2:5], depth[:, -5:] = 0.0, 0.25, 1.0
    view = stereo_view(stripe(), depth, max_disparity=8.0, limit=1.0, crop=False, **screen)
    assert stripe_at(view) - WIDTH // 2 == pytest.approx(moved, abs=0.3)


@pytest.mark.parametrize("screen", [0.0, 0.5, 1.0])
def test_a_quantile_of_no_depth_is_infinitely_far(screen):
    for depth in (np.zeros((9, WIDTH)), np.full((9, WIDTH), np.nan)):
        view = stereo_view(stripe(), depth, limit=1.0, screen=screen, crop=False)
        np.testing.assert_array_equal(view, stripe())


def test_a_view_moves_by_less_than_a_pixel():
    depth = np.ones((9, WIDTH))
    moved = [
        stripe_at(
            stereo_view(
                stripe(2), depth, max_disparity=d, screen_depth=np.inf, limit=1.0, crop=False
            )
        )
        - WIDTH // 2
        for d in np.arange(0, 3, 0.5)
    ]
    assert moved == pytest.approx(-np.arange(0, 3, 0.5), abs=0.1)


def test_whole_pixels_are_those_of_the_second_view():
    image = np.random.default_rng(0).integers(0, 256, (7, 60, 3), dtype=np.uint8)
    depth = np.full((7, 60), 0.4)
    view = stereo_view(image, depth, max_disparity=5, screen_depth=np.inf, limit=0.4, crop=False)
    expected = second_view(image, depth, displacement=5 / 0.4)
    np.testing.assert_array_equal(view[:, :54], expected[:, :54])
    for picture in (image.astype(np.uint16) * 257, image / 255, image.astype(np.float32)):
        options = {"max_disparity": 5, "screen_depth": np.inf, "limit": 0.4, "crop": False}
        np.testing.assert_array_equal(stereo_view(picture, depth, **options), view)


def test_the_left_view_is_the_picture():
    image = np.random.default_rng(0).integers(0, 256, (7, 60), dtype=np.uint8)
    depth = np.linspace(0, 1, 420).reshape(7, 60)
    np.testing.assert_array_equal(stereo_view(image, depth, eye=0, crop=False), image)
    cropped = stereo_view(image, depth, eye=0, disparity=0.2)
    assert cropped.shape == image.shape and (cropped != image).any()


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_without_depth_no_pixel_moves(value):
    image = np.random.default_rng(0).integers(0, 256, (8, 30), dtype=np.uint8)
    depth = np.full((8, 30), value)
    for options in ({}, {"screen": 0.5}, {"screen_depth": 3.0}):
        np.testing.assert_array_equal(stereo_view(image, depth, **options), image)


def test_the_foreground_is_not_stretched_into_holes():
    """A bright near block before dark texture: behind it, nothing bright but the block is seen."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 90, (40, 120), dtype=np.uint8)
    image[10:30, 50:70] = 250
    depth = np.full(image.shape, 0.1)
    depth[10:30, 50:70] = 1.0
    for eye in (1.0, -1.0):
        view = stereo_view(image, depth, eye=eye, max_disparity=12, limit=1.0, crop=False)
        bright = (view[12:28] > 150).sum(axis=1)
        assert (np.abs(bright - 20) <= 1).all()
        hole = view[12:28, 64:70] if eye == 1 else view[12:28, 50:56]
        assert hole.std() > 15  # texture, and no streaks
        assert np.abs(np.diff(hole.astype(float), axis=1)).mean() > 10


def test_holes_of_depth_get_the_farther_depth():
    nan = np.nan
    image = np.random.default_rng(0).integers(0, 256, (3, 6), dtype=np.uint8)
    holes = np.array([[nan, 3, nan, nan, 1, nan], [nan] * 6, [2.0] * 6])
    filled = np.array([[3, 3, 1, 1, 1, 1], [0.0] * 6, [2] * 6])
    options = {"max_disparity": 2.0, "limit": 3.0, "crop": False}
    np.testing.assert_array_equal(
        stereo_view(image, holes, **options), stereo_view(image, filled, **options)
    )
    assert np.isnan(holes[0, 0])


def test_both_views_lose_the_same_border():
    """A plane in the screen looks the same to all; one at infinity shows no border made up."""
    image = np.full((20, WIDTH), 120, np.uint8)
    image[:, ::8] = 200
    flat = np.full(image.shape, 0.5)
    views = [stereo_view(image, flat, eye=eye, limit=1.0, disparity=0.1) for eye in (-1, 0, 1)]
    np.testing.assert_allclose(views[0].astype(int), views[1], atol=3)
    np.testing.assert_allclose(views[2].astype(int), views[1], atol=3)
    far = stereo_view(image, 0 * flat, eye=1, limit=1.0, disparity=0.1)
    assert far.shape == image.shape
    is_bright = np.concatenate([[0], far[10] > 160]).astype(int)
    assert np.count_nonzero(np.diff(is_bright) == 1) == 9  # of 10, one of which is cut off


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (5, 7), (2, 201)])
def test_any_size(shape):
    image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    depth = np.random.default_rng(1).uniform(0, 1, shape)
    for crop in (True, False):
        view = stereo_view(image, depth, disparity=0.2, crop=crop)
        assert view.shape == shape and view.dtype == np.uint8
    assert anaglyph(image, depth).shape == (*shape, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"disparity": 0.0}, "disparity is 0.0: expected a share of the width"),
        ({"disparity": 0.3}, "expected a share of the width, above 0, up to 0.2"),
        ({"disparity": np.nan}, "expected a share"),
        ({"disparity": 99, "max_disparity": 3}, "expected a share of the width"),
        ({"max_disparity": -1}, "max_disparity is -1"),
        ({"screen": 1.5}, "screen is 1.5, expected a quantile, from 0 to 1"),
        ({"screen": np.nan}, "screen is nan"),
        ({"screen_depth": 0.0}, "screen_depth is 0.0, expected a depth above 0"),
        ({"screen": 0.5, "screen_depth": 2.0}, "give one of them"),
        ({"eye": 2}, "eye is 2, expected a number from -1 to 1"),
        ({"limit": -1}, "limit is -1"),
    ],
)
def test_options_are_checked(options, message):
    with pytest.raises(ValueError, match=message):
        stereo_view(np.ones((3, 4)), np.ones((3, 4)), **options)
    if "eye" not in options:
        with pytest.raises(ValueError, match=message):
            anaglyph(np.ones((3, 4)), np.ones((3, 4)), **options)


def test_the_input_picture_is_never_returned():
    image = np.random.default_rng(0).integers(0, 256, (8, 30), dtype=np.uint8)
    for options in ({"eye": 0, "crop": False}, {"eye": 0}, {}, {"max_disparity": 0}):
        for depth in (np.zeros((8, 30)), np.ones((8, 30))):
            assert not np.shares_memory(stereo_view(image, depth, **options), image)


def test_soft_edges_move_with_the_foreground():
    """The pixel around a near block, half of it, moves with it: none is left behind."""
    image = np.full((40, 120), 20, np.uint8)
    image[10:30, 50:70] = 250
    image[10:30, [49, 70]] = 135
    depth = np.full(image.shape, 0.1)
    depth[10:30, 50:70] = 1.0
    view = stereo_view(image, depth, max_disparity=20, limit=1.0, screen_depth=np.inf, crop=False)
    assert (view[12:28, 62:] < 40).all()
    assert (view[12:28, 40:48] > 200).any()


def test_edges_are_kept_sharp():
    """Between near and far nothing is put at a depth of its own: two surfaces, and no third."""
    image = np.where(np.arange(120) < 61, 250, 20).astype(np.uint8) * np.ones((9, 1), np.uint8)
    depth = np.where(np.arange(120) < 60, 1.0, 0.0) * np.ones((9, 1))
    view = stereo_view(image, depth, max_disparity=20, limit=1.0, screen_depth=np.inf, crop=False)
    assert (view[4, :40] > 240).all() and (view[4, 43:] < 30).all()


def test_half_of_a_small_picture_is_kept():
    """However far a picture moves, its border takes no more than half of it."""
    image = np.tile(np.arange(64, dtype=np.uint8) * 4, (32, 1))
    depth = np.ones(image.shape)
    view = stereo_view(image, depth, eye=0, max_disparity=60, limit=1.0).astype(int)
    assert view[16, 0] == pytest.approx(64, abs=8) and view[16, -1] == pytest.approx(188, abs=8)


def test_sizes_must_agree():
    with pytest.raises(ValueError, match=r"inverse_depth is \(3, 5\) but image is \(3, 4\)"):
        stereo_view(np.ones((3, 4)), np.ones((3, 5)))
