"""motion="camera": one rigid motion and inverse depth, on scenes with exact truth."""

import dataclasses
import warnings

import cv2
import numpy as np
import pytest

import tisfm
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.metrics import depth_errors, endpoint_error, pose_errors
from tisfm.motion.agreement import unrelated
from tisfm.reference import flow as flow_of
from tisfm.reference import motion_matrix
from tisfm.rigid import check_pose, pose_matrix, rigid_motion, rigid_twist
from tisfm.scenes import STATIC_KINDS, static_scene, two_blocks

CAMERA = tisfm.Settings(motion="camera")
SIZE = (120, 160)


def interpreted(scene, settings=CAMERA, **options):
    return tisfm.interpret(
        scene.frame0, scene.frame1, camera=scene.camera, settings=settings, **options
    )


def errors(result, scene):
    return pose_errors(pose_matrix(result.motions[0]), pose_matrix(scene.motions[0]))


@pytest.fixture(scope="module", params=STATIC_KINDS)
def scene(request):
    return static_scene(request.param, 240, 320, seed=11)


@pytest.fixture(scope="module")
def result(scene):
    return interpreted(scene)


@pytest.fixture(scope="module")
def small():
    return static_scene("sideways+rotation", *SIZE, seed=2)


# --- Depth and motion -------------------------------------------------------------------------


def test_depth_and_motion_of_static_scenes(result, scene):
    assert result.status == "converged"
    assert depth_errors(result.depth, scene.depth, mask=scene.visible).abs_rel < 0.013
    found = errors(result, scene)
    assert found.direction < 0.3 and found.rotation < 0.01
    assert endpoint_error(result.flow, scene.flow, mask=scene.visible) < 0.025


def test_depth_is_far_better_than_that_of_the_field(result, scene):
    field = interpreted(scene, tisfm.Settings())
    ours = depth_errors(result.depth, scene.depth, mask=scene.visible).abs_rel
    assert ours < 0.2 * depth_errors(field.depth, scene.depth, mask=scene.visible).abs_rel
    assert field.motions is None and field.labels is None and field.inverse_depth_std is None


def test_rho_is_the_field_of_the_flow(result, scene):
    height, width = scene.depth.shape
    expected = flow_of(motion_matrix(scene.camera, height, width, 6), result.rho.astype(float))
    np.testing.assert_allclose(np.moveaxis(result.flow, -1, 0), expected, atol=2e-5)
    # And, but for what a finite motion adds, it is the twist's.
    first_order = result.motions[0][:3, None, None] * result.inverse_depth
    assert np.abs(result.tau - first_order).max() * scene.camera.focal < 0.6
    np.testing.assert_allclose(result.tau[2], first_order[2], atol=1e-7)
    spin = np.broadcast_to(result.motions[0][3:, None, None], result.omega.shape)
    np.testing.assert_allclose(result.omega, spin, atol=1e-7)


def test_motion_has_length_one_and_depth_is_in_its_unit(result, scene):
    assert np.linalg.norm(result.motions[0][:3]) == pytest.approx(1)
    assert result.motions.shape == (1, 6) and result.motions.dtype == np.float64
    assert not result.labels.any() and result.labels.dtype == np.int32
    true_length = np.linalg.norm(scene.motions[0][:3])
    ratio = result.depth * true_length / scene.depth
    assert np.median(ratio[scene.visible]) == pytest.approx(1, abs=0.05)


def test_about_two_thirds_lie_within_one_deviation(result, scene):
    truth = 1 / scene.depth
    visible = scene.visible
    scale = np.median(truth[visible]) / np.median(result.inverse_depth[visible])
    off = np.abs(result.inverse_depth - truth / scale)[visible]
    assert 0.55 < (off < result.inverse_depth_std[visible]).mean() < 0.85
    # It is not one number for all: what it calls the surest half is better than the rest.
    sure = result.inverse_depth_std < np.median(result.inverse_depth_std)
    assert off[sure[visible]].mean() < 0.7 * off[~sure[visible]].mean()


def test_noise_widens_the_deviation(small):
    rng = np.random.default_rng(0)
    noisy = [
        np.clip(frame + rng.normal(scale=4, size=SIZE), 0, 255).astype(np.uint8)
        for frame in (small.frame0, small.frame1)
    ]
    quiet = interpreted(small)
    loud = tisfm.interpret(*noisy, camera=small.camera, settings=CAMERA)
    assert np.median(loud.inverse_depth_std) > 2 * np.median(quiet.inverse_depth_std)


