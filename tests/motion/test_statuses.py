"""Statuses name the problem of a pair, and there is none for a good pair."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import tisfm
from tests.motion.one_motion import CAMERA, FAST, interpreted, shared
from tests.pairwise import pairwise
from tests.rendered import room, static_scene, three_blocks, two_blocks
from tisfm.camera import Camera
from tisfm.frames import grey_pair
from tisfm.grade import GRADES, depth_error, grade_depth
from tisfm.metrics import depth_errors
from tisfm.motion import first_motion as first_motion_module
from tisfm.motion.depth_checks import depth_status
from tisfm.motion.frame_agreement import aperture_status, unrelated_status
from tisfm.motion.problems import pyramid_of
from tisfm.motion.settings import CHECKS
from tisfm.rigid import pose_matrix, rigid_motion
from tisfm.scenes import Plane, Scene, Texture
from tisfm.status import Status
from tisfm.visibility.confidence import CONFIDENCE_WINDOW

SIZE = (120, 160)
MOTIONS = ("field", "camera", "objects")
PRESETS = ("paper", "fast", "balanced")


def status(frame0, frame1, preset, motion, **options):
    settings = tisfm.Settings.preset(preset, motion=motion)
    camera = Camera(focal=float(frame0.shape[1]))
    return tisfm.interpret(frame0, frame1, camera=camera, settings=settings, **options).status


# Unrelated frames.


@pytest.fixture(scope="module")
def scene():
    return static_scene("forward+rotation", *SIZE)


@pytest.mark.parametrize(
    ("preset", "motion"),
    [
        pytest.param("paper", "camera", marks=pytest.mark.nightly),
        ("fast", "objects"),
        ("balanced", "field"),
        pytest.param("paper", "objects", marks=pytest.mark.nightly),
        pytest.param("fast", "field", marks=pytest.mark.nightly),
        pytest.param("balanced", "camera", marks=pytest.mark.nightly),
    ],
)
def test_frames_without_relation(scene, preset, motion):
    other = static_scene("sideways", *SIZE, seed=9).frame1
    noise = np.random.default_rng(0).integers(0, 256, SIZE, dtype=np.uint8)
    flat = np.full(SIZE, 90, np.uint8)
    for frame1 in (other, noise, scene.frame0[:, ::-1], flat):
        assert status(scene.frame0, frame1, preset, motion) == "unrelated"
    for frame1 in (scene.frame1, flat + 30):
        assert status(flat, frame1, preset, motion) == "no_texture"


def test_a_flow_that_folds_the_image_is_unrelated(scene):
    frames = [frame.astype(np.float32) for frame in (scene.frame0, scene.frame0)]
    trust = np.ones(SIZE, np.float32)
    folding = np.zeros((*SIZE, 2), np.float32)
    folding[:, ::4, 0] = 1.5  # every fourth pixel moves past its neighbour
    assert "folds" in unrelated_status(*frames, folding, trust).message
    assert unrelated_status(*frames, folding, trust, is_unrestricted=False) is None
    folding[:, 40:] = 0
    assert unrelated_status(*frames, folding, trust) is None


# Stripes.


def stripes(angle, noise=0.0, *, shift=3):
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    along = np.cos(np.radians(angle)) * columns + np.sin(np.radians(angle)) * rows
    rng = np.random.default_rng(3)
    profile = cv2.GaussianBlur(rng.normal(size=(1, 600)), (0, 0), 4)[0]
    profile = 128 + 40 * profile / profile.std()
    frames = [np.interp(along + moved + 150, np.arange(600), profile) for moved in (0, shift)]
    return [
        np.clip(frame + rng.normal(scale=noise, size=SIZE), 0, 255).astype(np.uint8)
        for frame in frames
    ]


@pairwise(
    motion=MOTIONS, preset=PRESETS, stripes_of=[(0, 0), (30, 4), (45, 0), (90, 4)], short=True
)
def test_stripes_show_motion_across_only(stripes_of, preset, motion):
    found = status(*stripes(*stripes_of), preset, motion)
    assert found == "aperture" and "aperture problem" in found.message


def test_a_rotation_that_is_given_does_not_help_with_stripes():
    assert status(*stripes(0), "fast", "camera", pose=np.eye(3)) == "aperture"


@pytest.mark.parametrize("angle", [0, 30])
def test_stripes_show_depth_under_a_pose_that_crosses_them(angle):
    pose = np.eye(4)
    pose[0, 3] = -1
    frame0, frame1 = stripes(angle)
    camera = Camera(focal=160.0)
    result = tisfm.interpret(frame0, frame1, camera=camera, settings=FAST, pose=pose)
    assert result.status == "converged"
    moved = 3 / np.cos(np.radians(angle))
    inner = result.inverse_depth[20:-20, 20:-20]
    np.testing.assert_allclose(np.median(inner), moved / 160, rtol=0.05)


@pytest.mark.parametrize("side", [24, 40])
def test_texture_beside_stripes_shows_their_motion(scene, side):
    frame = stripes(0)[0].astype(np.float32)
    assert aperture_status(frame) == "aperture"
    frame[40 : 40 + side, 60 : 60 + side] = scene.frame0[40 : 40 + side, 60 : 60 + side]
    assert aperture_status(frame) is None


@pytest.mark.parametrize("scale", [1 / 255, 1.0, 1e4])
def test_stripes_are_found_at_any_brightness(scene, scale):
    for frame, found in ((stripes(20)[0], "aperture"), (scene.frame0, None)):
        assert aperture_status(np.float32(scale) * frame.astype(np.float32)) == found


@pytest.mark.parametrize("size", [(4, 90), (8, 8), (9, 200), (4, 70000)])
def test_frames_of_any_size_are_judged(size):
    noise = np.random.default_rng(0).normal(size=size).astype(np.float32)
    assert aperture_status(noise) is None


@pytest.mark.parametrize("side", [10, 13, 16, 20, 24])
def test_blurred_noise_has_no_direction(side):
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=(side, side + 3))
        smooth = cv2.GaussianBlur(noise, (0, 0), 1.5).astype(np.float32)
        assert aperture_status(smooth) is None


# Depth that does not explain the frames.


def judged(scene, *, inverse_depth=None, flow=None, uses_matches=False, deviation=1e-3):
    """Return the status of an estimate made by hand; arguments that are None have true values."""
    grey = grey_pair(scene.frame0, scene.frame1)
    pyramid = pyramid_of(*grey, scene.camera, CAMERA)
    truth = scene.flow.astype(np.float32)
    inverse_depth = np.float32(1) / scene.depth if inverse_depth is None else inverse_depth
    estimate = SimpleNamespace(
        inverse_depth=inverse_depth.astype(np.float32),
        deviation_factor=1.0,
        inverse_depth_std=np.full(SIZE, deviation, np.float32),
        flow=np.ascontiguousarray(np.moveaxis(truth if flow is None else flow, -1, 0)),
        start_flow=truth,
        start_level=0,
        uses_matches=uses_matches,
    )
    return depth_status(pyramid, estimate, ~scene.visible)


@pytest.mark.parametrize(("factor", "code"), [(0.8, None), (1.5, "behind_camera")])
def test_a_scene_that_lies_partly_behind_the_camera(scene, factor, code):
    inverse_depth = 1 / scene.depth
    rows = round(factor * CHECKS.max_behind_share * SIZE[0])
    inverse_depth[50 : 50 + rows] *= -1
    found = judged(scene, inverse_depth=inverse_depth)
    assert found == code and (code is None or "behind the camera" in found.message)


@pytest.mark.parametrize(
    ("distance", "deviation", "code"),
    [(0.05, 1e-3, None), (0.4, 0.14, None), (0.4, 0.1, "behind_camera")],
)
def test_noise_around_zero_lies_not_behind_the_camera(scene, distance, deviation, code):
    """Points count as behind only beyond three deviations, and beyond a share of inverse depth.

    `distance` and `deviation` are shares of the median inverse depth.
    """
    inverse_depth = 1 / scene.depth
    usual = float(np.median(inverse_depth))
    inverse_depth[:40] = -distance * usual
    assert judged(scene, inverse_depth=inverse_depth, deviation=deviation * usual) == code


@pytest.mark.parametrize("matched", [False, True])
@pytest.mark.parametrize(("factor", "code"), [(0.7, None), (1.5, "unexplained")])
def test_a_part_with_wrong_depth_is_unexplained(scene, factor, code, matched):
    flow = scene.flow.astype(np.float32)
    # Windows see the wrong rows from this distance.
    rows = max(1, round(factor * CHECKS.max_unexplained_share * SIZE[0]) - CONFIDENCE_WINDOW)
    flow[40 : 40 + rows] += (0, 9)
    assert judged(scene, flow=flow, uses_matches=matched) == code


@pytest.mark.parametrize(("factor", "code"), [(0.5, None), (1.5, "uncertain")])
def test_a_part_whose_deviation_is_large(scene, factor, code):
    deviation = np.full(SIZE, 1e-3)
    rows = round(factor * CHECKS.max_uncertain_share * SIZE[0])
    deviation[60 : 60 + rows] = CHECKS.max_relative_deviation * 1.1 / scene.depth.min()
    found = judged(scene, deviation=deviation)
    assert found == code and (code is None or "inverse_depth_std" in found.message)


def test_distant_points_are_not_uncertain(scene):
    """Where less than half is far away, its large relative deviation is allowed."""
    inverse_depth = 1 / scene.depth
    usual = float(np.median(inverse_depth))
    inverse_depth[:45] = 0.01 * usual
    assert judged(scene, inverse_depth=inverse_depth, deviation=0.05 * usual) is None
    assert judged(scene, inverse_depth=inverse_depth, deviation=0.6 * usual) == "uncertain"


@pytest.mark.parametrize(("factor", "code"), [(0.9, None), (1.1, "uncertain")])
def test_depth_that_is_expected_to_be_off(scene, factor, code):
    """The limit is that of the grade."""
    deviation = np.where(scene.visible, 1 / scene.depth, np.inf) / GRADES.median_ratio
    deviation *= factor * GRADES.max_fair
    found = judged(scene, deviation=deviation)
    assert found == code and (code is None or "half of the depth" in found.message)
    error, _ = depth_error(1 / scene.depth, deviation)
    assert (grade_depth(Status("converged"), error) == "poor") == (code == "uncertain")


def test_the_truth_explains_the_frames(scene):
    assert judged(scene) is None and judged(scene, uses_matches=True) is None


def test_a_pose_that_puts_the_scene_behind_the_camera(monkeypatch):
    """The check of the pose itself is off, because it would come first."""
    pair = two_blocks(240, 320)
    monkeypatch.setattr(first_motion_module, "pose_status", lambda *_, **__: None)
    pose = pose_matrix(pair.motions[0])
    assert interpreted(pair, FAST, pose=pose).status == "converged"
    assert interpreted(pair, FAST, pose=np.linalg.inv(pose)).status == "behind_camera"


# Distant frames with a given pose.


@pytest.fixture(scope="module")
def far():
    turned = (0.5, 0, 0.2, 0.03, 0.19, 0)
    return three_blocks(240, 320, camera_motion=turned, block_motions=np.zeros((3, 6)))


def test_a_pose_of_frames_far_apart_gives_depth(far):
    pose = pose_matrix(far.motions[0])
    result = shared(far, pose=pose)
    assert result.status in ("converged", "iteration_limit")
    seen = far.visible & ~result.occlusion
    assert depth_errors(result.depth, far.depth, mask=seen).abs_rel < 0.08
    error = np.abs(result.inverse_depth - 1 / far.depth)[far.visible]
    assert 0.4 < (error <= result.inverse_depth_std[far.visible]).mean() < 0.95
    other = static_scene("sideways", 240, 320, seed=9)
    result = tisfm.interpret(
        far.frame0, other.frame1, camera=far.camera, settings=CAMERA, pose=np.linalg.inv(pose)
    )
    assert result.status == "unrelated"


@pytest.mark.nightly
def test_a_wrong_pose_of_frames_far_apart_is_reported(far):
    pose = pose_matrix(far.motions[0])
    off = pose_matrix([0, 0, 0, 0, 0, np.radians(3)]) @ pose
    for wrong in (off, np.linalg.inv(pose)):
        assert interpreted(far, pose=wrong).status == "pose_mismatch"


@pytest.mark.nightly
def test_a_rotation_that_only_the_finer_flow_field_doubts():
    pair = room(480, 640)
    rotation, _ = rigid_motion(pair.motions[0])
    off, _ = rigid_motion((0, 0, 0, 0, 0, np.radians(0.4)))
    assert interpreted(pair, FAST, pose=rotation).status == "converged"
    assert interpreted(pair, FAST, pose=off @ rotation).status == "pose_mismatch"


# One plane.


def plane(normal, motion, noise=0.0, settings=CAMERA):
    wall = Plane(texture=Texture(wavelength=0.06), point=(0, 0, 5), normal=normal, motion=motion)
    pair = Scene(objects=[wall], camera=Camera(focal=300.0), height=240, width=320).render()
    rng = np.random.default_rng(0)
    frames = [
        np.clip(frame + rng.normal(scale=noise, size=frame.shape), 0, 255).astype(np.uint8)
        for frame in (pair.frame0, pair.frame1)
    ]
    return tisfm.interpret(*frames, camera=pair.camera, settings=settings)


FRONTAL, SLANTED = (0, 0, -1), (0.6, 0.1, -1)


@pairwise(
    motion=[(-0.15, 0, 0, 0, 0, 0), (-0.5, 0, 0, 0, 0.02, 0), (-1.2, 0.2, 0, 0, 0.1, 0.02)],
    normal=[FRONTAL, SLANTED],
    noise=[0, 5],
    short=True,
)
def test_a_wall_shows_parallax(normal, motion, noise):
    """The flow is 9 to 73 px."""
    result = plane(normal, motion, noise)
    assert result.status == "converged"
    assert (result.inverse_depth > 0).all()


@pairwise(normal=[FRONTAL, SLANTED], noise=[0, 5], short=True)
def test_a_wall_that_is_approached_aslant_leaves_two_motions(normal, noise):
    result = plane(normal, (-0.4, 0, -0.4, 0.03, 0.02, 0), noise)
    assert result.status == "two_motions" and result.inverse_depth.any()


def test_it_leaves_two_motions_where_objects_might_move():
    settings = tisfm.Settings.preset("fast", motion="objects")
    result = plane(SLANTED, (-0.4, 0, -0.4, 0.03, 0.02, 0), settings=settings)
    assert len(result.motions) == 1
    assert result.status == "two_motions" and result.inverse_depth.any()
