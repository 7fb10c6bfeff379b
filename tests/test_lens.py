"""Distortion of the lens: what a camera accepts, and frames from which it is removed."""

import dataclasses

import cv2
import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.pairwise import pairwise
from tests.rendered import static_scene
from tisfm.camera import Camera
from tisfm.evaluation.pairs import evaluate
from tisfm.interpretation import Interpretation
from tisfm.lens import Undistortion, undistort
from tisfm.metrics import endpoint_error
from tisfm.motion.egomotion import camera_motion
from tisfm.scenes import Scene

BARREL = (-0.25, 0.08, 1e-3, -5e-4)
PINCUSHION = (0.2, 0.05, 0.0, 0.0, 0.0)
FOURTEEN = (0.05, 0.01, 1e-3, 1e-3, 0.01, 0.02, 0.0, 0.0, 1e-3, 0.0, 1e-3, 0.0, 0.01, -0.02)


@pytest.fixture(scope="module")
def scene():
    return static_scene("forward+rotation", 180, 241, dtype="float32")


def model(camera, x, y):
    """OpenCV's model of radial and tangential distortion: from pinhole pixels to the frame's."""
    cx, cy = camera.center
    k1, k2, p1, p2, k3 = (*camera.distortion, 0.0)[:5]
    a, b = (x - cx) / camera.focal, (y - cy) / camera.focal
    square = a**2 + b**2
    radial = 1 + k1 * square + k2 * square**2 + k3 * square**3
    c = a * radial + 2 * p1 * a * b + p2 * (square + 2 * a**2)
    d = b * radial + 2 * p2 * a * b + p1 * (square + 2 * b**2)
    return camera.focal * c + cx, camera.focal * d + cy


def cubic(image, x, y):
    """Cubic convolution at float64 precision; the image is mirrored."""
    out = np.zeros(x.shape)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    padded = np.pad(image, 60, mode="reflect").astype(float)
    for j in range(-1, 3):
        for i in range(-1, 3):
            weight = keys(x - (left + i)) * keys(y - (top + j))
            out += weight * padded[top + j + 60, left + i + 60]
    return out


def keys(t):
    t = np.abs(t)
    near = (1.5 * t - 2.5) * t**2 + 1
    return np.where(t < 1, near, np.where(t < 2, ((-0.5 * t + 2.5) * t - 4) * t + 2, 0))


def distorted(frame, camera):
    """A pinhole frame as a lens would have shown it; the model is inverted by iteration."""
    y, x = np.mgrid[: frame.shape[0], : frame.shape[1]].astype(float)
    u, v = x.copy(), y.copy()
    for _ in range(200):
        a, b = model(camera, u, v)
        u, v = u + 0.7 * (x - a), v + 0.7 * (y - b)
    assert max(np.abs(a - x).max(), np.abs(b - y).max()) < 1e-6
    return cubic(frame, u, v).astype(np.float32)


# The camera


@pytest.mark.parametrize("number", [4, 5, 8, 12, 14])
def test_a_camera_keeps_its_coefficients(number):
    camera = Camera(100.0, (3, 4), range(number))
    assert camera.distortion == tuple(map(float, range(number)))
    assert all(type(value) is float for value in camera.distortion)
    assert camera == Camera(100.0, (3, 4), distortion=np.arange(number)[None])
    assert camera == Camera(100.0, (3, 4), distortion=np.arange(number, dtype=np.float32)[:, None])
    assert hash(camera) == hash(Camera(100.0, (3, 4), list(range(number))))


@pytest.mark.parametrize("nothing", [None, (0, 0, 0, 0), np.zeros((1, 5))])
def test_zeros_are_no_distortion(nothing):
    assert Camera(100.0, distortion=nothing) == Camera(100.0)


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        ((), ValueError, "has 0 coefficients: expected 4, 5, 8, 12 or 14"),
        ((0.1,), ValueError, "has 1 coefficient: expected"),
        ((0.1, 0.2, 0.3), ValueError, "has 3 coefficients"),
        (np.zeros(6), ValueError, "has 6 coefficients"),
        (np.zeros((2, 2)), ValueError, "has 2 coefficients"),
        (0.1, TypeError, "distortion is 0.1: give OpenCV's coefficients"),
        ((0.1, "0", 0, 0), TypeError, r"distortion\[1\] is '0': expected a number$"),
        ((0.1, True, 0, 0), TypeError, r"distortion\[1\] is True"),
        ((0.1, 0, 0, np.nan), ValueError, r"distortion\[3\] is nan: expected a finite number$"),
        ((0.1, 0, -np.inf, 0), ValueError, r"distortion\[2\] is -inf"),
    ],
)
def test_coefficients_that_are_refused(value, error, words):
    with pytest.raises(error, match=words):
        Camera(100.0, distortion=value)


