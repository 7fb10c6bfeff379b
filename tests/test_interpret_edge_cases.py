"""Inputs at the edge of what there is to interpret: no change, long frames, absurd units."""

import dataclasses
import itertools

import cv2
import numpy as np
import pytest

import tisfm
from tisfm import scenes
from tisfm.frames import MAX_GREY
from tisfm.motion.frame_agreement import unrelated_status
from tisfm.motion.window_statistics import warp_image
from tisfm.rigid import pose_matrix

PRESETS = ("paper", "fast", "balanced", "accurate")
MOTIONS = ("field", "camera", "objects")


def texture(size, seed=0):
    """A smooth float32 texture of fractional grey levels from 0 to 255."""
    noise = np.random.default_rng(seed).uniform(0, 255, size).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)


# Frames that are the same


def check_nothing_moves(frame, settings, camera=None):
    camera = camera or tisfm.Camera(focal=80.0)
    result = tisfm.interpret(frame, frame.copy(), camera=camera, settings=settings)
    assert result.status == "no_motion"
    for name in ("rho", "flow", "inverse_depth"):
        assert not getattr(result, name).any(), name


@pytest.mark.parametrize(
    ("preset", "motion", "derivatives"),
    [
        *itertools.product(PRESETS, MOTIONS, ["cube"]),
        ("paper", "field", "five_tap"),
        ("accurate", "camera", "five_tap"),
    ],
)
def test_identical_frames_show_exactly_no_motion(preset, motion, derivatives):
    settings = tisfm.Settings.preset(preset, motion=motion, derivatives=derivatives)
    check_nothing_moves(texture((41, 67)), settings)


@pytest.mark.parametrize("scale", [1, 1 / 255])
def test_rounding_is_no_motion_in_the_paper(scale):
    check_nothing_moves(texture((201, 333)) * np.float32(scale), tisfm.Settings.preset("paper"))


@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_rounding_is_no_motion_after_undistortion(preset):
    lens = tisfm.Camera(focal=80.0, distortion=(-0.2, 0.05, 0.001, 0.001))
    check_nothing_moves(
        texture((60, 80)).astype(np.uint8), tisfm.Settings.preset(preset), camera=lens
    )


# Frames longer than OpenCV's remap takes

LONG = 33_000  # px


@pytest.mark.parametrize("axis", [0, 1])
def test_long_frames_are_compared_along_their_flow(axis):
    frame0 = texture((12, LONG))
    frame1 = np.roll(frame0, 3, axis=1)
    flow = np.zeros((*frame0.shape, 2), np.float32)
    flow[..., 0] = 3
    if axis == 0:
        frame0, frame1 = np.ascontiguousarray(frame0.T), np.ascontiguousarray(frame1.T)
        flow = np.ascontiguousarray(flow.transpose(1, 0, 2)[..., ::-1])
    trust = np.ones(frame0.shape, np.float32)
    assert unrelated_status(frame0, frame1, flow, trust) is None
    assert unrelated_status(frame0, frame1, 0 * flow, trust) == "unrelated"


def test_a_diverged_flow_is_compared_too():
    frame = texture((24, 40))
    flow = np.full((24, 40, 2), np.inf, np.float32)
    flow[::2], flow[1::3] = np.nan, 1e30
    assert unrelated_status(frame, frame, flow, np.ones(frame.shape, np.float32)) == "unrelated"


