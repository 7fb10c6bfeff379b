"""Points of a frame: where they are, which are left, and the surface between them."""

import io

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.view.results import write_run
from tisfm.camera import Camera
from tisfm.results.frame import ResultFrame
from tisfm.results.opening import open_result
from tisfm.status import Status
from tisfm.view.colors import Ranges
from tisfm.view.frame_cloud import PointFilter, frame_cloud, surface_file, triangles_between

RANGES = Ranges(inverse_depth=1.0, flow=1.0)


def made(inverse_depth, **parts):
    """A frame of this inverse depth."""
    inverse_depth = np.asarray(inverse_depth, np.float32)
    random = np.random.default_rng(0)
    given = {
        "number": 0,
        "picture": random.integers(0, 256, (*inverse_depth.shape, 3)).astype(np.uint8),
        "camera": Camera(focal=30.0, center=(11.0, 5.0)),
        "inverse_depth": inverse_depth,
        "status": Status("converged"),
    }
    return ResultFrame(**{**given, **parts})


@given(
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    most=st.integers(1, 500),
    scale=st.floats(0.1, 10),
    seed=st.integers(0, 99),
)
@settings(max_examples=60)
def test_points_project_to_their_pixels(height, width, most, scale, seed):
    random = np.random.default_rng(seed)
    inverse = random.uniform(0.5, 1.5, (height, width))
    inverse[random.uniform(size=inverse.shape) < 0.2] = np.nan
    frame = made(inverse, scale=scale)
    points = frame_cloud(frame, "image", RANGES, PointFilter(max_points=most))
    x, y, z = points.positions.T
    rows, columns = points.pixels.T
    np.testing.assert_allclose(30 * x / z + 11, columns, atol=1e-3)
    np.testing.assert_allclose(30 * y / z + 5, rows, atol=1e-3)
    np.testing.assert_allclose(scale / z, inverse[rows, columns], rtol=1e-5)
    np.testing.assert_array_equal(points.colors, frame.picture[rows, columns])
    whole = frame_cloud(frame, "image", RANGES, PointFilter(max_points=10**9))
    assert len(whole) == np.isfinite(inverse).sum()
    assert whole.step == 1 and points.step >= 1


@pytest.mark.parametrize("most", [1, 10, 100, 1000, 5000])
def test_the_number_of_points_is_limited(most):
    points = frame_cloud(made(np.ones((60, 80))), "image", RANGES, PointFilter(max_points=most))
    assert 0.3 * min(most, 4800) <= len(points) <= 1.4 * most + 1


def test_thresholds_select_points(tmp_path):
    write_run(tmp_path, 1)
    frame = open_result(tmp_path).read(0)

    def left(**options):
        points = frame_cloud(frame, "image", RANGES, PointFilter(max_points=10**9, **options))
        mask = np.zeros(frame.shape, bool)
        mask[tuple(points.pixels.T)] = True
        return mask

    everything = left()
    expected = everything & (frame.confidence >= 0.5)
    np.testing.assert_array_equal(left(min_confidence=0.5), expected)
    np.testing.assert_array_equal(left(with_hidden=False), everything & ~frame.hidden)
    frame.inverse_depth_std[:20] = np.inf
    del frame.__dict__["relative_deviation"]
    sure = left(max_deviation=0.05)
    assert not sure[:20].any() and (sure[20:] == everything[20:]).all()
    assert not left(max_deviation=0.01).any()


def test_a_box_is_in_the_world():
    frame = made(np.full((11, 23), 0.5))
    pose = np.eye(4)
    pose[:3, 3] = 10, 0, 0
    box = np.array((10.0, -9, -9)), np.array((99.0, 9, 9))
    points = frame_cloud(frame, "image", RANGES, PointFilter(box=box), pose)
    assert (points.pixels[:, 1] >= 11).all() and len(points) == 11 * 12
    far = np.array((-9.0, -9, -9)), np.array((0.0, 9, 9))
    assert len(frame_cloud(frame, "image", RANGES, PointFilter(box=far), pose)) == 0


def test_a_frame_without_depth_has_no_points():
    points = frame_cloud(made(np.full((4, 5), np.nan)), "depth", RANGES, PointFilter())
    assert len(points) == 0 and points.size > 0
    assert len(triangles_between(points, (4, 5))) == 0


@pytest.mark.parametrize("most", [10**9, 60])
def test_a_surface_is_torn_where_depth_jumps(most):
    inverse = np.ones((20, 31))
    inverse[:, 15:] = 0.5
    points = frame_cloud(made(inverse), "image", RANGES, PointFilter(max_points=most))
    triangles = triangles_between(points, (20, 31))
    near = points.positions[:, 2][triangles] < 1.5
    assert len(triangles) and (near.all(axis=1) | (~near).all(axis=1)).all()
    rows, columns = -(-20 // points.step), -(-31 // points.step)
    left = -(-15 // points.step)
    assert len(triangles) == 2 * (rows - 1) * (left - 1 + columns - left - 1)


def test_a_surface_is_read_by_others_and_has_no_light():
    frame = made(np.ones((6, 8)))
    points = frame_cloud(frame, "image", RANGES, PointFilter())
    data = surface_file(points, triangles_between(points, (6, 8)), frame.picture)
    assert b"KHR_materials_unlit" in data
    read = trimesh.load(io.BytesIO(data), file_type="glb", force="mesh", process=False)
    np.testing.assert_allclose(np.sort(read.vertices, axis=0), np.sort(points.positions, axis=0))
    assert read.faces.shape == (2 * 5 * 7, 3)
    corner = np.argmin(points.pixels.sum(axis=1))
    uv = read.visual.uv[np.linalg.norm(read.vertices - points.positions[corner], axis=1).argmin()]
    assert uv == pytest.approx((0.5 / 8, 1 - 0.5 / 6), abs=1e-6)
