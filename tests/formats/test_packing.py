"""Arrays packed into few bytes."""

import zlib

import hypothesis.extra.numpy as arrays
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from tisfm.formats.packing import SIGNIFICANT_BITS, STEP, Packing, pack, round_as_packed, unpack

SIDES = arrays.array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9)
FLOAT, FIXED = np.dtype(np.float32), ("int16", "int32")


def again(array, *, row_axis=0, step=None):
    """Return what is unpacked of an array that was packed."""
    stream, packing = pack(array, row_axis=row_axis, step=step)
    kinds = (
        FIXED if packing.integer_type in FIXED and array.dtype == FLOAT else (packing.integer_type,)
    )
    known = Packing.from_json(packing.to_json(), kinds)
    return unpack(stream, known, array.dtype, row_axis=row_axis)


@given(data=st.data(), kind=st.sampled_from(["u1", "<u2", "<i4", "?"]), row_axis=st.integers(0, 1))
def test_whole_numbers_survive_packing(data, kind, row_axis):
    array = data.draw(arrays.arrays(kind, SIDES))
    found = again(array, row_axis=row_axis)
    assert found.dtype == array.dtype and found.flags.writeable
    np.testing.assert_array_equal(found, array)


@given(array=arrays.arrays(FLOAT, SIDES, elements=st.floats(-1e5, 1e5, width=32)))
def test_numbers_are_rounded_to_a_step(array):
    found = again(array, step=STEP)
    largest = np.abs(array).max()
    most = min(STEP, max(2.0**-SIGNIFICANT_BITS * largest, 2.0**-126)) / 2 if largest else 0
    ulp = np.spacing(np.float32(largest)) / 2  # of multiples that need more bits than float32 has
    assert np.abs(found.astype(float) - array).max() <= max(most, ulp)
    np.testing.assert_array_equal(found, round_as_packed(array, STEP))
    np.testing.assert_array_equal(round_as_packed(found, STEP), found)


@pytest.mark.parametrize("largest", [2.0**-3 - 2.0**-17, 2.0**-3 - 2.0**-16, 2.0**-3, 31.99])
def test_rounding_again_changes_nothing_near_a_power_of_two(largest):
    """Where the largest number becomes the next power of two, the step is that of the latter."""
    values = np.random.default_rng(3).uniform(-largest, largest, (40, 50)).astype(np.float32)
    values[7, 9] = largest
    once = round_as_packed(values, STEP)
    np.testing.assert_array_equal(round_as_packed(once, STEP), once)


@given(array=arrays.arrays(FLOAT, SIDES, elements=st.floats(-(2.0**120), 2.0**120, width=32)))
def test_numbers_without_a_step_keep_their_leading_bits(array):
    found = again(array)
    tiny = 2.0**-126  # below it numbers have fewer bits
    assert (np.abs(found - array) <= 2.0**-SIGNIFICANT_BITS * np.maximum(np.abs(array), tiny)).all()
    np.testing.assert_array_equal(np.signbit(found), np.signbit(array))


def test_infinity_is_kept():
    array = np.array([[np.inf, -np.inf, 0.0, -0.0, 1.0]], np.float32)
    found = again(array)
    np.testing.assert_array_equal(found, array)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(array))


@pytest.mark.parametrize(
    ("value", "step"), [(np.nan, STEP), (np.inf, STEP), (2e6, STEP), (3.4e38, None)]
)
def test_values_that_packing_would_change_are_stored_unpacked(value, step):
    array = np.ones((3, 4), np.float32)
    array[1, 2] = value
    assert pack(array, row_axis=0, step=step) is None


def test_noise_is_hardly_larger_when_packed():
    """Values within ±4 steps of a plane: about 3 bits each, and no more than 6."""
    rows, columns = np.mgrid[:200, :300]
    noise = np.random.default_rng(1).integers(-4, 5, rows.shape)
    array = ((0.01 * rows - 0.02 * columns) + noise * STEP).astype(np.float32)
    stream, packing = pack(array, row_axis=0, step=STEP)
    assert packing.integer_type == "int16" and len(stream) < 6 / 8 * array.size


@pytest.mark.parametrize(
    "data",
    [b"", b"garbage", zlib.compress(bytes(11)), zlib.compress(bytes(13)), zlib.compress(b""),
     zlib.compress(bytes(12))[:-1], zlib.compress(bytes(12)) + b"x", zlib.compress(bytes(60)),
     zlib.compress(bytes(36))],
)  # fmt: skip
def test_damaged_streams_are_refused(data):
    packing = Packing(shape=(3, 4), integer_type="int16", step=STEP)
    with pytest.raises(ValueError, match="zlib stream"):
        unpack(np.frombuffer(data, np.uint8), packing, FLOAT, row_axis=0)


@pytest.mark.parametrize(
    "about",
    [None, [], {}, {"shape": [3, 4], "of": "int16"}]
    + [{"shape": shape, "of": "int16", "step": STEP} for shape in ([3, 0], [3, 4.0], 3, [True, 4])]
    + [{"shape": [3, 4], "of": of, "step": STEP} for of in ("int8", [], None)]
    + [{"shape": [3, 4], "of": "int16", "step": step} for step in (None, 0.0, 1e9, np.nan, "1")],
    ids=str,
)
def test_other_packings_are_refused(about):
    with pytest.raises(ValueError, match="pack"):
        Packing.from_json(about, FIXED)


def test_whole_numbers_have_no_step():
    with pytest.raises(ValueError, match="expected none"):
        Packing.from_json({"shape": [3, 4], "of": "uint8", "step": 1.0}, ("uint8",))
