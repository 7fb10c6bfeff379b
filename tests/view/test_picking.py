"""What a click hits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.view.test_cloud import RANGES, made
from tisfm.view.frame_cloud import PointFilter, frame_cloud
from tisfm.view.viewpoint import (
    field_of_view,
    find_clicked_pixel,
    find_clicked_point,
    frustum_scale,
)


@given(seed=st.integers(0, 999), row=st.integers(0, 10), column=st.integers(0, 22))
@settings(max_examples=60)
def test_a_ray_through_a_pixel_hits_its_point(seed, row, column):
    inverse = np.random.default_rng(seed).uniform(0.9, 1.1, (11, 23))
    points = frame_cloud(made(inverse), "image", RANGES, PointFilter())
    ray = made(inverse).rays(np.array([row]), np.array([column]))[0]
    hit = find_clicked_point(np.zeros(3), 3 * ray, points.positions)
    assert points.pixels[hit].tolist() == [row, column]


def test_the_nearest_surface_is_hit():
    positions = np.array([(0.0, 0, 5), (0.005, 0, 2), (0, 0, -1)])
    assert find_clicked_point((0, 0, 0), (0, 0, 1), positions) == 1
    assert find_clicked_point((0, 0, 0), (0, 0, -1), positions) == 2
    assert find_clicked_point((0, 0, 3), (0, 0, 1), positions) == 0
    assert find_clicked_point((0, 0, 0), (1, 0, 0), positions) is None
    assert find_clicked_point((0, 0, 0), (1, 0, 0), positions[:0]) is None


@given(row=st.integers(0, 10), column=st.integers(0, 22), back=st.floats(0.1, 5))
@settings(max_examples=60)
def test_a_pixel_of_the_picture_in_a_frustum(row, column, back):
    frame, distance = made(np.ones((11, 23))), 0.4
    place = distance * np.array([(column - 11) / 30, (row - 5) / 30, 1])
    eye = np.array([0.3, -0.2, distance - back])
    found = find_clicked_pixel(eye, place - eye, frame, distance)
    assert found[:2] == (row, column)
    assert found[2] == pytest.approx(np.linalg.norm(place - eye))
    assert find_clicked_pixel(eye, eye - place, frame, distance) is None
    assert find_clicked_pixel(eye, (1, 0, 0), frame, distance) is None


def test_clicks_outside_the_picture_hit_no_pixel():
    frame = made(np.ones((11, 23)))
    assert find_clicked_pixel((0, 0, -1), (0.9, 0, 1), frame, 0.4) is None


def test_a_frustum_has_the_volume_of_its_scale():
    fov, aspect = field_of_view(made(np.ones((11, 23))))
    distance = 0.7
    y = distance * np.tan(fov / 2)
    assert frustum_scale(fov, aspect, distance) ** 3 == pytest.approx(y * y * aspect * distance / 3)
