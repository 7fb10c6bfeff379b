"""Inverse depth of matched planes that both directions of matching confirm."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.rendered import static_scene
from tisfm.motion.problems import pyramid_of
from tisfm.motion.settings import DEPTH
from tisfm.rigid import rigid_motion

SETTINGS = tisfm.Settings()


def scaled_motion(scene):
    """Return the true motion, scaled for D in px/frame, and the true D."""
    from tisfm.motion.rigid_depth import scaled_translations

    labels = np.zeros(scene.depth.shape, np.int32)
    rotation, translation = rigid_motion(scene.motions[0])
    motion = np.column_stack([rotation, translation])
    scaled = scaled_translations(motion[None], labels, scene.camera)[0]
    ratio = np.linalg.norm(translation) / np.linalg.norm(scaled[:, 3])
    return scaled, ratio * scene.camera.focal / scene.depth


def matched(frame0, frame1, camera, motion, settings=SETTINGS):
    from tisfm.motion.matched_planes import matched_planes

    pyramid = pyramid_of(frame0.astype(np.float32), frame1.astype(np.float32), camera, settings)
    return matched_planes(pyramid, motion)


@pytest.mark.parametrize("kind", ["sideways+rotation", "forward"])
@pytest.mark.parametrize("preset", ["fast", "balanced", "accurate"])
def test_accepted_planes_are_right(kind, preset):
    scene = static_scene(kind, 240, 320)
    motion, true = scaled_motion(scene)
    settings = tisfm.Settings.preset(preset)
    planes = matched(scene.frame0, scene.frame1, scene.camera, motion, settings)
    height, width = planes.inverse_depth.shape
    scale = width / 320
    expected = scale * cv2.resize(true.astype(np.float32), (width, height))
    off = np.abs(planes.inverse_depth - expected)[planes.is_reliable]
    assert planes.is_reliable.mean() > 0.5
    assert np.median(off) < 0.15
    assert (off < 1).mean() > 0.97


def test_bare_surfaces_and_noise_are_not_believed():
    scene = static_scene("sideways", 240, 320)
    motion, _ = scaled_motion(scene)
    rng = np.random.default_rng(0)
    frames = [frame.astype(np.float32) for frame in (scene.frame0, scene.frame1)]
    for frame in frames:
        frame[:, 160:] = 90  # without texture
        frame += rng.normal(0, 2, frame.shape)
    planes = matched(*frames, scene.camera, motion)
    assert planes.is_reliable[:, 180:].mean() < 0.005
    assert planes.is_reliable[:, 10:140].mean() > 0.3


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (30, 1), (5, 7), (33, 47)])
def test_any_size(size):
    rng = np.random.default_rng(0)
    frame = rng.uniform(0, 255, size)
    motion = np.column_stack([np.eye(3), [1, 0, 0]])
    planes = matched(frame, frame, tisfm.Camera(focal=30.0), motion)
    assert planes.inverse_depth.shape == planes.is_reliable.shape == size
    assert np.isfinite(planes.inverse_depth).all()


def test_constant_frames():
    frame = np.full((40, 60), 99.0)
    motion = np.column_stack([np.eye(3), [1, 0, 0]])
    planes = matched(frame, frame, tisfm.Camera(focal=30.0), motion)
    assert not planes.is_reliable.any()


def test_no_island_is_left():
    from tisfm.motion.matched_planes import large_regions

    depth = np.full((60, 60), 5.0, np.float32)
    believed = np.zeros((60, 60), bool)
    believed[:30, :30] = True  # large
    believed[40:45, 40:45] = True  # small
    depth[10:15, 10:15] = 8  # another surface inside the large one, and small
    kept = large_regions(depth, believed)
    assert kept.sum() == 30 * 30 - 5 * 5
    assert DEPTH.min_plane_region > 25 and not kept[40:].any() and not kept[10:15, 10:15].any()
    ramp = np.broadcast_to(np.linspace(1, 50, 60, dtype=np.float32), (60, 60))
    assert large_regions(ramp.copy(), np.ones((60, 60), bool)).all()  # slanted, one surface


@pytest.mark.parametrize("deviation", [1.0, 4.0])
def test_noise_deviation(deviation):
    from tisfm.motion.matched_planes import noise_deviation

    rng = np.random.default_rng(1)
    rows, columns = np.mgrid[:240, :320]
    frame = 100 + 0.2 * columns + 0.1 * rows  # shading must not count as noise
    frame[100:150, 100:200] += 60 * rng.random((50, 100))  # texture must not count as noise
    noisy = (frame + rng.normal(0, deviation, frame.shape)).astype(np.float32)
    assert noise_deviation(noisy) == pytest.approx(deviation, rel=0.15)
    assert noise_deviation(noisy[:5, :9]) == pytest.approx(deviation, rel=0.6)
    assert noise_deviation(frame.astype(np.float32)) == DEPTH.min_noise
    narrow = (frame / 16).astype(np.float32)  # 12 bits in a range of 16
    assert noise_deviation(narrow) < 0.12 < DEPTH.min_noise
    assert noise_deviation(np.full((240, 320), 110, np.float32)) > 0
    striped = noisy.copy()
    # Texture in every second block.
    striped[:, 16::32] += 30 * rng.normal(size=striped[:, 16::32].shape)
    assert noise_deviation(striped, stride=2) != noise_deviation(striped)
    texture = rng.uniform(0, 255, frame.shape).astype(np.float32)
    assert noise_deviation(texture) == DEPTH.max_noise
