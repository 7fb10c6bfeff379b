"""Depth, flow and visibility of scenes, against brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenes.small import PAINT, TURNING, rays_of, series_exponential, small_scene
from tisfm.camera import Camera
from tisfm.scenes import STATIC_KINDS, Box, Plane, Scene


@pytest.mark.parametrize("name", ["two_blocks", *STATIC_KINDS])
def test_flow_is_the_projection_of_the_moved_point(pairs, name):
    pair = pairs[name]
    x, y = rays_of(pair)
    for label, motion in enumerate(pair.motions):
        on = pair.labels == label
        R, t = series_exponential(motion)
        P0 = pair.depth[on] * np.stack([x[on], y[on], np.ones(on.sum())])
        P1 = R @ P0 + t[:, None]
        expected = pair.camera.focal * (P1[:2] / P1[2] - P0[:2] / P0[2])
        np.testing.assert_allclose(pair.flow[on].T, expected, atol=1e-9)
        T, omega = motion[:3], motion[3:]
        np.testing.assert_allclose(pair.tau[:, on], T[:, None] / pair.depth[on], rtol=1e-12)
        assert (pair.omega[:, on] == omega[:, None]).all()
    np.testing.assert_allclose(pair.inverse_depth * pair.depth, 1)


def test_depth_is_that_of_the_nearest_surface():
    scene = small_scene()
    pair = scene.render(samples=1)
    _, floor, box = scene.objects
    x, y = rays_of(pair)
    P = pair.depth * np.stack([x, y, np.ones_like(x)])
    assert (pair.depth[pair.labels == 0] == 10).all()
    height_over_floor = np.tensordot(floor.normal, P, 1) - floor.normal @ floor.point
    np.testing.assert_allclose(height_over_floor[pair.labels == 1], 0, atol=1e-12)
    assert (height_over_floor > -1e-12).all()

    def depth_in_box(points):  # how far inside, relative; negative outside
        q = np.tensordot(box.axes.T, points - box.center.reshape(3, 1, 1), 1)
        return 1 - np.abs(2 * q / box.size.reshape(3, 1, 1)).max(axis=0)

    np.testing.assert_allclose(depth_in_box(P)[pair.labels == 2], 0, atol=1e-12)
    for fraction in np.linspace(0.01, 0.999, 60):
        assert (depth_in_box(P * fraction) < 0).all(), "a ray passes through the box"
    assert {0, 1, 2} == set(np.unique(pair.labels))


def test_flow_tends_to_the_instantaneous_flow_at_second_order():
    gaps = []
    for scale in (1, 1 / 2, 1 / 4, 1 / 8):
        pair = small_scene(motion=tuple(scale * value for value in TURNING)).render(samples=1)
        x, y = rays_of(pair)
        one, zero = np.ones_like(x), np.zeros_like(x)
        G = np.array([[one, zero, -x, -x * y, 1 + x**2, -y], [zero, one, -y, -1 - y**2, x * y, x]])
        rho = pair.camera.focal * np.concatenate([pair.tau, pair.omega])
        first_order = np.einsum("ckij,kij->ijc", G, rho)
        gaps.append(np.abs(pair.flow - first_order).max())
    orders = np.log2(np.divide(gaps[:-1], gaps[1:]))
    assert np.abs(orders - 2).max() < 0.1, gaps


def test_a_camera_moving_right_makes_everything_move_left(pairs):
    flow = pairs["sideways"].flow
    assert (flow[..., 0] < 0).all()
    np.testing.assert_allclose(flow[..., 1], 0, atol=1e-12)


def test_a_camera_moving_forward_sees_expansion_from_the_centre(pairs):
    pair = pairs["forward"]
    x, y = rays_of(pair)
    np.testing.assert_allclose(pair.flow[..., 0] * y, pair.flow[..., 1] * x, atol=1e-9)
    assert (pair.flow[..., 0] * x + pair.flow[..., 1] * y > 0).all()


def test_a_point_that_passes_the_camera_has_no_flow():
    near = Plane(texture=PAINT, motion=(0, 0, -15, 0, 0, 0))
    far = Plane(texture=PAINT, point=(0, 0, 20))
    pair = Scene(objects=[near, far], camera=Camera(focal=8.0), height=6, width=8).render()
    assert np.isnan(pair.flow).all() and not pair.visible.any() and (pair.labels == 0).all()


def passing_box(shift):
    """A box of 8×6 px passes `shift` px to the right, before a background at rest."""
    background = Plane(texture=PAINT)
    box = Box(
        texture=PAINT,
        center=(0, 0, 5.5),
        size=(8 / 20 * 5, 6 / 20 * 5, 1),
        motion=(shift / 20 * 5, 0, 0, 0, 0, 0),
    )
    return Scene(objects=[background, box], camera=Camera(focal=20.0), height=12, width=24)


def test_hidden_pixels_are_those_the_box_moves_over():
    pair = passing_box(3).render()
    expected = np.ones((12, 24), bool)
    expected[3:9, 16:19] = False
    assert (pair.visible == expected).all()
    assert (pair.labels[3:9, 8:16] == 1).all() and (pair.labels == 1).sum() == 48


def test_pixels_that_leave_the_image_are_not_visible():
    pair = passing_box(11).render()
    assert (pair.visible[3:9, 8:13]).all() and not pair.visible[3:9, 13:16].any()


@settings(max_examples=25)
@given(
    normal=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1),
    distance=st.floats(1, 50),
)
def test_rays_hit_any_plane_at_its_position(normal, distance):
    unit = np.array(normal) / np.linalg.norm(normal)
    backdrop = Plane(texture=PAINT, point=(0, 0, 1000))
    plane = Plane(texture=PAINT, point=distance * unit, normal=normal)
    camera = Camera(focal=9.0)
    pair = Scene(objects=[backdrop, plane], camera=camera, height=9, width=11).render(samples=1)
    x, y = rays_of(pair)
    toward = unit[0] * x + unit[1] * y + unit[2]
    expected = np.where(toward > 1e-12, distance / np.maximum(toward, 1e-12), np.inf)
    np.testing.assert_allclose(pair.depth, np.minimum(expected, 1000), rtol=1e-9)