def test_frames_are_interpolated_linearly_between_pixels():
    frame = texture((24, 40))
    rng = np.random.default_rng(1)
    flow = rng.normal(0, 5, (24, 40, 2)).astype(np.float32)
    rows, columns = np.mgrid[:24, :40].astype(np.float32)
    moved = cv2.remap(
        frame,
        columns + flow[..., 0],
        rows + flow[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # OpenCV may round positions to 1/32 px: the steps of this frame are below 100 grey levels.
    np.testing.assert_allclose(warp_image(frame, flow), moved, atol=100 / 32)


@pytest.mark.parametrize(
    ("motion", "wide"), [("field", False), pytest.param("camera", True, marks=pytest.mark.nightly)]
)
def test_long_frames_are_interpreted(motion, wide):
    frame0 = texture((6, LONG)).astype(np.uint8)
    shift = 1 + np.arange(LONG) // 50 % 2
    frame1 = frame0[:, np.maximum(np.arange(LONG) - shift, 0)]
    pair = (frame0, frame1) if wide else (frame0.T, frame1.T)
    result = tisfm.interpret(
        *pair,
        camera=tisfm.Camera(focal=1.2 * LONG),
        settings=tisfm.Settings.preset("fast", motion=motion, coarse_warps=1),
    )
    assert result.flow.shape == (*pair[0].shape, 2)
    assert np.isfinite(result.confidence).all()
    if motion == "field":
        assert np.median(result.flow[..., 0 if wide else 1]) == pytest.approx(1.5, abs=0.5)


# Poses in any unit


@pytest.fixture(scope="module")
def moving():
    """A rendered pair, its camera and the pose that it was rendered with."""
    return scenes.static_scene("sideways", 72, 96, seed=2)


def with_unit(scene, unit):
    pose = pose_matrix(scene.motions[0])
    pose[:3, 3] *= unit / np.linalg.norm(pose[:3, 3])
    return tisfm.interpret(
        scene.frame0,
        scene.frame1,
        camera=scene.camera,
        settings=tisfm.Settings.preset("fast", motion="camera"),
        pose=pose,
    )


@pytest.mark.parametrize("unit", [1e-30, 1e-12, 1e12, 1e30])
def test_depth_is_in_the_unit_of_the_pose(moving, unit):
    one, other = with_unit(moving, 1.0), with_unit(moving, unit)
    assert other.status == one.status == "converged"
    for name in ("inverse_depth", "inverse_depth_std"):
        expected = getattr(one, name).astype(float) / unit
        np.testing.assert_allclose(getattr(other, name), expected, rtol=1e-5, err_msg=name)
    np.testing.assert_allclose(other.depth, one.depth.astype(float) * unit, rtol=1e-5)
    np.testing.assert_allclose(other.motions, one.motions, atol=1e-6)


@pytest.mark.parametrize("unit", [1e-300, 1e-44, 9e-31, 1.1e30, 1e37, 1e154, 1e308])
def test_units_that_single_precision_cannot_hold_are_refused(moving, unit):
    pose = np.eye(4)
    pose[:2, 3] = 0.6 * unit, -0.8 * unit
    with pytest.raises(ValueError, match=r"pose translates by .*: expected 0 .* 1e-30 to 1e\+30"):
        tisfm.interpret(
            moving.frame0,
            moving.frame1,
            camera=moving.camera,
            settings=tisfm.Settings.preset("fast", motion="camera"),
            pose=pose,
        )


@pytest.mark.parametrize("size", [3, 4])
def test_a_masked_pose_is_refused(moving, size):
    pose = np.ma.masked_array(np.eye(size))
    pose[0, 1] = np.ma.masked
    with pytest.raises(ValueError, match=rf"pose has 1 of {size**2} values masked: expected a 4×4"):
        tisfm.interpret(
            moving.frame0,
            moving.frame1,
            camera=moving.camera,
            settings=tisfm.Settings.preset("fast", motion="camera"),
            pose=pose,
        )


# Numbers beyond single precision


@pytest.mark.parametrize(
    ("scale", "preset", "motion"),
    [
        (1e11, "fast", "field"),
        (1e11, "fast", "camera"),
        (1e14, "paper", "field"),
        (1e14, "fast", "camera"),
        (1e18, "paper", "field"),
        (1e18, "fast", "camera"),
        (MAX_GREY / 256, "fast", "field"),
    ],
)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_confidence_and_history_are_always_numbers(scale, preset, motion):
    frame = texture((34, 47)).astype(float)
    result = tisfm.interpret(
        frame * scale,
        np.roll(frame, 1, axis=1) * scale,
        camera=tisfm.Camera(focal=60.0),
        settings=tisfm.Settings.preset(preset, motion=motion),
    )
    assert np.isfinite(result.confidence).all()
    assert result.confidence.min() >= 0 and result.confidence.max() <= 1
    lengths = set()
    for name, record in vars(result.history).items():
        assert np.isfinite(record).all(), name
        lengths.add(len(record))
    assert len(lengths) == 1
    if scale > 1e14:
        assert result.status == "diverged"


@pytest.mark.parametrize(
    "changes",
    [
        {"smoothness": 1e12, "stiffness": (1e6,) * 6, "image_edges": 1e6},
        {"smoothness": 1e-6, "stiffness": (1e-3,) * 6, "brightness": 1e6, "gradient": 1e6},
        {"normalization": None, "brightness": 1e6, "gradient": 1e6, "data_contrast": 1e6},
        {"normalization": 1e6, "contrast": 1e6, "data_contrast": 1e-3},
        {"contrast": 1e-3, "smoothness": 1e12},
        {"depth_smoothness": 1e12, "depth_brightness": 1e6, "depth_normalization": None},
        {"depth_smoothness": 1e-6, "depth_normalization": 1e6},
    ],
)
@pytest.mark.parametrize(
    ("motion", "solver"),
    [("field", "closed_form"), ("camera", "closed_form"), ("field", "cholesky")],
)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_settings_at_their_bounds_overflow_nowhere(changes, motion, solver):
    frame = texture((34, 47))
    settings = tisfm.Settings.preset("fast", motion=motion, solver=solver, **changes)
    result = tisfm.interpret(
        frame, np.roll(frame, 1, axis=1), camera=tisfm.Camera(focal=60.0), settings=settings
    )
    for name in ("rho", "flow", "inverse_depth", "confidence"):
        assert np.isfinite(getattr(result, name)).all(), name
    assert "single precision" not in result.status.message


# Contacts


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("empty", [0.0, np.inf, np.nan])
def test_objects_without_depth_have_no_contact(empty):
    from tisfm.motion.estimate import Estimate
    from tisfm.motion.objects.depth import align_scales

    labels = np.zeros((40, 40), np.int32)
    labels[10:25, 10:30] = 1
    depth = np.full((40, 40), 0.5, np.float32)
    depth[labels == 1] = 0.25
    depth[10:25, 10:20] = empty  # in half of the columns
    nothing = {name: None for name in (f.name for f in dataclasses.fields(Estimate))}
    estimate = Estimate(
        **{
            **nothing,
            "inverse_depth": depth,
            "inverse_depth_std": np.ones((40, 40), np.float32),
            "labels": labels,
            "motions": np.array([[1.0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]]),
        }
    )
    scaled = align_scales(estimate, np.zeros((40, 40), bool))
    np.testing.assert_allclose(scaled.motions[1, :3], [0, 0.5, 0])
    np.testing.assert_allclose(scaled.inverse_depth[15, 25], 0.5)