@pytest.mark.parametrize("preset", ["paper", "fast", "balanced", "accurate"])
@pytest.mark.parametrize("model", ["rigid", "translation"])
def test_every_preset_and_model(preset, model):
    scene = static_scene("sideways", *SIZE, seed=2)  # by no more than a pixel, for one scale
    found = interpreted(scene, tisfm.Settings.preset(preset, motion="camera", model=model))
    limit = 0.03 if preset != "paper" else 0.15
    assert depth_errors(found.depth, scene.depth, mask=scene.visible).abs_rel < limit


@pytest.mark.parametrize("focal", [150.0, 600.0])
def test_focal_lengths(focal):
    scene = static_scene("forward+rotation", *SIZE, seed=1, focal=focal)
    result = interpreted(scene)
    assert depth_errors(result.depth, scene.depth, mask=scene.visible).abs_rel < 0.03
    assert errors(result, scene).direction < 1.5


def test_colour_and_sixteen_bits(small):
    colour = [np.repeat(f[..., None].astype(np.uint16) * 257, 3, axis=-1) for f in
              (small.frame0, small.frame1)]  # fmt: skip
    result = tisfm.interpret(*colour, camera=small.camera, settings=CAMERA)
    np.testing.assert_allclose(result.motions, interpreted(small).motions, atol=2e-4)


def test_the_background_of_moving_blocks():
    """Most of the image is static: its motion is found although two blocks have their own."""
    pair = two_blocks(240, 320, seed=1)
    result = interpreted(pair)
    assert errors(result, pair).direction < 1.5
    static = pair.visible & (pair.labels < 2)
    away = cv2.erode(static.astype(np.uint8), np.ones((15, 15))) > 0
    assert depth_errors(result.depth, pair.depth, mask=away).abs_rel < 0.03


def test_same_bits_twice_and_frames_untouched(small):
    frames = small.frame0.copy(), small.frame1.copy()
    first, second = (
        tisfm.interpret(*frames, camera=small.camera, settings=CAMERA) for _ in range(2)
    )
    np.testing.assert_array_equal(first.inverse_depth, second.inverse_depth)
    np.testing.assert_array_equal(first.motions, second.motions)
    np.testing.assert_array_equal(frames[0], small.frame0)


def test_energy_never_rises_within_a_warp(small):
    settings = dataclasses.replace(CAMERA, tolerance=0.0, outer_iterations=12)
    history = interpreted(small, settings).history
    for level in np.unique(history.level):
        for warp in np.unique(history.warp[history.level == level]):
            energy = history.energy[(history.level == level) & (history.warp == warp)]
            assert len(energy) == 12
            assert np.all(np.diff(energy) <= 1e-6 * energy[:-1])


@pytest.mark.parametrize("size", [(31, 47), (64, 17), (20, 20)])
def test_odd_and_small_sizes(size):
    scene = static_scene("forward", *size, seed=0)
    result = interpreted(scene)
    assert result.inverse_depth.shape == size
    assert np.isfinite(result.inverse_depth).all() and np.isfinite(result.flow).all()


# --- A known pose -----------------------------------------------------------------------------


def test_known_pose_gives_metric_depth(small):
    pose = pose_matrix(small.motions[0])
    result = interpreted(small, pose=pose)
    ratio = result.depth / small.depth
    assert np.median(ratio[small.visible]) == pytest.approx(1, abs=0.01)
    found = pose_errors(pose_matrix(result.motions[0]), pose)
    assert found.direction < 1e-4 and found.rotation < 1e-4
    assert np.linalg.norm(result.motions[0][:3]) == pytest.approx(1)
    # Depth in other units, the motion the same.
    pose[:3, 3] *= 1000
    again = interpreted(small, pose=pose)
    np.testing.assert_allclose(again.depth, 1000 * result.depth, rtol=1e-4)
    np.testing.assert_allclose(again.flow, result.flow, atol=1e-4)


def test_known_rotation_leaves_the_direction_to_be_found(small):
    rotation, _ = rigid_motion(small.motions[0])
    result = interpreted(small, pose=rotation)
    found = errors(result, small)
    assert found.rotation < 1e-4
    assert found.direction < 2
    assert depth_errors(result.depth, small.depth, mask=small.visible).abs_rel < 0.03


def test_a_pose_that_is_a_rotation_shows_no_depth(small):
    pose = np.eye(4)
    pose[:3, :3], _ = rigid_motion((0, 0, 0, 0.01, 0.02, 0))
    result = interpreted(small, pose=pose)
    assert result.status == "pure_rotation"
    assert not result.inverse_depth.any()


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (np.eye(2), "shape"),
        (np.zeros((3, 4)), "shape"),
        (np.diag([1.0, 1, -1]), "no rotation"),
        (2 * np.eye(3), "no rotation"),
        (np.full((4, 4), np.nan), "NaN"),
        (np.diag([1.0, 1, 1, 2]), "last row"),
        (np.diag([1.0, -1, -1]), "turns by 180°: expected less than 90°"),
        (rigid_motion((0, 0, 0, 0, 0, np.pi / 2))[0], "turns by 90°"),
    ],
)
def test_poses_that_are_none(pose, words, small):
    with pytest.raises(ValueError, match=words):
        interpreted(small, pose=pose)


