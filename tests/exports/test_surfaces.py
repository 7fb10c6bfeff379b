"""Points as others read them."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.exports.made import made
from tests.trajectory.paths import PATIENT
from tisfm.exports import write_meshes, write_points
from tisfm.exports.surfaces import save_points
from tisfm.formats.srgb import linear_from_srgb
from tisfm.point_cloud import PointCloud


def cloud(count=7):
    rng = np.random.default_rng(0)
    return PointCloud(
        positions=rng.normal(size=(count, 3)).astype(np.float32),
        colors=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        confidence=np.ones(count, np.float32),
    )


def rounded_light(colors):
    """Return the light of colours in 8 bits, as trimesh has it."""
    return np.rint(255 * linear_from_srgb()[colors])


def test_a_glb_of_points_has_y_up(tmp_path):
    points = cloud()
    save_points(points, tmp_path / "a.glb")
    (found,) = trimesh.load(tmp_path / "a.glb").geometry.values()
    np.testing.assert_array_equal(found.vertices, points.positions * np.float32([1, -1, -1]))
    np.testing.assert_array_equal(found.colors[:, :3], rounded_light(points.colors))
    save_points(points, tmp_path / "a.ply")
    found = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.vertices, points.positions)


@PATIENT
@given(data=st.data())
def test_points_survive_their_files(tmp_path_factory, data):
    count = data.draw(st.integers(1, 30))
    finite = st.floats(-1e6, 1e6, width=32)
    points = PointCloud(
        positions=data.draw(arrays(np.float32, (count, 3), elements=finite)),
        colors=data.draw(arrays(np.uint8, (count, 3))),
        confidence=data.draw(arrays(np.float32, count, elements=st.floats(0, 1, width=32))),
    )
    place = tmp_path_factory.mktemp("points")
    for name, signs in (("a.ply", (1, 1, 1)), ("a.glb", (1, -1, -1))):
        save_points(points, place / name)
        found = trimesh.load(place / name)
        if isinstance(found, trimesh.Scene):
            (found,) = found.geometry.values()
        np.testing.assert_array_equal(found.vertices, points.positions * np.float32(signs))
        kept = rounded_light(points.colors) if name == "a.glb" else points.colors
        np.testing.assert_array_equal(found.colors[:, :3], kept)
    raw = trimesh.load(place / "a.ply").metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(np.ravel(raw["confidence"]), points.confidence)


@pytest.mark.parametrize(("name", "count"), [("a.glb", 0), ("a.obj", 3)])
def test_values_that_files_cannot_hold_are_refused(tmp_path, name, count):
    with pytest.raises(ValueError, match=name):
        save_points(cloud(count), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_points_and_surface_of_a_film(found, tmp_path):
    ply, glb = (write_points(found, tmp_path, suffix=suffix)[0] for suffix in ("ply", "glb"))
    one, other = trimesh.load(ply).vertices, trimesh.load(glb).geometry.popitem()[1].vertices
    assert len(one) > 5000
    np.testing.assert_array_equal(one * np.float32([1, -1, -1]), other)
    pytest.importorskip("skimage")
    ply, glb = (write_meshes(found, tmp_path, suffix=suffix)[0] for suffix in ("ply", "glb"))
    one, other = trimesh.load(ply), trimesh.load(glb, force="mesh")
    assert len(one.faces) > 1000
    np.testing.assert_allclose(one.bounds[:, 0], other.bounds[:, 0], rtol=1e-6)
    np.testing.assert_allclose(one.bounds[::-1, 1], -other.bounds[:, 1], rtol=1e-6)


def test_results_without_points_are_errors(tmp_path):
    result = made(tmp_path / "walk", with_depth=())
    with pytest.raises(ValueError, match="gives no points"):
        write_points(result, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]
