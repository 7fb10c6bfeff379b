"""Every setting changes the result."""

from functools import cache

import numpy as np
import pytest

import tisfm
from tests.rendered import two_blocks


@pytest.fixture(scope="module")
def blocks():
    return two_blocks(60, 82, seed=2)


@pytest.fixture(scope="module")
def default(blocks):
    """Return the interpretation by a motion model's default settings, computed once for each."""
    return cache(lambda motion: interpreted(blocks, motion=motion))


def interpreted(pair, **changes):
    settings = tisfm.Settings(**changes)
    return tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)


@pytest.mark.parametrize(
    "change",
    [
        {"model": "translation"},
        {"smoothness": 50.0},
        {"beta": 0.25},
        {"contrast": 0.5},
        {"joint_edges": False},
        {"stiffness": (1, 1, 1, 1, 1, 1)},
        {"image_edges": 0.0},
        {"brightness": 0.0},
        {"gradient": 0.0},
        {"normalization": 5.0},
        {"data_contrast": None},
        {"motion": "camera"},
        {"depth_smoothness": 20.0},
        {"depth_brightness": 0.2},
        {"depth_normalization": None},
        {"motion": "objects"},
        {"max_objects": 1},
        {"align_scales": True},
        {"derivatives": "cube"},
        {"presmoothing": 1.0},
        {"pyramid_factor": 0.7},
        {"pyramid_levels": 1},
        {"warps": 1},
        {"coarse_warps": 1},
        {"outer_iterations": 1},
        {"sweeps": 2},
        {"cycles": 1},
        {"finest_level": 1},
        {"relaxation": 1.2},
        {"tolerance": 0.5},
        {"solver": "cholesky"},
    ],
    ids=lambda change: next(iter(change)),
)
def test_every_setting_changes_the_result(change, default, blocks):
    # Settings of depth are those of one motion of the camera.
    name = next(iter(change))
    motion = "camera" if name.startswith("depth_") else "field"
    if name in ("max_objects", "align_scales"):
        motion = "objects"
    usual, changed = default(motion), interpreted(blocks, **{"motion": motion, **change})
    assert not np.array_equal(usual.inverse_depth, changed.inverse_depth)
    if "solver" in change:  # and this one only by rounding
        assert np.quantile(np.abs(usual.flow - changed.flow), 0.99) < 0.01


def test_settings_cover_every_field_in_the_test_above():
    """A new setting needs a line there."""
    tested = {
        next(iter(change))
        for mark in test_every_setting_changes_the_result.pytestmark
        for change in mark.args[1]
    }
    assert tested == set(tisfm.Settings.__dataclass_fields__)


def test_beta_and_smoothness_enter_as_their_product(blocks):
    frames = (blocks.frame0, blocks.frame1)
    one = tisfm.interpret(*frames, settings=tisfm.Settings(smoothness=400.0, beta=0.25))
    other = tisfm.interpret(*frames, settings=tisfm.Settings(smoothness=100.0, beta=1.0))
    np.testing.assert_array_equal(one.rho, other.rho)


def test_focal_length_and_centre_change_the_result(blocks):
    frames = (blocks.frame0, blocks.frame1)
    results = [
        tisfm.interpret(*frames, camera=camera).rho
        for camera in (
            tisfm.Camera(focal=100.0),
            tisfm.Camera(focal=200.0),
            tisfm.Camera(focal=100.0, center=(10.0, 70.0)),
        )
    ]
    assert not np.allclose(results[0], results[1], atol=1e-3)
    assert not np.allclose(results[0], results[2], atol=1e-3)