@pytest.mark.parametrize(
    ("focal", "smaller", "aspect"), [((50, 60), 50, 1.2), ([60.0, 50], 50, 5 / 6), ((7, 7), 7, 1)]
)
def test_two_focal_lengths(focal, smaller, aspect):
    camera = Camera(focal, (3, 4))
    assert camera.focal == smaller and camera.aspect == pytest.approx(aspect)
    assert camera.focals == pytest.approx(tuple(focal))
    assert camera == Camera(smaller, (3, 4), aspect=camera.aspect)
    assert camera.pinhole() == Camera(smaller, (3, 4))
    assert camera.is_pinhole == (aspect == 1)
    half = camera.scaled(0.5, 20, 30)
    assert half.focals == pytest.approx((focal[0] / 2, focal[1] / 2))
    assert dataclasses.replace(camera, center=None).focals == camera.focals
    assert hash(camera) == hash(Camera(tuple(focal), (3, 4)))


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"focal": (1, 2, 3)}, TypeError, r"focal is \(1, 2, 3\): expected a number, or two"),
        ({"focal": (1, 0)}, ValueError, r"focal\[1\] is 0: the focal length must be positive"),
        ({"focal": ("1", 2)}, TypeError, r"focal\[0\] is '1': expected a number"),
        ({"focal": (1, 2), "aspect": 2}, ValueError, "give one of fy and aspect"),
        ({"aspect": 0}, ValueError, "aspect is 0: fy / fx must be positive$"),
        ({"aspect": None}, TypeError, "aspect is None: expected a number$"),
    ],
)
def test_focal_lengths_that_are_refused(options, error, words):
    with pytest.raises(error, match=words):
        Camera(**options)


@pairwise(focal=[(200.0, 250.0), (250.0, 200.0)], distortion=[None, BARREL], short=True)
def test_oblong_pixels_are_resampled(scene, focal, distortion):
    """The frame that a camera with oblong pixels takes gives back that of square ones."""
    height, width = scene.frame0.shape
    center = scene.camera.center_for(height, width)
    camera, square = Camera(focal, center, distortion), Camera(200.0, center, distortion)
    frame = cv2.GaussianBlur(scene.frame0, (0, 0), 2)  # so that interpolating twice costs little
    y, x = np.mgrid[:height, :width].astype(float)
    fx, fy = focal
    cx, cy = camera.center
    columns, rows = cx + (x - cx) * 200 / fx, cy + (y - cy) * 200 / fy
    taken = cubic(distorted(frame, square) if distortion else frame, columns, rows)
    found, expected = undistort(taken.astype(np.float32), camera), undistort(frame, square)
    if distortion:
        expected = undistort(distorted(frame, square), square)
    lens = Undistortion(camera, height, width)
    inner = lens.valid & Undistortion(square, height, width).valid
    inner = cv2.erode(inner.astype(np.uint8), np.ones((9, 9))).astype(bool)
    assert inner.mean() > 0.4
    assert np.abs(found - expected)[inner].max() < 2
    assert np.abs(found - expected)[inner].mean() < 0.3
    depth = np.where(lens.valid, lens.apply_nearest(columns * 100 + rows), np.nan)
    assert np.isnan(depth).mean() == pytest.approx(1 - lens.valid.mean())


def test_depth_of_oblong_pixels_is_that_of_the_resampled_frame():
    camera = Camera((100.0, 200.0), center=(20, 10))
    lens = Undistortion(camera, 21, 41)
    rows, columns = np.mgrid[:21, :41].astype(np.float32)
    np.testing.assert_array_equal(lens.apply_nearest(columns)[lens.valid], columns[lens.valid])
    expected = 10 + 2 * (rows - 10)
    np.testing.assert_array_equal(lens.apply_nearest(rows)[lens.valid], expected[lens.valid])
    assert np.isnan(lens.apply_nearest(rows)[~lens.valid]).all()
    np.testing.assert_array_equal(lens.valid, (expected >= 0) & (expected <= 20))


