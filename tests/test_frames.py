"""Frames in: what counts as a pair of images, and its grey levels on the 8-bit scale."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import tisfm
from tisfm.frames import grey_pair, to_eight_bit
from tisfm.sources import FrameSource

SIZE = (24, 40)
ROUNDING = 4 * np.finfo(np.float32).eps  # three products and two sums


def textured_pair(size=SIZE, seed=0):
    """Two 8-bit frames of a texture that moves by one pixel."""
    height, width = size
    noise = np.random.default_rng(seed).uniform(0, 255, (height, width + 1)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    texture = texture.astype(np.uint8)
    return texture[:, 1:].copy(), texture[:, :-1].copy()


# Grey levels


@given(frame=arrays(np.uint8, (5, 7)))
def test_uint8_is_unchanged(frame):
    grey0, grey1 = grey_pair(frame, 255 - frame)
    assert grey0.dtype == grey1.dtype == np.float32
    np.testing.assert_array_equal(grey0, frame)
    np.testing.assert_array_equal(grey1, 255 - frame.astype(np.float32))


@given(frame=arrays(np.uint8, (5, 7)))
def test_uint16_and_uint8_of_one_picture_agree(frame):
    grey0, _ = grey_pair(frame.astype(np.uint16) * 257, frame.astype(np.uint16) * 257)
    np.testing.assert_allclose(grey0, frame, rtol=ROUNDING)


def test_uint16_is_divided_by_257():
    frame = np.full((4, 4), 65535, np.uint16)
    frame[0, 0] = 257
    grey0, grey1 = grey_pair(frame, frame // 2)
    assert grey0[0, 0] == 1 and grey0[1, 1] == 255
    assert grey1[1, 1] == pytest.approx(32767 / 257)


@given(frame=arrays(np.float32, (5, 7), elements=st.floats(0, 1, width=32)))
def test_floats_up_to_one_are_stretched_to_255(frame):
    grey0, grey1 = grey_pair(frame, np.ones_like(frame))
    np.testing.assert_array_equal(grey0, frame * np.float32(255))
    assert (grey1 == 255).all()


@pytest.mark.parametrize(
    ("outlier", "factor"),
    [
        *((value, 255) for value in (1.001, -0.001, 1.6, -0.51, 3.0, 11.0)),
        *((value, 1) for value in (11.5, -10.5, 200.0)),  # more than a thousandth of so few pixels
    ],
)
@pytest.mark.parametrize("second", [False, True])
def test_one_factor_serves_both_frames(outlier, factor, second):
    pair = [np.full(SIZE, 0.5), np.full(SIZE, 0.25)]
    pair[second][3, 5] = outlier
    grey0, grey1 = grey_pair(*pair)
    assert grey0[0, 0] == 0.5 * factor and grey1[0, 0] == 0.25 * factor
    assert pair[second][3, 5] == outlier


@pytest.mark.parametrize(("value", "most"), [(0.2, 0.2), (0.9, 0.2), (1.1, 0.01), (11.0, 0.001)])
@pytest.mark.parametrize("more", [False, True])
@pytest.mark.parametrize("above", [False, True])
def test_overshoots_are_few(value, most, more, above):
    frame = np.full((50, 40), 0.5, np.float32)
    frame.ravel()[: round(most * frame.size) + more] = 1 + value if above else -value
    stretched = grey_pair(frame, np.full_like(frame, 0.5))[1][0, 0] > 1
    assert stretched != more


@pytest.mark.parametrize("outlier", [1.6, -0.51, 40.0, 255.0, -1e6, 1e6])
def test_a_single_pixel_does_not_decide(outlier):
    pair = [frame.astype(np.float32) / 255 for frame in textured_pair((96, 128))]
    pair[0][2, 3] = outlier
    assert np.ptp(grey_pair(*pair)[1]) > 200
    assert len(np.unique(to_eight_bit(*pair))) > 100


def test_a_sharpened_frame_has_the_scale_of_the_one_before():
    frame = textured_pair()[0].astype(np.float32) / 255
    edges = frame - cv2.GaussianBlur(frame, (0, 0), 2)
    sharp = frame + 2.4 * edges
    beyond = ((sharp < -0.01) | (sharp > 1.01)).mean()
    assert 0.12 < beyond < 0.2
    np.testing.assert_array_equal(grey_pair(sharp, frame)[0], sharp * np.float32(255))


@pytest.mark.parametrize(("spots", "factor"), [(12, 255), (13, 1), (123, 1)])
def test_black_frames_with_bright_spots(spots, factor):
    """On the scale of 8 bits, which nobody can tell where the spots are few."""
    rng = np.random.default_rng(0)
    frame = rng.integers(0, 2, (96, 128)).astype(np.float32)
    frame.ravel()[rng.permutation(frame.size)[:spots]] = 200
    np.testing.assert_array_equal(grey_pair(frame, frame)[0], frame * np.float32(factor))


@pytest.mark.parametrize("scale", [20, 60, 200])
def test_nights_on_the_scale_of_8_bits_stay_as_they_are(scale):
    """Ten of a hundred pixels lit, the others nearly black."""
    frame = textured_pair((96, 128))[0] / 255
    night = np.maximum(frame - np.quantile(frame, 0.9), 0)
    night = (night * scale / night.max()).astype(np.float32)
    np.testing.assert_array_equal(grey_pair(night, night)[0], night)


@pytest.mark.parametrize(
    "interpolation", [cv2.INTER_CUBIC, cv2.INTER_LANCZOS4], ids=["cubic", "lanczos"]
)
@pytest.mark.parametrize("size", [(37, 61), (20, 34)])
def test_resampling_a_frame_does_not_change_its_scale(interpolation, size):
    black_and_white = (np.random.default_rng(0).uniform(size=SIZE) < 0.2).astype(np.float32)
    steps = cv2.resize(black_and_white, size[::-1], interpolation=cv2.INTER_NEAREST)
    smooth = cv2.GaussianBlur(steps, (0, 0), 1)
    frame = cv2.resize(smooth, (97, 71), interpolation=interpolation)
    frame[0, 0], frame[0, 1] = 1.01, -0.01  # whatever the interpolation left
    np.testing.assert_array_equal(grey_pair(frame, frame)[0], frame * np.float32(255))


def test_rounding_beyond_one_is_no_overshoot():
    frame = np.full(SIZE, 1 + 1e-6)
    frame[::2] = 0
    assert grey_pair(frame, frame)[0].max() > 200


@pytest.mark.parametrize("most", [1.6, 2, 3])
def test_dark_frames_on_the_scale_of_8_bits_stay_dark(most):
    frame = np.random.default_rng(0).uniform(0, most, SIZE).astype(np.float32)
    np.testing.assert_array_equal(grey_pair(frame, frame)[0], frame)
    counted = np.minimum(np.floor(2 * frame), 3)  # 0 to 3
    np.testing.assert_array_equal(grey_pair(counted, counted)[1], counted)


def test_the_scale_may_be_known_from_other_frames():
    frame = np.full(SIZE, 0.5)
    assert grey_pair(frame, frame, scales_unit_range=False)[0][0, 0] == 0.5
    assert to_eight_bit(frame, frame)[0, 0] == 128
    assert to_eight_bit(frame, frame, scales_unit_range=False)[0, 0] == 0


@pytest.mark.parametrize("black", [1, 2])
def test_dark_pairs_of_a_sequence_have_the_scale_of_those_before(black):
    bright = textured_pair()[0].astype(np.float32)
    frames = [bright, bright, *[bright / 255] * (1 + black)]
    pairs = list(FrameSource(frames))
    assert [pair.scales_unit_range for pair in pairs] == [False] * (2 + black)
    *_, last = tisfm.interpret_sequence(frames, settings=tisfm.Settings.preset("fast"))
    assert last.frame.max() <= 1
    *_, last = tisfm.interpret_sequence([bright / 255] * 2, settings=tisfm.Settings.preset("fast"))
    assert last.frame.max() == 255


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble])
def test_floats_beyond_one_stay_as_they_are(dtype):
    frame = np.linspace(-20, 300, 960).reshape(SIZE).astype(dtype)
    np.testing.assert_array_equal(grey_pair(frame, frame)[0], frame.astype(np.float32))


@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 255), (np.uint16, 65535), (float, 1.0)])
@pytest.mark.parametrize(("channel", "share"), [(0, 0.299), (1, 0.587), (2, 0.114)])
def test_channels_are_red_green_blue(dtype, white, channel, share):
    frame = np.zeros((*SIZE, 3), dtype)
    frame[..., channel] = white
    grey0, _ = grey_pair(frame, frame)
    assert grey0.shape == SIZE
    np.testing.assert_allclose(grey0, 255 * share, rtol=1e-6)


@given(frame=arrays(np.uint8, (5, 7)))
def test_grey_as_three_channels_is_grey(frame):
    colour = np.dstack([frame] * 3)
    np.testing.assert_allclose(grey_pair(colour, colour)[0], frame, rtol=ROUNDING)


@pytest.mark.parametrize("height", [4, 32, 33, 100])
def test_colours_add_up_in_one_order_at_any_size(height):
    frame = np.random.default_rng(height).integers(0, 256, (height, 9, 3)).astype(np.uint8)
    red, green, blue = np.moveaxis(frame.astype(np.float32), -1, 0)
    luma = np.float32(0.299) * red + np.float32(0.587) * green + np.float32(0.114) * blue
    for frames in ((frame, frame), (frame[::-1], frame), (frame.astype(float), frame * 1.0)):
        expected = luma[::-1] if frames[0].strides[0] < 0 else luma
        np.testing.assert_array_equal(grey_pair(*frames)[0], expected)


def test_a_single_channel_is_dropped():
    frame0, frame1 = textured_pair()
    np.testing.assert_array_equal(grey_pair(frame0[..., None], frame1[..., None])[0], frame0)
    assert tisfm.interpret(frame0[..., None], frame1).frame.shape == SIZE


def test_floats_of_two_widths_make_a_pair():
    frame0, frame1 = (frame / 255 for frame in textured_pair())
    grey0, grey1 = grey_pair(frame0.astype(np.float32), frame1)
    assert grey0.max() > 1 and grey1.max() > 1


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_grey_levels_are_never_views(dtype, channels):
    frame = np.full((*SIZE, *channels), 7, dtype)
    for grey in (*grey_pair(frame, frame), to_eight_bit(frame, frame)):
        assert not np.shares_memory(grey, frame)
        assert grey.flags.c_contiguous


def test_lists_are_arrays():
    rows = [[0.0, 0.5, 1.0, 0.25]] * 4
    assert grey_pair(rows, rows)[0][0, 1] == 127.5


# The picture kept with the result


@pytest.mark.parametrize(
    ("frame0", "frame1", "shown"),
    [
        (np.uint8(17), np.uint8(3), 17),
        (np.uint16(257 * 17), np.uint16(3), 17),
        (0.5, 1.0, 128),
        (0.5, 2.0, 0),  # not ×255: the pair is not within [0, 1]
        (300.0, 2.0, 255),
        (-3.0, 2.0, 0),
    ],
)
def test_the_picture_has_the_pairs_factor(frame0, frame1, shown):
    picture = to_eight_bit(np.full(SIZE, frame0), np.full(SIZE, frame1))
    assert picture.dtype == np.uint8
    assert (picture == shown).all()


def test_the_picture_of_a_dark_frame_stays_dark():
    """Frame 0 alone would pass for one in [0, 1]; the pair does not."""
    frame0, frame1 = (frame.astype(float) for frame in textured_pair())
    assert tisfm.interpret(frame0 / 255, frame1).frame.max() == 1


def test_the_picture_keeps_its_colours():
    frame0 = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), dtype=np.uint8)
    np.testing.assert_array_equal(tisfm.interpret(frame0, frame0).frame, frame0)


# Refusals


def refused(error, frame0, frame1, *words):
    """Check that interpret refuses a pair in one line that holds these words."""
    with pytest.raises(error) as caught:
        tisfm.interpret(frame0, frame1)
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text


def test_sizes_that_differ_are_both_named():
    refused(ValueError, np.zeros((24, 40)), np.zeros((24, 41)), "(24, 40)", "(24, 41)", "same size")
    refused(ValueError, np.zeros((24, 40)), np.zeros((24, 40, 3)), "(24, 40)", "(24, 40, 3)")


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (40, 3), (0, 0), (0, 40), (40, 0), (3, 40, 3)])
def test_small_frames_are_refused(size):
    height, width = size[:2]
    refused(ValueError, np.zeros(size), np.zeros(size), "frame0", f"{height} × {width} px", "4 × 4")


def test_four_by_four_is_enough():
    frame0, frame1 = textured_pair((4, 4))
    assert np.isfinite(tisfm.interpret(frame0, frame1).rho).all()


@pytest.mark.parametrize(
    "shape", [(), (40,), (24, 40, 2), (24, 40, 4), (2, 24, 40), (1, 24, 40, 3)], ids=str
)
def test_other_shapes_are_refused(shape):
    refused(ValueError, np.zeros(shape), np.zeros(shape), str(shape), "(H, W)", "(H, W, 3)")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("second", [False, True])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_pixels_that_are_no_numbers_are_counted(value, second, channels):
    pair = [np.zeros((*SIZE, *channels)) for _ in range(2)]
    pair[second][5, 7] = value
    count = 3 if channels else 1
    refused(
        ValueError, *pair, f"frame{int(second)}", f"at {count} of", "NaN or infinite", "replace"
    )


@pytest.mark.parametrize("second", [False, True])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_masked_pixels_are_counted(second, channels):
    pair = [np.ma.masked_array(np.ones((*SIZE, *channels))) for _ in range(2)]
    grey_pair(*pair)  # with nothing masked
    pair[second][2, 3] = np.ma.masked
    values = 3 if channels else 1
    words = f"frame{int(second)} has {values} of {960 * values} values masked.*filled"
    with pytest.raises(ValueError, match=words):
        tisfm.interpret(*pair)
    with pytest.raises(ValueError, match=words):
        next(iter(tisfm.interpret_sequence(pair)))
    with pytest.raises(ValueError, match="frame has"):
        tisfm.lens.undistort(pair[second], tisfm.Camera())


def test_floats_too_large_for_single_precision_are_refused():
    for value in (1e300, 3e38, -3e38):
        refused(ValueError, np.full(SIZE, value), np.zeros(SIZE), "too large for float32", "scale")


@pytest.mark.parametrize("dtype", [bool, np.int8, np.int32, np.int64, np.uint32, complex, object])
def test_other_types_are_refused(dtype):
    name = str(np.dtype(dtype))
    frame = np.zeros(SIZE, dtype)
    refused(TypeError, frame, frame, "frame0", name, "expected uint8, uint16 or float", "convert")


def test_text_is_no_frame():
    refused(TypeError, "a.png", "b.png", "frame0 is the path 'a.png'", "read_image")
    refused(TypeError, np.zeros(SIZE), Path("b.png"), "frame1 is the path 'b.png'")


def test_none_is_no_frame():
    refused(TypeError, None, None, "frame0", "object")


def test_ragged_rows_are_no_frame():
    refused(ValueError, [[1.0, 2.0], [3.0]], [[1.0]], "frame0 is not an array")


@pytest.mark.parametrize(
    ("type0", "type1"), [(np.uint8, np.uint16), (np.uint8, float), (np.float32, np.uint16)]
)
def test_types_that_differ_are_both_named(type0, type1):
    names = (str(np.dtype(type0)), str(np.dtype(type1)))
    refused(TypeError, np.zeros(SIZE, type0), np.zeros(SIZE, type1), *names, "same type")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": 600.0}, "expected a tisfm.Camera"),
        ({"settings": "accurate"}, "expected a tisfm.Settings"),
        ({"pose": np.eye(4)}, "pose is given"),
    ],
)
def test_other_arguments_of_the_wrong_kind_are_refused(changes, words):
    with pytest.raises((TypeError, ValueError), match=re.escape(words)):
        tisfm.interpret(*textured_pair(), **changes)
