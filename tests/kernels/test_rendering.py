"""Inverse depth of one view as another view sees it."""

import numpy as np
import pytest

from bench import reference
from tests.rendered import static_scene
from tisfm import Camera
from tisfm.rigid import rigid_motion

TWIST = (0.4, -0.2, 0.6, 0.02, -0.05, 0.03)
SIZES = [(5, 1), (1, 7), (13, 37), (30, 41)]


def show(inverse_depth, deviation, motion, camera, continued=0.0):
    from tisfm.kernels.rigid.depth_maps import render_depth

    out, spread = (np.full(inverse_depth.shape, 7, np.float32) for _ in range(2))
    render_depth(
        inverse_depth, deviation, np.column_stack(motion).astype(np.float32), out, spread,
        center=camera.center_for(*inverse_depth.shape), focal=camera.focal,
        continued_deviation=continued,
    )  # fmt: skip
    return out, spread


@pytest.mark.parametrize("continued", [0.0, 0.5])
@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
def test_kernel_is_the_reference(size, continued):
    random = np.random.default_rng(3)
    camera = Camera(focal=float(max(size)))
    depth = np.where(random.random(size) < 0.5, 0.2, 0.5) + 0.01 * random.random(size)
    depth[random.random(size) < 0.1] = 0
    depth = depth.astype(np.float32)
    deviation = (0.05 * random.random(size)).astype(np.float32)
    motion = rigid_motion(TWIST)
    out, spread = show(depth, deviation, motion, camera, continued)
    expected, its_spread = reference.render_depth(
        depth.astype(float), deviation.astype(float), *motion, camera, continued
    )
    # A pixel on a limit of a comparison may fall to either side of it in single precision.
    alike = (out > 0) == (expected > 0)
    assert alike.mean() > 0.99
    both = alike & (out > 0)
    np.testing.assert_allclose(out[both], expected[both], rtol=1e-3)
    np.testing.assert_allclose(spread[both], its_spread[both], rtol=1e-2, atol=1e-6)
    if min(size) > 1:
        assert both.mean() > 0.2


def test_no_motion_changes_nothing():
    scene = static_scene("sideways", 40, 60)
    depth = (1 / scene.depth).astype(np.float32)
    out, spread = show(depth, 0.1 * depth, (np.eye(3), np.zeros(3)), scene.camera)
    np.testing.assert_allclose(out, depth, rtol=1e-5)
    np.testing.assert_allclose(spread, 0.1 * depth, rtol=1e-5)


def test_a_scene_is_rendered_from_its_next_pose():
    scene = static_scene("forward", 60, 80)
    motion = rigid_motion(scene.motions[0])
    depth = (1 / scene.depth).astype(np.float32)
    out, _ = show(depth, depth, motion, scene.camera)
    assert (out > 0).mean() > 0.8
    back, _ = show(out, out, (motion[0].T, -motion[0].T @ motion[1]), scene.camera)
    both = back > 0
    assert both.mean() > 0.7
    assert np.median(np.abs(back - depth)[both] / depth[both]) < 1e-3


def towards(step):
    """Return a motion of the camera along its axis."""
    return np.eye(3), np.array([0, 0, -step])


def test_a_surface_has_no_holes_where_it_is_stretched():
    depth = np.full((40, 60), 0.5, np.float32)
    out, _ = show(depth, 0.1 * depth, towards(1.6), Camera(focal=60))
    np.testing.assert_allclose(out, 1 / 0.4, rtol=1e-4)  # five times as large


def jump():
    """Return the inverse depth of a near surface on the left, and a far surface behind it."""
    return np.where(np.arange(60) < 30, 1.0, 0.2).astype(np.float32) + np.zeros((40, 1), np.float32)


def test_the_gap_behind_a_near_surface_is_no_surface():
    depth, sideways = jump(), (np.eye(3), np.array([-0.25, 0, 0]))
    out, _ = show(depth, 0.1 * depth, sideways, Camera(focal=60))
    # The near surface moves by 15 px to the left, the far surface by 3 px.
    np.testing.assert_allclose(out[:, :15], 1.0, rtol=1e-5)
    assert (out[:, 15:27] == 0).all()
    np.testing.assert_allclose(out[:, 27:57], 0.2, rtol=1e-5)


def test_the_far_surface_is_continued_into_the_gap():
    depth, sideways = jump(), (np.eye(3), np.array([-0.25, 0, 0]))
    out, spread = show(depth, 0.1 * depth, sideways, Camera(focal=60), continued=0.5)
    np.testing.assert_allclose(out[:-1, :15], 1.0, rtol=1e-5)
    np.testing.assert_allclose(out[:-1, 15:57], 0.2, rtol=1e-5)
    np.testing.assert_allclose(spread[:-1, 15:26], 0.1, rtol=1e-5)
    np.testing.assert_allclose(spread[:-1, 28:57], 0.02, rtol=1e-5)


def test_a_line_one_pixel_wide_is_kept():
    depth = np.full((40, 60), 0.2, np.float32)
    depth[:, 30] = 1.0
    out, _ = show(depth, 0.1 * depth, (np.eye(3), np.array([-0.1, 0, 0])), Camera(focal=60))
    np.testing.assert_allclose(out[:, 24], 1.0, rtol=1e-5)
    assert (out[:, [23, 25]] < 0.3).all()


def test_wrong_arguments_are_refused():
    depth = np.ones((4, 5), np.float32)
    with pytest.raises(ValueError, match="deviation"):
        show(depth, np.ones((4, 6), np.float32), (np.eye(3), np.zeros(3)), Camera())
