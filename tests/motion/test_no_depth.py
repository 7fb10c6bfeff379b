"""Pairs without depth: rotations, rest, noise, and unrelated frames."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.motion.one_motion import CAMERA, FAST, SIZE, errors
from tests.rendered import static_scene, two_blocks
from tisfm.metrics import depth_errors
from tisfm.motion.frame_agreement import unrelated_status
from tisfm.rigid import pose_matrix, rigid_motion


def turned(frame, camera, spin):
    """Return the frame after a rotation of the camera, exact except for interpolation."""
    height, width = frame.shape
    cx, cy = camera.center_for(height, width)
    matrix = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    rotation, _ = rigid_motion((0, 0, 0, *spin))
    homography = matrix @ rotation @ np.linalg.inv(matrix)
    return cv2.warpPerspective(
        frame.astype(np.float32), homography, (width, height), flags=cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REFLECT_101,
    )  # fmt: skip


def no_depth(result):
    return not result.inverse_depth.any() and np.isnan(result.depth).all() and np.isinf(
        result.inverse_depth_std
    ).all()  # fmt: skip


@pytest.mark.parametrize("noise", [0, 3])
def test_pure_rotation_is_reported(noise):
    scene = static_scene("forward")
    spin = (0.004, -0.008, 0.006)
    rng = np.random.default_rng(0)
    frames = [
        frame + rng.normal(scale=noise, size=frame.shape).astype(np.float32)
        for frame in (scene.frame0.astype(np.float32), turned(scene.frame0, scene.camera, spin))
    ]
    result = tisfm.interpret(*frames, camera=scene.camera, settings=CAMERA)
    assert result.status == "pure_rotation"
    assert "too little parallax" in result.status.message
    assert no_depth(result)
    np.testing.assert_array_equal(result.motions[0][:3], 0)
    np.testing.assert_allclose(result.motions[0][3:], spin, atol=1e-4)
    # The flow is that of the rotation.
    assert np.abs(result.flow).max() > 1
    assert result.confidence.max() > 0.5


def test_no_motion_is_exactly_zero(small):
    result = tisfm.interpret(small.frame0, small.frame0, camera=small.camera, settings=CAMERA)
    assert result.status == "no_motion"
    assert not result.rho.any() and not result.flow.any() and not result.motions.any()
    assert no_depth(result)


def test_noise_alone_is_no_motion(small):
    rng = np.random.default_rng(5)
    frames = (small.frame0 + rng.normal(scale=3, size=(2, *SIZE))).astype(np.float32)
    result = tisfm.interpret(*frames, camera=small.camera, settings=CAMERA)
    assert result.status == "no_motion" and no_depth(result)
    assert not result.motions.any()


def of_noisy_frames(translation):
    """Return the result of a rotation and a sideways translation, with noise; and the scene."""
    rng = np.random.default_rng(1)
    scene = moved_scene(np.array([-translation, 0, 0, 0.004, -0.008, 0.003]))
    frames = [
        np.clip(f + rng.normal(scale=4, size=f.shape), 0, 255).astype(np.uint8)
        for f in (scene.frame0, scene.frame1)
    ]
    return tisfm.interpret(*frames, camera=scene.camera, settings=CAMERA), scene


def test_too_little_parallax_is_reported():
    """The translation moves points by hundredths of a pixel."""
    result, scene = of_noisy_frames(0.008)
    assert result.status in ("little_parallax", "pure_rotation") and no_depth(result)
    assert "too little parallax" in result.status.message
    assert errors(result, scene).rotation < 0.1


@pytest.mark.parametrize("translation", [0.012, 0.02])
def test_rough_depth_is_reported_as_uncertain(translation):
    """It is still far better than a constant depth."""
    result, scene = of_noisy_frames(translation)
    assert result.status == "uncertain"
    assert "there is little parallax, so depth is rough" in result.status.message
    middle = np.median(scene.depth)
    constant = np.abs(middle - scene.depth).mean() / middle
    assert depth_errors(result.depth, scene.depth).abs_rel < constant / 2


def moved_scene(motion):
    """A wall and a block, both moved by one twist."""
    pair = two_blocks(*SIZE, seed=4, camera_motion=-motion, block_motions=np.zeros((2, 6)))
    assert np.allclose(pair.motions, motion)
    return pair


KNOWN = {
    "nothing": None,
    "rotation": rigid_motion((0, 0, 0, 0, 0.01, 0))[0],
    "pose": pose_matrix((-1, 0, 0, 0, 0.01, 0)),
}


@pytest.mark.parametrize("pose", KNOWN.values(), ids=KNOWN)
def test_uniform_frames_have_no_texture(pose):
    frames = [np.full((40, 60), grey, np.uint8) for grey in (90, 120)]
    result = tisfm.interpret(*frames, camera=tisfm.Camera(60.0), settings=CAMERA, pose=pose)
    assert result.status == "no_texture" and no_depth(result)


@pytest.mark.parametrize("pose", KNOWN.values(), ids=KNOWN)
def test_identical_frames_have_no_motion(pose, small):
    result = tisfm.interpret(
        small.frame0, small.frame0, camera=small.camera, settings=CAMERA, pose=pose
    )
    assert result.status == "no_motion" and no_depth(result)
    if pose is not None and len(pose) == 4:
        np.testing.assert_allclose(pose_matrix(result.motions[0]), pose, atol=1e-3)


@pytest.mark.parametrize("preset", ["fast", "balanced"])
@pytest.mark.parametrize("size", [(60, 80), (180, 240)])
@pytest.mark.parametrize("pose", KNOWN.values(), ids=KNOWN)
def test_noise_has_no_depth(pose, size, preset):
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2, *size), dtype=np.uint8)
    settings = tisfm.Settings.preset(preset, motion="camera")
    camera = tisfm.Camera(float(size[1]))
    result = tisfm.interpret(*frames, camera=camera, settings=settings, pose=pose)
    assert result.status == "unrelated" and no_depth(result)
    assert np.isfinite(result.flow).all()


@pytest.mark.parametrize("pose", KNOWN.values(), ids=KNOWN)
def test_unrelated_scenes_have_no_depth(pose, small):
    other = static_scene("forward", *SIZE, seed=9)
    result = tisfm.interpret(
        small.frame0, other.frame1, camera=small.camera, settings=FAST, pose=pose
    )
    assert result.status == "unrelated" and no_depth(result)


@pytest.mark.parametrize(("scale", "offset"), [(1 / 255, 0), (0.02, 200), (100, 0)])
def test_frames_of_any_scale_are_related(scale, offset, small):
    """The check depends neither on the scale of the brightness nor on an offset."""
    frames = [np.float32(scale) * f + np.float32(offset) for f in (small.frame0, small.frame1)]
    flow, trust = small.flow.astype(np.float32), small.visible.astype(np.float32)
    assert unrelated_status(*frames, flow, trust) is None
    assert unrelated_status(frames[0], frames[1][::-1], flow, trust) == "unrelated"


def test_the_deviation_is_never_zero(small):
    """Black surroundings violate no constraint, but determine nothing."""
    frames = [np.zeros(SIZE, np.uint8) for _ in range(2)]
    for frame, whole in zip(frames, (small.frame0, small.frame1), strict=True):
        frame[40:80, 40:120] = whole[40:80, 40:120]
    pose = pose_matrix(small.motions[0])
    # the outline of the black part is fixed on the sensor
    options = {"settings": CAMERA, "pose": pose, "fixed_pixels": "keep"}
    result = tisfm.interpret(*frames, camera=small.camera, **options)
    deviation = result.inverse_depth_std
    assert deviation.min() > 0
    assert np.median(deviation[:10]) > np.median(deviation[50:70, 50:110])
