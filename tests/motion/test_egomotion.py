"""The motion of the camera from flow: exact from exact flow, and robust to moving objects."""

import numpy as np
import pytest

import tisfm
from tests.motion.one_motion import shared
from tests.rendered import static_scene, two_blocks
from tisfm.motion.egomotion import camera_motion, triangulate
from tisfm.motion.epipolar_fit import fix_scale
from tisfm.rigid import rigid_motion
from tisfm.scenes.block_scenes import STATIC_KINDS

SIZE = (120, 160)


def angle(a, b):
    """Angle between directions, degrees."""
    cosine = a @ b / np.linalg.norm(a) / np.linalg.norm(b)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def turn(a, b):
    """Angle of the rotation from b to a, degrees."""
    return np.degrees(np.arccos(np.clip((np.trace(a @ b.T) - 1) / 2, -1, 1)))


@pytest.fixture(scope="module", params=STATIC_KINDS)
def scene(request):
    return static_scene(request.param, *SIZE)


def test_exact_flow_gives_the_exact_motion(scene):
    rotation, translation = rigid_motion(scene.motions[0])
    motion = camera_motion(scene.flow, np.ones(SIZE), scene.camera)
    assert angle(motion.translation, translation) < 1e-3  # including the sign
    assert turn(motion.rotation, rotation) < 1e-3
    assert np.linalg.norm(motion.translation) == pytest.approx(1)
    assert motion.inliers == 1
    assert motion.parallax > 0.1


def test_triangulation_gives_the_exact_depth(scene):
    rotation, translation = rigid_motion(scene.motions[0])
    height, width = SIZE
    cx, cy = scene.camera.center_for(height, width)
    rows, columns = np.mgrid[:height, :width]
    start = np.stack([columns - cx, rows - cy], axis=-1)
    ones = np.ones((height * width, 1))
    before, after = (
        np.hstack([points.reshape(-1, 2) / scene.camera.focal, ones])
        for points in (start, start + scene.flow)
    )
    depth = 1 / triangulate(before, after, rotation, translation)
    np.testing.assert_allclose(depth, scene.depth.ravel(), rtol=1e-6)


def test_noise_and_gross_errors_of_the_flow(scene):
    rng = np.random.default_rng(0)
    rotation, translation = rigid_motion(scene.motions[0])
    flow = scene.flow + rng.normal(scale=0.05, size=scene.flow.shape)
    flow[30:80, 50:110] += 1.5  # a fifth of the pixels
    motion = camera_motion(flow, np.ones(SIZE), scene.camera)
    assert angle(motion.translation, translation) < 2
    assert turn(motion.rotation, rotation) < 0.05
    assert 0.03 < motion.residual < 0.08  # of the order of the noise across the epipolar lines


def test_moving_blocks_disturb_the_camera_motion_little():
    pair = two_blocks(*SIZE)
    _, translation = rigid_motion(pair.motions[0])
    motion = camera_motion(pair.flow, np.ones(SIZE), pair.camera)
    assert angle(motion.translation, translation) < 1
    assert 0.6 < motion.inliers < 0.95


def test_confidence_weighs():
    pair = two_blocks(*SIZE)
    _, translation = rigid_motion(pair.motions[0])
    wrong = pair.flow + np.where(np.arange(SIZE[1]) < 100, 3.0, 0.0)[None, :, None]
    trusted = np.broadcast_to(np.arange(SIZE[1]) >= 100, SIZE) & (pair.labels < 2)
    motion = camera_motion(wrong, trusted.astype(np.float32), pair.camera)
    assert angle(motion.translation, translation) < 1e-2


def test_rotation_alone_has_no_parallax():
    camera = tisfm.Camera(focal=160.0)
    rotation, _ = rigid_motion((0, 0, 0, 0.004, -0.01, 0.02))
    height, width = SIZE
    cx, cy = camera.center_for(height, width)
    rows, columns = np.mgrid[:height, :width]
    rays = np.stack([(columns - cx) / camera.focal, (rows - cy) / camera.focal, np.ones(SIZE)], -1)
    turned = rays @ rotation.T
    flow = camera.focal * (turned[..., :2] / turned[..., 2:] - rays[..., :2])
    assert camera_motion(flow, np.ones(SIZE), camera).parallax < 1e-6
    assert camera_motion(np.zeros_like(flow), np.ones(SIZE), camera).parallax < 1e-6


def test_same_answer_twice(scene):
    flow = scene.flow + np.random.default_rng(1).normal(scale=0.3, size=scene.flow.shape)
    first, second = (camera_motion(flow, np.ones(SIZE), scene.camera) for _ in range(2))
    np.testing.assert_array_equal(first.rotation, second.rotation)
    np.testing.assert_array_equal(first.translation, second.translation)


@pytest.mark.parametrize("kind", STATIC_KINDS)
def test_from_frames(kind):
    pair = static_scene(kind, seed=11)
    rotation, translation = rigid_motion(pair.motions[0])
    result = shared(pair, tisfm.Settings())
    motion = camera_motion(result.flow, result.confidence, pair.camera)
    assert angle(motion.translation, translation) < 0.5
    assert turn(motion.rotation, rotation) < 0.01


def test_flow_without_confidence_is_an_error():
    with pytest.raises(ValueError, match="needs at least 8"):
        camera_motion(np.zeros((*SIZE, 2)), np.zeros(SIZE), tisfm.Camera())


def test_normal_equations_are_regular_along_the_scale():
    direction = np.array([0.6, 0.0, 0.8])
    slope = np.random.default_rng(0).normal(size=(6, 40))
    # No equation depends on the length of t.
    slope[:3] -= np.outer(direction, direction @ slope[:3])
    normal = slope @ slope.T
    along = np.concatenate([direction, np.zeros(3)])
    held = fix_scale(normal, direction)
    assert np.linalg.cond(held) < 1e3 < 1e9 < np.linalg.cond(normal)
    assert along @ held @ along == pytest.approx(np.trace(normal))
    across = np.eye(6) - np.outer(along, along)
    kept = across @ (held - normal) @ across
    assert np.abs(kept).max() <= 1.1e-9 * np.trace(normal)
    nothing = fix_scale(np.zeros((6, 6)), direction)
    assert not np.linalg.solve(nothing, np.zeros(6)).any()
