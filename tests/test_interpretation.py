"""The result: its arrays and its status."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import tisfm
from tisfm.status import Status

H, W = 24, 40
ARRAYS = ("rho", "flow", "confidence", "occlusion", "frame")


def frames(seed=0, channels=()):
    frame0 = np.random.default_rng(seed).integers(0, 256, (H, W, *channels), dtype=np.uint8)
    return frame0, np.roll(frame0, 1, 1)


@pytest.fixture(scope="module")
def result():
    return tisfm.interpret(
        *frames(),
        camera=tisfm.Camera(50.0, center=(18.5, 12.25)),
        settings=tisfm.Settings.preset("paper", outer_iterations=4),
    )


# Attributes


@pytest.mark.parametrize("model", ["rigid", "translation"])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_shapes_and_types(model, channels):
    result = tisfm.interpret(*frames(channels=channels), settings=tisfm.Settings(model=model))
    shapes = {
        "rho": (6, H, W),
        "tau": (3, H, W),
        "omega": (3, H, W),
        "flow": (H, W, 2),
        "inverse_depth": (H, W),
        "depth": (H, W),
        "confidence": (H, W),
    }
    for name, shape in shapes.items():
        array = getattr(result, name)
        assert (array.shape, array.dtype) == (shape, np.float32), name
        assert array.flags.c_contiguous, name
    assert (result.occlusion.shape, result.occlusion.dtype) == ((H, W), np.bool_)
    assert (result.frame.shape, result.frame.dtype) == ((H, W, *channels), np.uint8)
    assert np.isfinite(result.rho).all() and result.rho[:3].any()
    assert result.rho[3:].any() == (model == "rigid")
    assert result.confidence.min() >= 0 and result.confidence.max() <= 1
    assert result.camera == tisfm.Camera() and result.settings.model == model
    assert result.version == tisfm.__version__
    assert isinstance(result.status, str) and result.status.message


def test_history_is_one_row_per_iteration(result):
    history = vars(result.history)
    assert {len(array) for array in history.values()} == {len(result.history.level)}
    assert result.history.level.dtype == result.history.warp.dtype == np.int32
    for name in ("energy", "half_quadratic", "change"):
        assert history[name].dtype == np.float64
        assert np.isfinite(history[name]).all()


def test_tau_and_omega_are_rho_over_the_focal_length(result):
    focal = result.camera.focal
    np.testing.assert_allclose(result.tau * focal, result.rho[:3], rtol=1e-6)
    np.testing.assert_allclose(result.omega * focal, result.rho[3:], rtol=1e-6)


def test_depth_is_one_over_the_length_of_tau(result):
    length = np.linalg.norm(result.tau.astype(float), axis=0)
    np.testing.assert_allclose(result.inverse_depth, length, rtol=1e-6)
    np.testing.assert_allclose(result.depth, 1 / length, rtol=1e-6)


@pytest.mark.filterwarnings("error")
def test_depth_is_unknown_where_the_inverse_depth_is_not_positive(result):
    inverse_depth = result.inverse_depth.copy()
    inverse_depth[2:4, 7], inverse_depth[4, 7] = 0, -1
    changed = dataclasses.replace(result, inverse_depth=inverse_depth)
    unknown = np.zeros((H, W), bool)
    unknown[2:5, 7] = True
    np.testing.assert_array_equal(np.isnan(changed.depth), unknown)


@pytest.mark.filterwarnings("error")
def test_no_motion_is_exactly_zero():
    frame0, _ = frames()
    result = tisfm.interpret(frame0, frame0)
    assert not result.rho.any() and not result.flow.any() and not result.inverse_depth.any()
    assert np.isnan(result.depth).all()
    assert result.status == "no_motion" and "farther apart" in result.status.message


def test_no_texture_is_reported():
    uniform = np.full((H, W), 100, np.uint8)
    result = tisfm.interpret(uniform, uniform)
    assert result.status == "no_texture" and "textured" in result.status.message
    assert np.isfinite(result.flow).all()


def test_running_out_of_iterations_is_reported():
    settings = tisfm.Settings(outer_iterations=1, tolerance=0)
    status = tisfm.interpret(*frames(), settings=settings).status
    assert status == "iteration_limit"
    assert "outer_iterations" in status.message and "tolerance 0" in status.message


def test_convergence_is_reported():
    status = tisfm.interpret(*frames(), settings=tisfm.Settings(tolerance=10.0)).status
    assert status == "converged" and "changed by" in status.message


def test_the_same_answer_twice(result):
    again = tisfm.interpret(*frames(), camera=result.camera, settings=result.settings)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))


def test_repr_is_short(result):
    text = repr(result)
    assert len(text) < 800 and "array" not in text
    assert "focal=50.0" in text and str(result.status) in text


def test_a_result_is_frozen(result):
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.rho = None


# Status


def test_a_status_compares_as_text():
    status = Status("converged", "all is well")
    assert status == "converged" and status != "no_motion"
    assert status in ("converged", "no_motion") and {status: 1}["converged"] == 1
    assert str(status) == f"{status}" == "converged" and isinstance(status, str)
    assert status.message == "all is well"
    assert Status("converged").message == ""


@pytest.mark.parametrize(
    "remake", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_a_status_keeps_its_message_when_copied(remake):
    made = remake(Status("no_motion", "frames do not differ"))
    assert made == "no_motion" and made.message == "frames do not differ"
