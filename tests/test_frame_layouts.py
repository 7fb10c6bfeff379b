"""Frames of any layout in memory and of any scale: what an interpretation makes of them."""

import numpy as np
import pytest

import tisfm
from tests.pairwise import pairwise
from tests.test_frames import textured_pair

# Memory layouts


def strided(frame):
    wide = np.zeros((2 * frame.shape[0], 3 * frame.shape[1], *frame.shape[2:]), frame.dtype)
    wide[::2, ::3] = frame
    return wide[::2, ::3]


def read_only(frame):
    frame = frame.copy()
    frame.flags.writeable = False
    return frame


LAYOUTS = {
    "Fortran": np.asfortranarray,
    "strided": strided,
    "reversed": lambda frame: frame[::-1, ::-1].copy()[::-1, ::-1],
    "channels first": lambda frame: np.moveaxis(np.moveaxis(frame, -1, 0).copy(), 0, -1),
    "read-only": read_only,
    "big-endian": lambda frame: frame.astype(frame.dtype.newbyteorder(">")),
    "subclass": lambda frame: frame.view(np.recarray),
}


@pairwise(
    layout=list(LAYOUTS),
    dtype=[np.uint8, np.uint16, np.float32, np.float64],
    channels=[1, 3],
    short=True,
)
def test_the_layout_in_memory_does_not_matter(layout, dtype, channels):
    pair = [frame.astype(dtype) for frame in textured_pair()]
    if channels == 3:
        pair = [np.dstack([frame, frame // 2, 255 - frame]) for frame in pair]
    arranged = [LAYOUTS[layout](frame) for frame in pair]
    np.testing.assert_array_equal(arranged[0], pair[0])
    settings = tisfm.Settings(warps=1, outer_iterations=1, sweeps=4)
    plain = tisfm.interpret(*pair, settings=settings)
    result = tisfm.interpret(*arranged, settings=settings)
    assert plain.rho.any()
    np.testing.assert_array_equal(result.rho, plain.rho)
    np.testing.assert_array_equal(result.flow, plain.flow)
    np.testing.assert_array_equal(result.frame, plain.frame)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("channels", [1, 3])
def test_frames_are_not_modified(dtype, channels):
    pair = [frame.astype(dtype) for frame in textured_pair()]
    if channels == 3:
        pair = [np.dstack([frame] * 3) for frame in pair]
    before = [frame.copy() for frame in pair]
    tisfm.interpret(*pair, settings=tisfm.Settings.preset("fast", presmoothing=1.0))
    for frame, copy in zip(pair, before, strict=True):
        np.testing.assert_array_equal(frame, copy)


def test_uint8_float_and_uint16_of_one_pair_agree():
    pair = textured_pair()
    results = [
        tisfm.interpret(*pair),
        tisfm.interpret(*(frame / 255 for frame in pair)),
        tisfm.interpret(*(frame.astype(np.uint16) * 257 for frame in pair)),
        tisfm.interpret(*(frame.astype(np.float64) for frame in pair)),
    ]
    for result in results[1:]:
        # Grey levels agree to a few units in the last place, which the iteration amplifies.
        np.testing.assert_allclose(result.flow, results[0].flow, atol=1e-3)
    np.testing.assert_array_equal(results[3].rho, results[0].rho)


# Frames on no usual scale


@pytest.mark.parametrize("scale", [1e13, 1e18, 1e30])
@pytest.mark.parametrize("preset", ["paper", "balanced"])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_frames_far_off_the_scale_diverge(scale, preset):
    for sign in (1, -1):
        frame0, frame1 = (frame * scale * sign for frame in textured_pair())
        status = tisfm.interpret(frame0, frame1, settings=tisfm.Settings.preset(preset)).status
        assert status == "diverged"
        assert "8-bit scale" in status.message


def test_normalised_constraints_take_any_scale_of_float32_squares():
    frame0, frame1 = textured_pair()
    usual = tisfm.interpret(frame0, frame1)
    far = tisfm.interpret(frame0 * 1e12, frame1 * 1e12)
    assert far.status == "converged"
    np.testing.assert_allclose(far.flow, usual.flow, atol=1e-2)


@pytest.mark.parametrize(
    ("scale", "offset"), [(1e-3, 0.0), (1 / 255, -0.5), (1e-4, 10.0), (100.0, 0.0), (1e12, 0.0)]
)
def test_the_range_of_float_frames_does_not_matter(scale, offset):
    """Nothing but `paper` has a scale of grey levels."""
    frame0, frame1 = textured_pair()
    expected = tisfm.interpret(frame0, frame1).flow
    flow = tisfm.interpret(frame0 * scale + offset, frame1 * scale + offset).flow
    # What float32 leaves of 255 · 1e-4 on 10 is 15 bits.
    assert np.abs(flow - expected).max() < (0.02 if offset == 10.0 else 2e-3)


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_uint16_frames_may_use_any_of_their_bits(bits):
    frames = [frame.astype(np.uint8) for frame in textured_pair()]
    expected = tisfm.interpret(*frames).flow
    deep = [frame.astype(np.uint16) * 2 ** (bits - 8) for frame in frames]
    assert np.abs(tisfm.interpret(*deep).flow - expected).max() < 2e-3


def test_one_outlying_pixel_does_not_change_the_scale():
    """A pixel beyond 1 makes a float frame count as grey levels, and changes nothing else."""
    frame0, frame1 = (frame / 255 for frame in textured_pair())
    frame0[2, 2] = 1.02
    expected = tisfm.interpret(frame0 * 255, frame1 * 255).flow
    assert np.abs(tisfm.interpret(frame0, frame1).flow - expected).max() < 2e-3


@pytest.mark.parametrize("scale", [1e-3, 1.0, 100.0])
def test_frames_near_the_scale_do_not_diverge(scale):
    frame0, frame1 = (frame * scale for frame in textured_pair())
    result = tisfm.interpret(frame0, frame1)
    assert np.isfinite(result.rho).all()
    assert result.status in ("iteration_limit", "converged")


@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_frames_of_any_layout_in_memory(preset):
    rng = np.random.default_rng(3)
    frames = rng.integers(0, 256, (2, 24, 30, 3), dtype=np.uint8)
    settings = tisfm.Settings.preset(preset, outer_iterations=2)
    expected = tisfm.interpret(*frames, settings=settings)
    for lay in (np.asfortranarray, lambda frame: np.rot90(np.rot90(frame, -1).copy())):
        result = tisfm.interpret(*map(lay, frames), settings=settings)
        np.testing.assert_array_equal(result.flow, expected.flow)