@pytest.mark.parametrize("pose", ["pose.txt", np.eye(4, dtype=complex), np.eye(3, dtype=bool)])
def test_poses_that_are_not_real_numbers(pose, small):
    with pytest.raises(TypeError, match="expected a 4×4 or 3×3 array of real numbers"):
        interpreted(small, pose=pose)


def test_the_last_row_may_be_rounded():
    pose = pose_matrix((1, 2, 3, 0.1, 0.2, 0.3))
    pose[3] += 1e-7
    np.testing.assert_array_equal(check_pose(pose).translation, pose[:3, 3])
    pose[3, 0] = 0.01
    with pytest.raises(ValueError, match="last row"):
        check_pose(pose)


def test_a_turn_below_the_bound_is_a_pose():
    turn = rigid_motion((0, 0, 0, *np.radians((0, 0, 89))))[0]
    np.testing.assert_allclose(check_pose(turn).rotation, turn, atol=1e-12)


def test_the_field_takes_no_pose(small):
    with pytest.raises(ValueError, match='motion="field" leaves the motion free'):
        interpreted(small, tisfm.Settings(), pose=np.eye(4))


def test_a_rounded_rotation_is_made_exact():
    rotation, _ = rigid_motion((0, 0, 0, 0.1, -0.2, 0.3))
    known = check_pose(np.round(rotation, 4))
    np.testing.assert_allclose(known.rotation @ known.rotation.T, np.eye(3), atol=1e-12)
    assert known.translation is None
    assert check_pose(None) is None


@pytest.mark.parametrize("spin", [(0, 0, 0), (1e-9, 0, 0), (0.1, -0.2, 0.3), (0, 3.1, 0)])
def test_twists_and_motions_are_each_others_inverse(spin):
    twist = np.array([0.5, -1, 2, *spin])
    np.testing.assert_allclose(rigid_twist(*rigid_motion(twist)), twist, atol=1e-9)


# --- A pose that contradicts the images -------------------------------------------------------


def with_turn(axis, degrees):
    twist = np.zeros(6)
    twist[3 + axis] = np.radians(degrees)
    return pose_matrix(twist)


@pytest.fixture(scope="module")
def posed():
    scene = static_scene("sideways+rotation", 180, 240, seed=5)
    return scene, pose_matrix(scene.motions[0])


WRONG = {
    "backwards": lambda pose: np.block([[pose[:3, :3], -pose[:3, 3:]], [pose[3:]]]),
    "inverse": np.linalg.inv,
    "forward": lambda pose: np.block(
        [[pose[:3, :3], np.array([[0], [0], [-1.0]])], [np.array([0, 0, 0, 1.0])]]
    ),
    "axes": lambda pose: np.diag([1, -1, -1, 1]) @ pose @ np.diag([1, -1, -1, 1]),
    **{f"turned about {'xyz'[axis]}": lambda pose, axis=axis: with_turn(axis, 3) @ pose
       for axis in range(3)},
}  # fmt: skip
FAST = tisfm.Settings.preset("fast", motion="camera")


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG)
def test_a_wrong_pose_is_said_and_its_depth_kept(posed, change):
    scene, pose = posed
    result = interpreted(scene, FAST, pose=change(pose))
    assert result.status == "pose_mismatch"
    assert result.inverse_depth.any() and np.isfinite(result.inverse_depth).all()
    assert "the pose given does not explain the images" in result.status.message
    assert ("np.linalg.inv(pose)" in result.status.message) == (change is np.linalg.inv)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_wrong_rotation_is_said(posed, axis):
    scene, pose = posed
    result = interpreted(scene, FAST, pose=(with_turn(axis, 3) @ pose)[:3, :3])
    assert result.status == "pose_mismatch"


@pytest.mark.parametrize("noise", [0, 15, 40])
@pytest.mark.parametrize("known", [3, 4])
def test_a_right_pose_is_not_doubted(posed, noise, known):
    scene, pose = posed
    rng = np.random.default_rng(0)
    frames = [
        np.clip(frame + rng.normal(scale=noise, size=frame.shape), 0, 255).astype(np.uint8)
        for frame in (scene.frame0, scene.frame1)
    ]
    result = tisfm.interpret(*frames, camera=scene.camera, settings=FAST, pose=pose[:known, :known])
    assert result.status == "converged"


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["fast", "balanced"])
@pytest.mark.parametrize("focal", [300.0, 320.0, 600.0, 1200.0])
@pytest.mark.parametrize("kind", STATIC_KINDS)
def test_right_poses_of_all_scenes(kind, focal, preset):
    scene = static_scene(kind, 240, 320, seed=1, focal=focal)
    settings = tisfm.Settings.preset(preset, motion="camera")
    result = interpreted(scene, settings, pose=pose_matrix(scene.motions[0]))
    assert result.status == "converged"


