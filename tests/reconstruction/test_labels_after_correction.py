"""Labels move with the pixels when a lens or a rolling shutter is corrected."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import path_error
from tests.rendered import bodies_film
from tisfm.camera import Camera
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.lens import Undistortion
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import FocalEstimate
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.reconstruction.objects.static_path import find_static_path
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.rigid import pose_matrix
from tisfm.scenes import bodies_path
from tisfm.shutter import RollingShutterMotion
from tisfm.sources.frame_reader import SourceFrame

OBJECTS = tisfm.Settings.preset("fast", motion="objects")
RADIAL, READOUT = -0.1, 0.8


def turning(count):
    """Return the path of a camera that turns while it passes the bodies."""
    poses = bodies_path(count)
    poses[:, :3, 3] *= 1.5
    at = np.arange(count) / (count - 1)
    turns = [pose_matrix((0, 0, 0, 0.1 * np.sin(6 * x), -0.2 * x, 0.3 * x)) for x in at]
    return poses @ np.array(turns)


def shaken(count):
    """Return the path of a shaken camera that passes the bodies."""
    at = np.arange(count)
    turns = 0.02 * np.sin(0.9 * at), 0.025 * (np.cos(0.7 * at) - 1), 0.012 * np.sin(1.3 * at)
    twists = np.stack([0 * at, 0 * at, 0 * at, *turns], axis=1)
    return bodies_path(count) @ np.array([pose_matrix(twist) for twist in twists])


def film(path=turning, count=12, readout=0.0, size=(180, 240)):
    return bodies_film(path(count), *size, readout=readout, samples=1)


def small_film():
    """Return 10 frames of a shaken camera with a rolling shutter."""
    return film(shaken, 10, READOUT, (120, 160))


def distorted(images, camera, interpolation):
    """Return images, (N, H, W), distorted by a lens with one coefficient."""
    height, width = images.shape[1:]
    cx, cy = camera.center_for(height, width)
    matrix = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    pixels = pixels.reshape(-1, 1, 2).astype(np.float32)
    straight = cv2.undistortPoints(pixels, matrix, np.array([RADIAL, 0, 0, 0]), P=matrix)
    x, y = np.moveaxis(straight.reshape(height, width, 2).astype(np.float32), -1, 0)
    edge = cv2.BORDER_REPLICATE
    return np.stack([cv2.remap(one, x, y, interpolation, borderMode=edge) for one in images])


def labels_of(result):
    return np.stack([result.labels(k) for k in range(len(result))])


def prepared(tmp_path, pictures, labels):
    """Return prepared frames with labels."""
    for name in ("cache", "frames"):
        (tmp_path / name).mkdir()
    frames = PreparedFrames(Camera(focal=60.0), tmp_path / "cache", tmp_path / "frames")
    for k, (picture, labelled) in enumerate(zip(pictures, labels, strict=True)):
        frames.add(SourceFrame(index=k, name=str(k), time=None, image=picture, labels=labelled))
    return frames


@pytest.mark.parametrize("cause", ["lens", "shutter"])
def test_labels_move_with_the_pixels(tmp_path, cause):
    """Labelled pixels are bright, so the pictures show whether labels moved with them."""
    labels = np.zeros((60, 80), np.uint8)
    labels[5:25, 8:30], labels[35:58, 50:74] = 3, 9
    frames = prepared(tmp_path, [np.uint8(20 + 200 * (labels > 0))], [labels])
    np.testing.assert_array_equal(frames.labels(0), labels)
    if cause == "lens":
        frames.correct(Camera(focal=60.0, distortion=(0.15, 0, 0, 0)))
    else:
        rate = np.array([0.0, 0, 0, 0, 0.15, 0])
        rolling = RollingShutterMotion(
            camera=frames.camera, readout=0.9, rates={0: rate}, inverse_depth={0: 1.0}
        )
        frames.correct(frames.camera, rolling)
    found, ignored = frames.labels(0), frames.ignored(0)
    seen = np.ones_like(found, bool) if ignored is None else ~ignored
    assert set(np.unique(found)) == {0, 3, 9} and not found[~seen].any()
    assert (found != labels)[seen].mean() > 0.02
    bright = frames.grey(0) > 120
    assert ((found > 0) != bright)[seen].mean() < 0.003
    assert not frames.used_pixels(0)[found > 0].any()


@pytest.mark.parametrize("is_given", [True, False])
def test_path_begins_again_with_corrected_frames(tmp_path, is_given):
    scene = bodies_film(bodies_path(4), 120, 160)
    pictures, true = scene.frames, scene.labels
    frames = prepared(tmp_path, pictures, true if is_given else [None] * 4)
    labels = None if is_given else SequenceLabels(frames.camera)
    for picture in pictures:
        if labels is not None:
            labels.add(picture)
    lens = Camera(focal=60.0, distortion=(0.1, 0, 0, 0))
    estimate = FocalEstimate(focal=60.0, deviation=1.0)
    requested, taken = [], []

    def path_of(calibrate):
        requested.append(calibrate)
        is_first = len(requested) == 1
        camera, focal = (lens, estimate) if is_first else (frames.camera, None)
        return CameraPath(pieces=(), missing={}, observations=(), camera=camera, focal=focal)

    def take_camera(path):
        taken.append(path.camera)
        frames.correct(path.camera)

    path = find_static_path(frames, labels, path_of, take_camera)
    assert path.focal is estimate
    assert taken[0] == lens and all(camera.is_pinhole for camera in taken[1:])
    assert requested == [None] if is_given else requested[:2] == [None, "nothing"]
    straight = Undistortion(lens, 120, 160)
    np.testing.assert_array_equal(frames.grey(0), straight.apply(pictures[0].astype(np.float32)))
    if is_given:
        moved = np.nan_to_num(straight.apply_nearest(true[0].astype(np.float32)))
        np.testing.assert_array_equal(frames.labels(0), moved)


@pytest.mark.nightly
def test_lens_is_estimated_beside_moving_objects():
    scene = film()
    with warnings.catch_warnings():
        warnings.simplefilter("error", GuessedFocalWarning)
        result = tisfm.reconstruct(
            list(distorted(scene.frames, scene.camera, cv2.INTER_CUBIC)),
            camera=replace(scene.camera, focal=1.1 * scene.camera.focal),
            calibrate="radial",
            settings=OBJECTS,
            labels=distorted(scene.labels, scene.camera, cv2.INTER_NEAREST),
            depth_of="none",
        )
    assert result.calibration.radial == pytest.approx(RADIAL, abs=0.01)
    assert result.camera.focal == pytest.approx(scene.camera.focal, rel=0.03)
    assert path_error(result.poses, scene.poses) < 0.005
    found, true = labels_of(result)[:, 10:-10, 10:-10], scene.labels[:, 10:-10, 10:-10]
    assert (found == true).mean() > 0.995


@pytest.mark.nightly
def test_shutter_is_corrected_beside_moving_objects():
    scene = small_film()
    errors = []
    for readout in (0.0, READOUT):
        result = tisfm.reconstruct(
            list(scene.frames),
            camera=replace(scene.camera, readout=readout),
            settings=OBJECTS,
            labels=scene.labels,
            depth_of="none",
        )
        errors.append(path_error(result.poses, scene.poses))
    assert errors[1] < 0.2 * errors[0]
    # The given value: nothing is estimated.
    assert result.camera.readout == 0 and result.calibration.readout == 0


@pytest.mark.nightly
def test_objects_found_with_a_rolling_shutter_are_those_of_middle_rows():
    scene = small_film()
    result = tisfm.reconstruct(
        list(scene.frames[:8]),
        camera=replace(scene.camera, readout=READOUT),
        settings=OBJECTS,
        poses=scene.poses[:8],
        depth_of="keyframes",
    )
    found = labels_of(result)
    assert result.objects and result.camera.readout == 0
    at_rest = [
        ((one == 0) & (true == 0)).sum() / ((one == 0) | (true == 0)).sum()
        for one, true in zip(found, scene.labels[:8], strict=True)
    ]
    assert np.mean(at_rest) > 0.93
