"""The second view: exact shifts, and what hides what. Anaglyphs made of it."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tisfm.show import anaglyph, dubois, second_view, stereo_view
from tisfm.show.anaglyph import _MATRICES

PROPERTY = settings(max_examples=60)


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


def test_holes_show_the_background():
    image = np.arange(1, 13, dtype=np.uint8)[None]
    inverse_depth = np.zeros((1, 12))
    inverse_depth[0, 6:8] = 3.0
    view = second_view(image, inverse_depth, displacement=1.0, fill="behind")
    #       the hole where the near pair stood mirrors 6, 5 on its left and 9, 10 on its right
    assert view.tolist() == [[1, 2, 3, 7, 8, 6, 5, 10, 9, 10, 11, 12]]
    # A step: the near side, on the left, is not stretched into the hole.
    step = np.where(np.arange(12) < 6, 3.0, 0.0)[None]
    view = second_view(image, step, displacement=1.0, fill="behind")
    assert view.tolist() == [[4, 5, 6, 10, 9, 8, 7, 8, 9, 10, 11, 12]]
    assert second_view(image, step, displacement=1.0).tolist() == [
        [4, 5, 6, 6, 6, 7, 7, 8, 9, 10, 11, 12]
    ]
    # What is mirrored is never something nearer: only 7, 8 and 9 are behind.
    gap = np.array([[6.0] * 6 + [0.0] * 3 + [2.0] * 3])
    view = second_view(image, gap, displacement=1.0, fill="behind")
    assert view.tolist() == [[7, 7, 7, 7, 9, 8, 7, 10, 11, 12, 11, 10]]
    with pytest.raises(ValueError, match="fill is 'best', expected nearest or behind"):
        second_view(image, step, displacement=1.0, fill="best")


@PROPERTY
@given(
    shifts=hnp.arrays(
        np.int64,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14),
        elements=st.integers(0, 8),
    )
)
@example(shifts=np.array([[5, 3, 3, 3]]))
def test_only_holes_are_filled_otherwise(shifts):
    """Where something lands both are the same; elsewhere nothing nearer than both sides is put."""
    image = np.arange(shifts.size, dtype=np.uint16).reshape(shifts.shape)
    depth_of = shifts.reshape(-1)
    nearest, behind = (
        second_view(image, shifts / 4, displacement=4.0, fill=fill)
        for fill in ("nearest", "behind")
    )
    differs = nearest != behind
    assert np.array_equal(nearest[~differs], behind[~differs])
    landed = np.zeros(shifts.shape, bool)
    for y, x in np.ndindex(shifts.shape):
        if x >= shifts[y, x]:
            landed[y, x - shifts[y, x]] = True
    assert not (differs & landed).any()
    assert (behind // shifts.shape[1] == np.arange(len(shifts))[:, None]).all()  # of its row
    for y, x in np.argwhere(differs):
        row = landed[y]
        left = [k for k in range(x) if row[k]][-1:]
        right = [k for k in range(x + 1, len(row)) if row[k]][:1]
        sides = [depth_of[nearest[y, k]] for k in (*left, *right)]
        assert depth_of[behind[y, x]] <= max(sides, default=8) + 1


def test_a_stretched_surface_hides_the_background():
    # Near, sloping surface on the right, whose shift falls by 1 every third pixel; far on the left.
    near = 6 - np.arange(12) // 3
    shifts = np.concatenate([np.zeros(8), near])[None]
    image = np.concatenate([np.full(8, 9), np.full(12, 200)])[None].astype(np.uint8)
    view = second_view(image, shifts, displacement=1.0)
    assert (view[0, 2:] == 200).all()


def test_the_second_view_ignores_unknown_depth():
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
def test_a_constant_picture_is_kept(inverse_depth, displacement):
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


def test_the_second_view_names_wrong_arguments():
    with pytest.raises(ValueError, match=r"inverse_depth is \(3, 5\) but image is \(3, 4\)"):
        second_view(np.zeros((3, 4)), np.zeros((3, 5)), displacement=1.0)
    with pytest.raises(ValueError, match=r"image is \(3, 4, 2\), expected"):
        second_view(np.zeros((3, 4, 2)), np.zeros((3, 4)), displacement=1.0)
    with pytest.raises(ValueError, match="displacement is nan"):
        second_view(np.zeros((3, 4)), np.zeros((3, 4)), displacement=np.nan)
    with pytest.raises(TypeError, match="inverse_depth has dtype complex128"):
        second_view(np.zeros((3, 4)), np.zeros((3, 4), complex), displacement=1.0)


@pytest.mark.parametrize("name", ["2009", "crt"])
def test_rows_of_the_matrices_sum_to_one(name):
    left, right = (np.array(matrix) for matrix in _MATRICES[name])
    assert np.abs((left + right).sum(axis=1) - 1).max() <= 0.0011


@pytest.mark.parametrize("linear", [True, False])
@pytest.mark.parametrize("name", ["2009", "crt"])
def test_grey_is_kept(name, linear):
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


def test_anaglyph_is_of_two_eyes():
    image = np.random.default_rng(0).integers(0, 256, (8, 100, 3), dtype=np.uint8)
    depth = np.linspace(0.1, 1, 800).reshape(8, 100)
    given = {"disparity": 0.05, "screen": 0.3, "limit": 0.8, "crop": False}
    left, right = (stereo_view(image, depth, eye=eye, **given) for eye in (0, 1))
    assert np.array_equal(left, image)
    assert np.array_equal(anaglyph(image, depth, **given), dubois(left, right))
    coded = dubois(left, right, matrices="crt", linear=False)
    assert np.array_equal(anaglyph(image, depth, matrices="crt", linear=False, **given), coded)
    for other in (
        {"disparity": 0.1},
        {"max_disparity": 9.0},
        {"screen": 0.9},
        {"screen": None, "screen_depth": 5.0},
        {"limit": 0.4},
        {"crop": True},
    ):
        changed = anaglyph(image, depth, **{**given, **other})
        assert not np.array_equal(changed, dubois(left, right)), other


def test_anaglyph_without_depth_is_flat():
    image = np.random.default_rng(0).integers(0, 256, (8, 30), dtype=np.uint8)
    for value in (0.0, np.nan, -1.0):
        assert np.array_equal(anaglyph(image, np.full((8, 30), value)), dubois(image, image))