def test_things_that_move_are_no_reason_to_doubt_a_pose():
    pair = two_blocks(240, 320, seed=1)
    result = interpreted(pair, FAST, pose=pose_matrix(pair.motions[0]))
    assert result.status == "converged"


def test_a_pose_of_noise_without_parallax_puts_all_far_away(posed):
    """What moves by no more than noise is not known to be near: 0, within its deviation."""
    scene, _ = posed
    rng = np.random.default_rng(1)
    frames = (scene.frame0 + rng.normal(scale=3, size=(2, 180, 240))).astype(np.float32)
    pose = np.eye(4)
    pose[0, 3] = 1
    result = tisfm.interpret(*frames, camera=scene.camera, settings=FAST, pose=pose)
    assert result.status == "converged"
    seen = ~result.occlusion
    assert np.isfinite(result.inverse_depth_std[seen]).all()
    near = np.abs(result.inverse_depth) < 3 * result.inverse_depth_std
    assert near[seen].mean() > 0.9


# --- What shows no depth ----------------------------------------------------------------------


def turned(frame, camera, spin):
    """The frame after the camera's rotation alone, exact but for interpolation."""
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
def test_pure_rotation_is_said(noise):
    scene = static_scene("forward", 240, 320, seed=3)
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
    # The flow is still that of the rotation.
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


def test_too_little_parallax_is_said():
    """A rotation of pixels and a translation of hundredths of one, under noise."""
    rng = np.random.default_rng(1)
    motion = np.array([-0.008, 0, 0, 0.004, -0.008, 0.003])
    scene = moved_scene(motion)
    frames = [
        np.clip(f + rng.normal(scale=4, size=f.shape), 0, 255).astype(np.uint8)
        for f in (scene.frame0, scene.frame1)
    ]
    result = tisfm.interpret(*frames, camera=scene.camera, settings=CAMERA)
    assert result.status in ("little_parallax", "pure_rotation") and no_depth(result)
    assert "too little parallax" in result.status.message
    assert errors(result, scene).rotation < 0.1


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
    """What is found in common depends neither on the scale of the brightness nor on its level."""
    frames = [np.float32(scale) * f + np.float32(offset) for f in (small.frame0, small.frame1)]
    flow, trust = small.flow.astype(np.float32), small.visible.astype(np.float32)
    assert unrelated(*frames, flow, trust) is None
    assert unrelated(frames[0], frames[1][::-1], flow, trust) == "unrelated"


def test_the_deviation_is_never_zero(small):
    """Black around what is seen: nothing is violated there, and nothing known."""
    frames = [np.zeros(SIZE, np.uint8) for _ in range(2)]
    for frame, whole in zip(frames, (small.frame0, small.frame1), strict=True):
        frame[40:80, 40:120] = whole[40:80, 40:120]
    pose = pose_matrix(small.motions[0])
    result = tisfm.interpret(*frames, camera=small.camera, settings=CAMERA, pose=pose)
    deviation = result.inverse_depth_std
    assert deviation.min() > 0
    assert np.median(deviation[:10]) > np.median(deviation[50:70, 50:110])


# --- Camera and files -------------------------------------------------------------------------


def test_the_focal_length_is_guessed_with_a_warning(small):
    with pytest.warns(GuessedFocalWarning, match="192"):
        result = tisfm.interpret(small.frame0, small.frame1, settings=CAMERA)
    assert result.camera.focal == 1.2 * SIZE[1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tisfm.interpret(small.frame0, small.frame1)


def test_saved_and_loaded(small, tmp_path):
    result = interpreted(small)
    result.save(tmp_path / "pair.npz")
    again = tisfm.Interpretation.load(tmp_path / "pair.npz")
    for name in ("motions", "labels", "inverse_depth", "inverse_depth_std", "depth"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    assert again.settings == result.settings and again.status == result.status


def test_points_lie_on_the_surfaces(small):
    pose = pose_matrix(small.motions[0])
    result = interpreted(small, pose=pose)
    cloud = result.points(min_confidence=0.3)
    assert 0.5 * small.depth.size < len(cloud) <= small.depth.size
    near, far = np.quantile(cloud.positions[:, 2], [0.01, 0.99])
    assert near > 0.9 * small.depth.min() and far < 1.1 * small.depth.max()
