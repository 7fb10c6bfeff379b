"""ST maps: what a compositor makes of them."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tisfm
from tests.exports.test_depths import exr_channels
from tests.trajectory.paths import PATIENT
from tisfm.exports import write_undistortion
from tisfm.exports.undistortion import st_maps
from tisfm.lens import undistort

SHAPE = (61, 90)
BARREL = tisfm.Camera(80.0, center=(47.0, 28.0), distortion=(-0.25, 0.05, 0.002, -0.001))
PINCUSHION = tisfm.Camera(80.0, distortion=(0.2, 0.0, 0.0, 0.0))
OBLONG = tisfm.Camera((70.0, 90.0), distortion=(-0.1, 0.0, 0.0, 0.0))
cameras = pytest.mark.parametrize("camera", [BARREL, PINCUSHION, OBLONG])


def smooth(shape):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.float32(120 + 60 * np.sin(0.15 * x) * np.cos(0.11 * y) + x)


def as_a_compositor(picture, places):
    """Return the picture that an ST map makes of another, by the rule that Nuke states.

    The picture reaches from 0 to 1 in both directions, from its lower left corner on.
    """
    height, width = picture.shape
    column = places[..., 0] * width - 0.5
    row = (1 - places[..., 1]) * height - 0.5
    return cv2.remap(picture, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


@cameras
def test_undistortion_equals_that_of_the_library(camera):
    frame = smooth(SHAPE)
    places = st_maps(camera, SHAPE)[0]
    inside = places[..., 2] > 0
    inside = cv2.erode(inside.astype(np.uint8), np.ones((5, 5))) > 0
    expected = undistort(frame, camera)
    found = as_a_compositor(frame, places)
    assert inside.mean() > 0.6
    # OpenCV looks up to a 32nd of a pixel; grey levels change by up to 10 from one to the next.
    assert np.abs(found - expected)[inside].max() < 1
    shifted = as_a_compositor(frame, places + np.float32([0.5 / SHAPE[1], 0, 0]))
    assert np.abs(shifted - expected)[inside].max() > 3  # half a pixel would be seen


@cameras
def test_one_undoes_the_other(camera):
    height, width = SHAPE
    undo, redo = st_maps(camera, SHAPE)
    column = redo[..., 0] * width - 0.5
    row = (1 - redo[..., 1]) * height - 0.5
    known = redo[..., 2] > 0
    channels = [cv2.remap(undo[..., k], column, row, cv2.INTER_LINEAR) for k in range(3)]
    whole = known & (channels[2] > 0.9999)
    y, x = np.mgrid[:height, :width]
    assert whole.mean() > 0.6
    np.testing.assert_allclose((channels[0] * width - 0.5)[whole], x[whole], atol=0.03)
    np.testing.assert_allclose(((1 - channels[1]) * height - 0.5)[whole], y[whole], atol=0.03)


def test_no_distortion_would_map_each_pixel_to_itself():
    nearly = tisfm.Camera(80.0, distortion=(1e-12, 0.0, 0.0, 0.0))
    for places in st_maps(nearly, (2, 4)):
        np.testing.assert_allclose(places[0, 0], [0.5 / 4, 1 - 0.5 / 2, 1], atol=1e-6)
        np.testing.assert_allclose(places[1, 3], [3.5 / 4, 0.5 / 2, 1], atol=1e-6)


@PATIENT
@given(
    focal=st.floats(60, 200),
    bend=st.one_of(st.floats(-0.25, -0.01), st.floats(0.01, 0.2)),
    tangential=st.tuples(st.floats(-0.005, 0.005), st.floats(-0.005, 0.005)),
    off=st.tuples(st.floats(-4, 4), st.floats(-4, 4)),
    shape=st.tuples(st.integers(20, 41), st.integers(20, 41)),
)
def test_undistortion_inverts_distortion(tmp_path_factory, focal, bend, tangential, off, shape):
    height, width = shape
    center = (width - 1) / 2 + off[0], (height - 1) / 2 + off[1]
    camera = tisfm.Camera(focal, center=center, distortion=(bend, 0.0, *tangential))
    place = tmp_path_factory.mktemp("maps")
    files = write_undistortion(camera, shape, place, suffix="tiff")
    undo, redo = (cv2.imread(str(file), cv2.IMREAD_UNCHANGED)[..., ::-1] for file in files)
    for found, places in zip((undo, redo), st_maps(camera, shape), strict=True):
        np.testing.assert_array_equal(found, places)
    # Where a pixel without distortion is taken from, the other map leads back to that pixel.
    # OpenCV looks up to a 32nd of a pixel.
    valid = undo[..., 2] > 0
    column, row = undo[..., 0] * width - 0.5, (1 - undo[..., 1]) * height - 0.5
    back = [cv2.remap(redo[..., k], column, row, cv2.INTER_LINEAR) for k in range(3)]
    valid &= back[2] > 0.999
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    assert np.abs(back[0] * width - 0.5 - x)[valid].max(initial=0) < 0.12
    assert np.abs((1 - back[1]) * height - 0.5 - y)[valid].max(initial=0) < 0.12


def test_pixels_where_a_strong_lens_folds_are_left_out():
    strong = tisfm.Camera(60.0, distortion=(-0.6, 0.0, 0.0, 0.0))
    for places in st_maps(strong, SHAPE):
        none = places[..., 2] == 0
        assert 0 < none.mean() < 0.9 and np.isfinite(places).all()
        assert (places[none, :2] == -1).all()
        within = places[~none]
        assert within.min() >= -1e-6 and within.max() <= 1 + 1e-6


def test_files_hold_the_maps(tmp_path):
    names = [file.name for file in write_undistortion(BARREL, SHAPE, tmp_path, suffix="tiff")]
    assert names == ["undistort.tiff", "redistort.tiff"]
    maps = st_maps(BARREL, SHAPE)
    for name, places in zip(names, maps, strict=True):
        found = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(found[..., ::-1], places)
    pytest.importorskip("OpenEXR")
    for file, places in zip(write_undistortion(BARREL, SHAPE, tmp_path), maps, strict=True):
        found = exr_channels(file)
        np.testing.assert_array_equal(np.stack([found[c] for c in "RGB"], axis=-1), places)


def test_ffmpeg_reads_the_map(tmp_path):
    """A reader of EXR that is not the writer's."""
    av = pytest.importorskip("av")
    pytest.importorskip("OpenEXR")
    file = write_undistortion(BARREL, SHAPE, tmp_path)[0]
    try:
        with av.open(str(file)) as container:
            frame = next(container.decode(video=0))
    except av.FFmpegError as error:
        pytest.skip(f"this FFmpeg does not read EXR: {error}")
    planes = {}
    for name, plane in zip("GBR", frame.planes, strict=True):
        values = np.frombuffer(plane, "<f4").reshape(frame.height, -1)[:, : frame.width]
        planes[name] = values
    found = np.stack([planes[c] for c in "RGB"], axis=-1)
    # FFmpeg takes what is negative for 0.
    np.testing.assert_allclose(found, np.maximum(st_maps(BARREL, SHAPE)[0], 0), atol=1e-6)


def test_a_lens_that_does_not_distort_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no distortion"):
        write_undistortion(tisfm.Camera(80.0), SHAPE, tmp_path)
    assert not list(tmp_path.iterdir())
