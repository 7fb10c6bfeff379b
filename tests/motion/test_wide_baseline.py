"""Distant frames: where a flow field fails, matched points give the initial motion."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.motion.one_motion import CAMERA, errors, interpreted, shared
from tests.rendered import room, static_scene, three_blocks, two_blocks
from tisfm.camera import Camera
from tisfm.metrics import depth_errors
from tisfm.motion import camera as camera_module
from tisfm.motion import first_motion as first_motion_module
from tisfm.motion.first_motion import first_motion
from tisfm.scenes import Plane, Scene, Texture

SIZE = (240, 320)
TURNED = (0.5, 0, 0.2, 0.03, 0.19, 0)  # a turn of 11°: flow of 30 to 90 px


@pytest.fixture(scope="module")
def far():
    return three_blocks(*SIZE, camera_motion=TURNED, block_motions=np.zeros((3, 6)))


def without_matches(monkeypatch):
    def alone(*arguments, **options):
        return first_motion(*arguments, **{**options, "use_matches": False})

    monkeypatch.setattr(camera_module, "first_motion", alone)


def test_a_turn_between_frames_is_found(far, monkeypatch):
    assert np.linalg.norm(far.flow, axis=-1).min() > 25
    result = shared(far)
    found = errors(result, far)
    assert result.status in ("converged", "iteration_limit")
    assert found.rotation < 0.2 and found.direction < 1
    seen = far.visible & ~result.occlusion
    assert depth_errors(result.depth, far.depth, mask=seen).abs_rel < 0.08
    off = np.linalg.norm(result.flow - far.flow, axis=-1)
    assert np.median(off[seen]) < 0.5
    # Without matched points, the flow field fails.
    without_matches(monkeypatch)
    alone = interpreted(far)
    assert alone.status not in ("converged", "iteration_limit") or errors(alone, far).rotation > 2


@pytest.mark.parametrize("degrees", nightly_except(25, of=[15, 25]))
def test_little_parallax_beside_a_large_turn_gives_rough_depth(degrees):
    turned = (0.1, 0, 0, 0, np.radians(degrees), 0)
    pair = two_blocks(*SIZE, seed=0, camera_motion=turned, block_motions=np.zeros((2, 6)))
    result = interpreted(pair)
    assert result.status == "uncertain"
    seen = pair.visible & ~result.occlusion
    middle = np.median(pair.depth[seen])
    constant = (np.abs(middle - pair.depth) / pair.depth)[seen].mean()
    assert depth_errors(result.depth, pair.depth, mask=seen).abs_rel < constant / 2


@pytest.mark.nightly
def test_the_same_answer_every_time(far):
    first, second = shared(far), interpreted(far)
    np.testing.assert_array_equal(first.flow, second.flow)
    np.testing.assert_array_equal(first.motions, second.motions)


@pytest.mark.parametrize("kind", nightly_except("sideways", of=["sideways", "forward+rotation"]))
def test_ordinary_pairs_are_not_matched(kind, monkeypatch):
    def refused(*_):
        raise AssertionError("points were matched")

    monkeypatch.setattr(first_motion_module, "sparse_start", refused)
    assert interpreted(static_scene(kind, *SIZE)).status in ("converged", "iteration_limit")


def test_points_are_not_matched_under_a_known_pose(far, monkeypatch):
    monkeypatch.setattr(first_motion_module, "sparse_start", None)
    rotation = tisfm.rigid.rigid_motion(far.motions[0])[0]
    interpreted(far, pose=rotation)


def test_scenes_with_nothing_in_common_stay_unrelated(far):
    other = static_scene("sideways", *SIZE, seed=9)
    result = tisfm.interpret(far.frame0, other.frame1, camera=far.camera, settings=CAMERA)
    assert result.status == "unrelated" and not result.inverse_depth.any()


def test_a_large_turn_on_the_spot_is_a_rotation():
    turned = three_blocks(*SIZE, camera_motion=(0, 0, 0, 0, 0.2, 0), block_motions=np.zeros((3, 6)))
    result = interpreted(turned)
    assert result.status == "pure_rotation"
    assert errors(result, turned).rotation < 0.1


@pytest.mark.nightly
def test_a_plane_leaves_two_motions():
    paint = Texture(wavelength=0.06)
    wall = Plane(
        texture=paint,
        point=(0, 0, 5),
        normal=(0.6, 0.1, -1),
        motion=(-1.5, 0.4, 0.9, 0.05, 0.3, 0.2),
    )
    scene = Scene(objects=[wall], camera=Camera(focal=300.0), height=SIZE[0], width=SIZE[1])
    result = interpreted(scene.render())
    assert result.status == "two_motions" and "plane" in result.status.message
    assert result.inverse_depth.all()


@pytest.mark.nightly
def test_a_room_far_apart():
    pair = room(*SIZE, camera_motion=(0.5, 0, 0.2, 0, 0.17, 0.02))
    found = errors(interpreted(pair), pair)
    assert found.rotation < 0.5 and found.direction < 3


def test_a_large_turn_found_by_points_is_a_rotation():
    """The flow of a large turn must not count as diverged."""
    height, width, focal = 240, 320, 300.0
    rng = np.random.default_rng(0)
    wide = cv2.GaussianBlur(rng.normal(size=(2 * height, 3 * width)), (0, 0), 2)
    wide = np.clip(128 + 45 * wide / wide.std(), 0, 255).astype(np.float32)
    angle = np.radians(25)
    turn = cv2.Rodrigues(np.array([0, angle, 0]))[0]
    camera = tisfm.Camera(focal=focal)
    cx, cy = camera.center_for(height, width)
    inner = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    plane = np.array([[1, 0, width], [0, 1, height / 2], [0, 0, 1.0]])
    frames = [
        cv2.warpPerspective(
            wide, plane @ inner @ rotation.T @ np.linalg.inv(inner), (width, height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        for rotation in (np.eye(3), turn)
    ]  # fmt: skip
    result = tisfm.interpret(*frames, camera=camera, settings=tisfm.Settings(motion="camera"))
    assert result.status == "pure_rotation"