def test_an_interpretation_of_oblong_pixels(scene):
    camera = Camera((180.0, 200.0))
    settings = tisfm.Settings.preset("fast")
    found = tisfm.interpret(scene.frame0, scene.frame1, camera=camera, settings=settings)
    frames = (undistort(frame, camera) for frame in (scene.frame0, scene.frame1))
    expected = tisfm.interpret(*frames, camera=camera.pinhole(), settings=settings)
    assert found.camera == Camera(180.0)
    np.testing.assert_array_equal(found.flow, expected.flow)
    valid = Undistortion(camera, *scene.frame0.shape).valid
    assert not valid.all() and (found.confidence[~valid] == 0).all()


FRAME = np.zeros((8, 9), np.uint8)


@pytest.mark.parametrize("focal", [1e-4, 2e6, 1e300])
def test_focal_lengths_beyond_computing(focal):
    with pytest.raises(ValueError, match=r"focal is .*: expected 0.001 to 1e\+06, in px"):
        tisfm.interpret(FRAME, FRAME, camera=Camera(focal))


def test_a_center_beyond_computing():
    with pytest.raises(ValueError, match=r"center is \(0.0, -2000000.0\): expected at most"):
        tisfm.interpret(FRAME, FRAME, camera=Camera(center=(0, -2e6)))


@pytest.mark.parametrize("focal", [1e-3, 1e6])
@pytest.mark.parametrize("motion", ["field", "camera", "objects"])
def test_the_longest_and_the_shortest_focal_length(focal, motion):
    """Whatever comes out, it is a result with a status, and numbers unless that says otherwise."""
    scene = static_scene("sideways", 40, 56)
    settings = tisfm.Settings.preset("fast", motion=motion)
    found = tisfm.interpret(scene.frame0, scene.frame1, camera=Camera(focal), settings=settings)
    assert found.status == "diverged" or np.isfinite(found.flow).all()


def test_scaling_keeps_distortion_and_a_pinhole_has_none():
    camera = Camera(100.0, distortion=BARREL)
    assert camera.scaled(0.5, 24, 40).distortion == BARREL
    assert camera.pinhole() == Camera(100.0)
    assert Camera(100.0, (3, 4), BARREL).pinhole() == Camera(100.0, (3, 4))


@pytest.mark.parametrize("number", [4, 5, 8, 12])
def test_another_focal_length_keeps_the_lens(number):
    lens = (-0.2, 0.05, 1e-2, -2e-2, 0.01, 0.1, 0.02, 0.01, 0.02, 0.01, -0.01, 0.02)[:number]
    camera = Camera(focal=(50.0, 55.0), center=(33.0, 21.0), distortion=lens)
    other = camera.with_focal(70.0)
    assert other.focals == pytest.approx((70.0, 77.0)) and other.center == camera.center
    frame = np.random.default_rng(0).uniform(0, 255, (48, 64)).astype(np.float32)
    kept = undistort(frame, camera)
    np.testing.assert_allclose(undistort(frame, other), kept, atol=0.02)
    stale = dataclasses.replace(other, distortion=lens)
    assert np.abs(undistort(frame, stale) - kept).max() > 1


def test_the_lens_of_a_tilted_sensor_fits_no_other_focal_length():
    tilted = Camera(distortion=(0.0,) * 12 + (0.1, 0.0))
    with pytest.raises(ValueError, match="tilted"):
        tilted.with_focal(500.0)
    assert Camera(distortion=(0.1,) + (0.0,) * 13).with_focal(500.0).focal == 500


def test_loss_of_distortion_is_refused(scene):
    camera = Camera(100.0, distortion=BARREL)
    with pytest.raises(ValueError, match=r"has distortion.*camera\.pinhole\(\)"):
        camera_motion(scene.flow, np.ones(scene.flow.shape[:2]), camera)
    with pytest.raises(ValueError, match=r"has distortion.*true flow"):
        evaluate([], camera=camera)
    with pytest.raises(ValueError, match=r"has distortion.*pinhole"):
        Scene(objects=[], camera=camera, height=4, width=4)


# Frames


