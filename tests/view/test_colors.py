"""Colours, legends, pictures, texts."""

from dataclasses import replace

import numpy as np
import pytest

from tests.view.test_cloud import made
from tisfm.grade import Grade
from tisfm.results.result_frames import FrameCache
from tisfm.show import label_colors
from tisfm.status import Status
from tisfm.view.colors import (
    KINDS,
    QUANTITIES,
    Ranges,
    caption,
    legend,
    picture_of,
    pixel_colors,
    ranges_of,
    sample_frames,
)
from tisfm.view.html_texts import distance_html, legend_html, reading_html, status_html

RANGES = Ranges(inverse_depth=2.0, flow=3.0)
GREY = [200, 200, 200]


def full(**parts):
    """A frame with everything, of which a pixel has no depth and one no deviation."""
    inverse = np.linspace(0.5, 2, 48).reshape(6, 8).astype(np.float32)
    inverse[0, 0] = np.nan
    deviation = 0.1 * inverse
    deviation[0, 0] = deviation[1, 1] = np.inf
    labels = np.zeros((6, 8), np.int32)
    labels[3:] = 1
    given = {
        "inverse_depth_std": deviation,
        "confidence": np.linspace(0, 1, 48).reshape(6, 8).astype(np.float32),
        "labels": labels,
        "stored_flow": np.full((6, 8, 2), 1.0, np.float32),
    }
    return made(inverse, **{**given, **parts})


def test_unknown_values_are_grey():
    frame = full()
    assert pixel_colors(frame, "depth", RANGES)[0, 0].tolist() == GREY
    deviation = pixel_colors(frame, "deviation", RANGES)
    assert deviation[0, 0].tolist() == deviation[1, 1].tolist() == GREY
    assert deviation[2, 2].tolist() != GREY
    bare = made(np.ones((6, 8)))
    for quantity in ("confidence", "deviation", "object"):
        assert (pixel_colors(bare, quantity, RANGES) == 200).all()


@pytest.mark.parametrize("quantity", ["depth", "confidence"])
def test_brightness_grows_with_the_quantity(quantity):
    colors = pixel_colors(full(), quantity, RANGES).reshape(-1, 3)[1:].astype(float)
    light = colors @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(light) > -2).all() and light[-1] > light[0] + 80


def test_depth_has_one_range_whatever_the_scale_of_a_frame():
    frame = full()
    twice = replace(frame, inverse_depth=2 * frame.inverse_depth, scale=2.0)
    np.testing.assert_array_equal(
        pixel_colors(frame, "depth", RANGES), pixel_colors(twice, "depth", RANGES)
    )


def test_objects_differ_in_colour_and_keep_it():
    colors = label_colors(12)
    assert len({tuple(color) for color in colors}) == 12
    np.testing.assert_array_equal(label_colors(4), colors[:4])
    shown = pixel_colors(full(), "object", RANGES)
    assert (np.ptp(shown[0], axis=1) == 0).all()  # at rest: grey levels
    assert (np.ptp(shown[4], axis=1) > 0).all()


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_legends_state_the_meaning_of_colours(quantity):
    found = legend(quantity, RANGES, "the unit", (1, 3))
    text = legend_html(found)
    if quantity == "image":
        assert found is None and text == ""
    elif quantity == "object":
        assert "object 3" in text and len(found.colors) == 3
    else:
        assert "linear-gradient" in text
        assert all(tick in text for tick in found.ticks)
    if quantity == "depth":
        assert found.ticks == ("∞", "1", "0.5") and "the unit" in text


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_have_the_requested_width(kind):
    assert picture_of(full(), kind, RANGES, width=4).shape == (3, 4, 3)
    plain = picture_of(full(), kind, RANGES, width=15)
    marked = picture_of(full(), kind, RANGES, width=15, marked_pixel=(2, 3))
    assert plain.shape == marked.shape == (6, 8, 3) and plain.dtype == np.uint8
    assert (plain != marked).any()
    large = picture_of(full(), kind, RANGES, width=20)
    np.testing.assert_array_equal(large[::2, ::2], plain)
    assert large.shape == (12, 16, 3)


def test_captions_have_units():
    assert "full colour at 3 px" in caption("flow", RANGES)
    assert "depth of 0.5" in caption("depth", RANGES)
    assert caption("frame", RANGES) == ""


def test_ranges_are_those_of_the_middle_frame():
    frames = [full(), full(scale=0.5), full(scale=0.25)]
    assert ranges_of(frames).inverse_depth == pytest.approx(2 * 1.92, rel=0.02)
    assert ranges_of(frames).flow == pytest.approx(2**0.5)
    assert ranges_of([]) == Ranges(inverse_depth=1.0, flow=1.0)


class Frames:
    """A result of so many frames, which counts how often they are read."""

    focal_note = "the result depends on <it>"

    def __init__(self, count):
        self.names, self.read_ones = [f"<a>{k}" for k in range(count)], []
        self.grades, self.depth_errors = [Grade.FAIR] * count, [0.05] * count
        self.times, self.has_one_scale, self.piece = [0.5] * count, True, np.full(count, -1)

    def read(self, number):
        if number == 2:
            raise FileNotFoundError("it is gone")
        self.read_ones.append(number)
        return full(number=number)


def test_few_frames_are_kept():
    result = Frames(100)
    size = full().nbytes
    cache = FrameCache(result, max_bytes=3 * size)
    for number in (0, 1, 3, 0, 4, 5):
        assert cache[number].number == number
    assert len(cache) == 3 and cache.nbytes <= 3 * size
    assert result.read_ones == [0, 1, 3, 4, 5]
    assert cache[0].number == 0 and result.read_ones[-1] == 5  # it was used since
    tiny = FrameCache(result, max_bytes=1)
    assert tiny[7].number == 7 and len(tiny) == 1


def test_the_memory_of_a_frame_is_counted():
    frame = full()
    before = frame.nbytes
    assert frame.relative_deviation is not None and frame.flow is not None
    arrays = {id(v): v.nbytes for v in vars(frame).values() if isinstance(v, np.ndarray)}
    assert sum(arrays.values()) <= before == frame.nbytes


def test_frame_data_are_kept_when_earlier_frames_appear():
    result = Frames(5)
    cache = FrameCache(result)
    cache[1]
    result.names.insert(0, "before")
    assert cache[2].number == 2 and result.read_ones == [1]


def test_samples_leave_out_unreadable_frames():
    result = Frames(3)
    assert [frame.number for frame in sample_frames(FrameCache(result), 3)] == [0, 1]


def test_texts_escape_names_and_tell_faults():
    frame = full(status=Status("uncertain", "move <more>"))
    text = status_html(Frames(3), frame, 1)
    assert "&lt;a&gt;1" in text and "move &lt;more&gt;" in text and "no pose" in text
    assert "2 of 3" in text and "0.500 s" in text and "fair, off by 5 %" in text
    assert "depends on &lt;it&gt;" in text
    assert "it is gone" in status_html(Frames(3), None, 1, "it is gone")


def test_a_reading_has_units_and_deviations():
    text = reading_html(full().reading(2, 2), "cubits")
    for part in ("column 2, row 2", "±", "cubits", "px/frame", "confidence", "at rest"):
        assert part in text
    assert "no depth" in reading_html(full().reading(0, 0), "cubits")
    assert "Click" in reading_html(None, "cubits")


def test_distances_are_in_the_unit_of_the_result():
    ends = [np.zeros(3), np.array((0.0, 3, 4))]
    assert "distance 2.5 (cubits)" in distance_html(ends, 2.0, "cubits")
    assert "second" in distance_html(ends[:1], 2.0, "cubits")
