"""Weights and deviations of matched planes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.reconstruction.views import views
from tisfm import Camera


def window_of(key, others, motions, camera):
    from tisfm.reconstruction.depth.window_planes import Window

    return Window(key, others, motions, camera, cells=2**17)


def shifted(key, translation):
    """Return a window of a frame and the same frame, with a translation between them."""
    motion = np.column_stack([np.eye(3), translation])[None]
    return window_of(key, [key], motion, Camera(focal=50.0))


def noisy(frame):
    return (frame + np.random.default_rng(0).normal(0, 1.5, frame.shape)).astype(np.float32)


def test_sureness_is_that_of_slopes_along_epipolar_lines():
    from tisfm.reconstruction.depth.match_deviation import match_deviation
    from tisfm.reconstruction.depth.settings import DEPTH

    ramp = np.broadcast_to(8 * np.arange(60, dtype=np.float32) % 240, (40, 60))
    steep = noisy(ramp)
    depth = np.full((40, 60), 5, np.float32)
    along, across = (match_deviation(shifted(steep, t), depth) for t in ((1, 0, 0), (0, 1, 0)))
    inside = np.s_[8:-8, 6:24]
    # Noise of the grey levels over the root of the summed squares of the slopes, 8 per px. Frames
    # and their noise are smoothed a little before.
    expected = np.sqrt(2) * 1.5 / (8 * DEPTH.certainty_window)
    assert 0.3 * expected < np.median(along[inside]) < expected
    assert np.median(across[inside]) > 10 * np.median(along[inside])


def test_directions_are_derivatives_of_positions():
    from tisfm.reconstruction.depth.match_deviation import _position_slopes

    key, others, motions, camera = views("room").first(3)
    window = window_of(key, others, motions, camera)
    depth = np.full(window.shape, 6, np.float32)
    rows, columns = np.indices(window.shape)
    cx, cy = window.camera_of(window.level).center_for(*window.shape)
    focal = window.camera_of(window.level).focal
    rays = np.stack([(columns - cx) / focal, (rows - cy) / focal, np.ones(window.shape)])
    for motion, found in zip(window.motions, _position_slopes(window, depth), strict=True):

        def places(d, motion=motion):
            p = np.einsum("ij,jyx->iyx", motion[:, :3], rays)
            p += motion[:, 3, None, None] * d / focal
            return focal * p[:2] / p[2]

        expected = (places(6.01) - places(5.99)) / 0.02
        np.testing.assert_allclose(found, expected, atol=1e-4)


def test_bare_cells_beside_an_outline_do_not_count():
    from tisfm.reconstruction.depth.match_deviation import match_weights
    from tisfm.reconstruction.depth.window_planes import WindowPlanes

    step = np.full((40, 60), 60, np.float32)
    step[:, 30:] = 180
    step = noisy(step)
    depth = np.full((40, 60), 5, np.float32)
    planes = WindowPlanes(
        level=0,
        inverse_depth=depth,
        slopes=np.zeros((2, 40, 60), np.float32),
        is_reliable=np.ones((40, 60), bool),
        has_texture=np.ones((40, 60), bool),
    )
    weight, target = match_weights(shifted(step, (1, 0, 0)), planes)
    assert (weight[:, 29:31] > 0.9).all()
    assert weight[:, :25].mean() < 0.3 > weight[:, 35:].mean()
    np.testing.assert_array_equal(target, np.where(weight > 0, 5, 0))
    nowhere = replace(planes, is_reliable=np.zeros((40, 60), bool))
    assert not match_weights(shifted(step, (1, 0, 0)), nowhere).any()


@pytest.mark.parametrize("kind", ["sideways", "room"])
def test_sure_anchors_are_better(kind):
    from tisfm.reconstruction.depth.match_deviation import match_weights
    from tisfm.reconstruction.depth.window_planes import window_planes

    scene = views(kind)
    window = window_of(*scene.first(3))
    planes = window_planes(window)
    weight, target = match_weights(window, planes)
    scale = window.unit * window.camera.focal
    errors = np.abs(target / scale * scene.depth - 1)
    sure, unsure = errors[weight > 0.95], errors[(weight > 0) & (weight < 0.6)]
    assert np.median(sure) < 0.8 * np.median(unsure)