@pytest.mark.parametrize("distortion", [BARREL, PINCUSHION, FOURTEEN])
def test_the_map_is_that_of_the_model(distortion):
    """A frame that shows its own coordinates tells where every pixel was taken from."""
    height, width = 61, 90
    camera = Camera(80.0, (40.5, 33.0), distortion)
    lens = Undistortion(camera, height, width)
    y, x = np.mgrid[:height, :width].astype(float)
    rays = np.stack([(x - 40.5) / 80, (y - 33) / 80, np.ones_like(x)], -1).reshape(-1, 3)
    matrix = np.array([[80.0, 0, 40.5], [0, 80.0, 33.0], [0, 0, 1]])
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(distortion))
    u, v = np.moveaxis(expected.reshape(height, width, 2), -1, 0)
    if distortion != FOURTEEN:
        np.testing.assert_allclose((u, v), model(camera, x, y), atol=1e-9)
    clipped = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    # Mirrored at its border, the spline of a ramp rounds it off; a few px away it is exact.
    deep = (u > 9) & (u < width - 10) & (v > 9) & (v < height - 10)
    for image, place in zip((x, y), clipped, strict=True):
        np.testing.assert_allclose(lens.apply(image)[deep], place[deep], atol=1e-3)
        np.testing.assert_allclose(lens.apply(image), place, atol=0.3)
    inside = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    differs = lens.valid != inside
    edge = np.minimum(np.minimum(u, width - 1 - u), np.minimum(v, height - 1 - v))
    assert (np.abs(edge[differs]) < 0.051).all()
    assert deep.sum() > 1000 and lens.valid.all() == (distortion == BARREL)


