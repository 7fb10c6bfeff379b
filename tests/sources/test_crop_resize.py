"""Crop and size: the pixels, and the camera that belongs to them."""

import numpy as np
import pytest

import tisfm
from tests.sources.made import FRAMES, QUICK, H, W
from tisfm.sources import FrameSource
from tisfm.sources.crop_resize import CropResize

DISTORTED = tisfm.Camera((50.0, 60.0), center=(20.5, 11.0), distortion=(-0.1, 0.02, 0, 0))


def images(source, **options):
    return [frame.image for frame in FrameSource(source, **options).frames()]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float16, np.float32, np.float64])
@pytest.mark.parametrize("colour", [False, True])
def test_a_crop_is_that_part(kind, colour):
    frames = [np.dstack([f, f // 2, f // 3]) if colour else f for f in FRAMES[:3]]
    frames = [frame.astype(kind) for frame in frames]
    for found, frame in zip(images(frames, crop=(5, 3, 20, 11)), frames, strict=True):
        assert found.dtype == kind and found.flags.c_contiguous
        np.testing.assert_array_equal(found, frame[3:14, 5:25])


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float16, np.float32, np.float64])
def test_half_the_size_is_the_mean_of_four_pixels(kind):
    frames = [np.dstack([f, f // 2, f // 3]).astype(kind) for f in FRAMES[:2]]
    for found, frame in zip(images(frames, size=W // 2), frames, strict=True):
        mean = frame.astype(np.float64).reshape(H // 2, 2, W // 2, 2, 3).mean((1, 3))
        assert found.dtype == kind and found.shape == mean.shape
        whole = np.issubdtype(kind, np.integer)
        bound = 0.5 if whole else 256 * np.finfo(kind).eps  # of rounding
        assert np.abs(found - mean).max() <= bound


def test_half_the_size_ignores_four_pixels_if_any_is_ignored():
    ignored = np.zeros((H, W), bool)
    ignored[5, 7] = ignored[8:10, 2:4] = True
    found = CropResize(size=W // 2).apply_to_mask(ignored, "frame")
    np.testing.assert_array_equal(found, ignored.reshape(H // 2, 2, W // 2, 2).any((1, 3)))


@pytest.mark.parametrize("size", [W, W + 1, 1000])
def test_smaller_frames_are_unchanged(size):
    for found, frame in zip(images(FRAMES, size=size), FRAMES, strict=True):
        np.testing.assert_array_equal(found, frame)


@pytest.mark.parametrize(
    "options",
    [{"size": 20}, {"size": 33}, {"size": 7, "crop": (0, 0, 24, 24)},
     {"crop": (7, 2, 30, 20)}, {"crop": (7, 2, 30, 20), "size": 17}],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("camera", [tisfm.Camera(50.0), DISTORTED], ids=["pinhole", "distorted"])
def test_the_camera_follows(options, camera):
    """A ray falls on the same thing: the frames are ramps of their own coordinates."""
    y, x = np.mgrid[:H, :W].astype(np.float64)
    (found_x, found_y) = images([x, y], **options)
    after = FrameSource([x, y], **options).camera_after(camera, (H, W))
    (fx, fy), (cx, cy) = camera.focals, camera.center_for(H, W)
    (new_fx, new_fy), (new_cx, new_cy) = after.focals, after.center
    height, width = found_x.shape
    rows, columns = np.mgrid[:height, :width]
    ray_x, ray_y = (columns - new_cx) / new_fx, (rows - new_cy) / new_fy
    inner = np.s_[: height - 1, : width - 1]  # the last ones are of fewer pixels
    # A mean over parts of pixels is off the middle by an eighth of one at most.
    np.testing.assert_allclose((ray_x * fx + cx)[inner], found_x[inner], atol=0.125)
    np.testing.assert_allclose((ray_y * fy + cy)[inner], found_y[inner], atol=0.125)
    assert after.distortion == camera.distortion
    assert after.aspect == pytest.approx(camera.aspect)


def test_without_crop_and_size_the_camera_is_the_same():
    camera = tisfm.Camera(50.0)
    source = FrameSource(FRAMES)
    assert next(source.frames()).full_shape is None
    assert source.camera_after(camera, None) is camera


def test_the_size_of_frames_is_known_before_reading():
    source = FrameSource(FRAMES, crop=(1, 2, 10, 8), size=5)
    assert {frame.full_shape for frame in source.frames()} == {(H, W)}
    assert {pair.full_shape for pair in source} == {(H, W)}
    assert {pair.frame1.shape for pair in source} == {(4, 5)}


@pytest.mark.parametrize("motion", ["field", "camera"])
@pytest.mark.parametrize("camera", [tisfm.Camera(50.0), None], ids=["given", "unknown"])
@pytest.mark.filterwarnings("ignore::tisfm.focal_guess.GuessedFocalWarning")
def test_a_sequence_is_that_of_the_smaller_frames(motion, camera):
    options = {"crop": (4, 2, 32, 20), "size": 16}
    settings = tisfm.Settings(motion=motion, warps=1, outer_iterations=1, sweeps=2)
    known = camera or tisfm.Camera(600.0 if motion == "field" else 1.2 * W)
    after = CropResize(**options).camera_after(known, H, W)
    assert after.focal == known.focal / 2
    results = tisfm.interpret_sequence(FRAMES[:3], camera=camera, settings=settings, **options)
    small = images(FRAMES[:3], **options)
    for result, frame0, frame1 in zip(results, small, small[1:], strict=False):
        expected = tisfm.interpret(frame0, frame1, camera=after, settings=settings)
        np.testing.assert_array_equal(result.rho, expected.rho)
        assert result.camera == after


def test_inputs_are_not_modified():
    frames = [frame.copy() for frame in FRAMES]
    for image in images(frames, crop=(1, 1, 20, 20)):
        image[:] = 0
    np.testing.assert_array_equal(frames, FRAMES)


@pytest.mark.parametrize("size", [0, -1, 3, 2.5, "40", True, (40, 30)], ids=repr)
def test_wrong_sizes_are_refused(size):
    with pytest.raises(ValueError, match=r"size is .*: expected the longer side"):
        tisfm.interpret_sequence(FRAMES, size=size)


@pytest.mark.parametrize(
    "crop", [5, (1, 2, 3), (0, 0, 10, 10.0), (-1, 0, 10, 10), (0, 0, 3, 10), "0010", (0, 0, 10, 0)],
    ids=repr,
)  # fmt: skip
def test_wrong_crops_are_refused(crop):
    with pytest.raises(ValueError, match=r"crop is .*\(left, top, width, height\)"):
        tisfm.interpret_sequence(FRAMES, crop=crop)


@pytest.mark.parametrize("crop", [(21, 0, 20, 10), (0, 15, 10, 10), (100, 100, 4, 4)], ids=str)
def test_a_crop_beyond_a_later_frame_is_an_error(crop):
    results = tisfm.interpret_sequence(FRAMES, crop=crop, settings=QUICK)
    with pytest.raises(ValueError, match="frame_000000 is 40 px wide and 24 px high"):
        next(results)


def test_a_size_that_leaves_too_little_of_the_shorter_side():
    frames = [np.zeros((10, 200), np.uint8)] * 2
    with pytest.raises(ValueError, match="size is 40, which leaves less than 4 px"):
        next(FrameSource(frames, size=40).frames())


def test_wrong_arrays_are_refused_before_they_are_cropped():
    bad = FRAMES[0].astype(float)
    bad[0, 0] = np.nan
    with pytest.raises(ValueError, match="frame_000001 is NaN"):
        list(FrameSource([FRAMES[0].astype(float), bad], size=20))


def test_frames_of_different_sizes_are_refused_though_cropped_alike():
    frames = [FRAMES[0], FRAMES[1][:, :-1]]
    with pytest.raises(ValueError, match=r"frames frame_000000 and frame_000001: .*\(24, 39\)"):
        list(FrameSource(frames, crop=(0, 0, 10, 10)))