@pytest.mark.parametrize("shape", [(4, 4), (5, 37), (37, 5), (33, 64, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_frames_keep_shape_type_and_range(shape, dtype):
    frame = np.random.default_rng(0).uniform(0, 1, shape)
    frame = (frame * 255).astype(dtype) if np.issubdtype(dtype, np.integer) else frame.astype(dtype)
    before = frame.copy()
    out = undistort(frame, Camera(50.0, distortion=BARREL))
    assert (out.shape, out.dtype) == (frame.shape, frame.dtype)
    assert frame.min() <= out.min() and out.max() <= frame.max()
    assert shape < (5, 5) or not np.array_equal(out, frame)
    np.testing.assert_array_equal(frame, before)


def test_a_frame_without_distortion_is_unchanged():
    frame = np.random.default_rng(0).integers(0, 256, (20, 30), dtype=np.uint8)
    np.testing.assert_array_equal(undistort(frame, Camera(50.0)), frame)
    np.testing.assert_array_equal(Undistortion(Camera(50.0), 20, 30).apply(frame), frame)


def test_channels_are_treated_alike():
    frame = np.random.default_rng(0).uniform(0, 255, (20, 30, 3)).astype(np.float32)
    camera = Camera(40.0, distortion=PINCUSHION)
    expected = [undistort(frame[..., k], camera) for k in range(3)]
    np.testing.assert_array_equal(undistort(frame, camera), np.stack(expected, -1))


@pytest.mark.parametrize("distortion", [BARREL, PINCUSHION])
def test_distortion_and_back(scene, distortion):
    camera = Camera(scene.camera.focal, (116.0, 92.5), distortion)
    lens = Undistortion(camera, *scene.frame0.shape)
    frame = distorted(scene.frame0, camera)
    error = np.abs(lens.apply(frame) - scene.frame0)[lens.valid].mean()
    assert error < 0.1 * np.abs(frame - scene.frame0)[lens.valid].mean()


def test_beyond_where_the_model_turns_back_there_are_no_data():
    """r (1 - r²/3) is largest at r = 1; a bit farther it leads into the frame again."""
    camera = Camera(40.0, distortion=(-1 / 3, 0, 0, 0))
    valid = Undistortion(camera, 101, 141).valid
    y, x = np.mgrid[:101, :141]
    radius = np.hypot(x - 70, y - 50) / 40
    np.testing.assert_array_equal(
        valid[np.abs(radius - 1) > 0.02], (radius < 1)[abs(radius - 1) > 0.02]
    )


@pytest.mark.parametrize("distortion", [(1e6, 0, 0, 0), (-50, 0, 0, 0), (0, 0, 9, 9)])
def test_coefficients_of_another_camera_are_reported(distortion):
    frame = np.random.default_rng(0).integers(0, 256, (40, 60), dtype=np.uint8)
    with pytest.raises(ValueError, match=r"distortion leaves data at .*% .*40 × 60 px: check"):
        tisfm.interpret(frame, frame, camera=Camera(50.0, distortion=distortion))


def test_frames_that_are_refused():
    camera = Camera(50.0, distortion=BARREL)
    with pytest.raises(TypeError, match="expected a tisfm\\.Camera"):
        undistort(np.zeros((9, 9), np.uint8), 3)
    with pytest.raises(ValueError, match="frame is NaN or infinite"):
        undistort(np.full((9, 9), np.nan), camera)
    with pytest.raises(ValueError, match=r"frame is \(9,\)"):
        undistort(np.zeros(9, np.uint8), camera)


# Interpretations


@pytest.mark.parametrize("distortion", nightly_except(BARREL, of=[BARREL, PINCUSHION]))
def test_flow_is_that_of_the_pinhole_image(scene, distortion):
    camera = Camera(scene.camera.focal, (116.0, 92.5), distortion)
    frames = [distorted(frame, camera) for frame in (scene.frame0, scene.frame1)]
    with_it = tisfm.interpret(*frames, camera=camera)
    without = tisfm.interpret(*frames, camera=camera.pinhole())
    seen = scene.visible & ~with_it.occlusion
    assert seen.mean() > 0.75
    error, ignored = (endpoint_error(r.flow, scene.flow, mask=seen) for r in (with_it, without))
    best = tisfm.interpret(scene.frame0, scene.frame1, camera=camera.pinhole())
    assert error < 0.5 * ignored
    assert error < 2 * endpoint_error(best.flow, scene.flow, mask=seen)
    assert with_it.camera == camera.pinhole()
    assert np.abs(with_it.frame - scene.frame0)[seen].mean() < 3


def test_pixels_without_data_are_occluded_and_have_no_confidence(scene):
    camera = Camera(scene.camera.focal, distortion=PINCUSHION)
    frames = scene.frame0, scene.frame1
    result = tisfm.interpret(*frames, camera=camera)
    lens = Undistortion(camera, *scene.frame0.shape)
    missing = lens.pixels_without_data(np.moveaxis(result.flow, -1, 0))
    assert 0.03 < (~lens.valid).mean() < 0.3 and missing[~lens.valid].all()
    assert result.occlusion[missing].all() and not result.confidence[missing].any()
    assert result.confidence[~missing].mean() > 0.5 and result.occlusion[~missing].mean() < 0.1


def test_pixels_that_move_to_missing_data_are_missing():
    lens = Undistortion(Camera(60.0, distortion=PINCUSHION), 40, 60)
    assert lens.valid[20, 10] and not lens.valid[0, 0]
    flow = np.zeros((2, 40, 60), np.float32)
    np.testing.assert_array_equal(lens.pixels_without_data(flow), ~lens.valid)
    flow[:, 20, 10] = -10.4, -20.4
    flow[:, 20, 30] = np.nan
    flow[:, 20, 31] = np.inf
    flow[:, 20, 32] = -10.4, -10.4
    expected = ~lens.valid
    expected[20, 10] = expected[20, 30] = expected[20, 31] = True
    np.testing.assert_array_equal(lens.pixels_without_data(flow), expected)


@pytest.mark.parametrize("kind", ["uint8", "uint16", "unit float", "colour"])
def test_kinds_of_frames_agree(scene, kind):
    camera = Camera(scene.camera.focal, distortion=BARREL)
    frames = [np.rint(f).clip(0, 255).astype(np.uint8) for f in (scene.frame0, scene.frame1)]
    expected = tisfm.interpret(*frames, camera=camera)
    convert = {
        "uint8": lambda f: f,
        "uint16": lambda f: f.astype(np.uint16) * 257,
        "unit float": lambda f: f / np.float64(255),
        "colour": lambda f: np.dstack([f] * 3),
    }[kind]
    result = tisfm.interpret(*map(convert, frames), camera=camera)
    np.testing.assert_allclose(result.flow, expected.flow, atol=2e-2)
    assert np.abs(result.flow - expected.flow).mean() < 1e-4
    assert result.frame.shape == frames[0].shape + (3,) * (kind == "colour")


def test_sequences_are_undistorted(scene):
    camera = Camera(scene.camera.focal, distortion=BARREL)
    frames = [scene.frame0, scene.frame1]
    (result,) = tisfm.interpret_sequence(frames, camera=camera)
    expected = tisfm.interpret(*frames, camera=camera)
    np.testing.assert_array_equal(result.flow, expected.flow)
    np.testing.assert_array_equal(result.frame, undistort(expected_frame(frames[0]), camera))


def expected_frame(frame):
    return np.clip(np.rint(frame), 0, 255).astype(np.uint8)


def test_files_keep_the_camera(scene, tmp_path):
    frames = scene.frame0, scene.frame1
    camera = Camera(scene.camera.focal, (116.0, 92.5), BARREL)
    result = tisfm.interpret(*frames, camera=camera, settings=tisfm.Settings.preset("fast"))
    for kept in (camera, camera.pinhole()):  # a result of one's own may have any
        dataclasses.replace(result, camera=kept).save(tmp_path / "result.npz")
        assert Interpretation.load(tmp_path / "result.npz").camera == kept
