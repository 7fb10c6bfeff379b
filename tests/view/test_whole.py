"""What several frames show together: files, what is fused, what is thinned and clipped."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh import Trimesh

from tests.view.results import film, write_reconstruction
from tisfm.formats import FormatError
from tisfm.formats.glb import glb_surface
from tisfm.formats.srgb import linear_from_srgb
from tisfm.fusion import Mesh
from tisfm.point_cloud import PointCloud
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.results.fused_scene import (
    FusedScene,
    clip_to_box,
    fuse_keyframes,
    limit_size,
    read_fused,
)
from tisfm.results.opening import open_result


def some_points(count=50):
    generator = np.random.default_rng(3)
    return PointCloud(
        positions=generator.normal(size=(count, 3)).astype(np.float32),
        colors=generator.integers(0, 256, (count, 3), np.uint8),
        confidence=np.ones(count, np.float32),
    )


def sheet(side):
    """A flat surface of side × side vertices."""
    rows, columns = np.mgrid[:side, :side]
    positions = np.stack([columns, rows, 0 * rows], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (side * rows + columns)[:-1, :-1].ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + side, corner + 1], axis=1),
            np.stack([corner + 1, corner + side, corner + side + 1], axis=1),
        ]
    ).astype(np.int32)
    colors = np.tile(np.array((10, 200, 30), np.uint8), (len(positions), 1))
    return FusedScene(positions=positions, colors=colors, faces=faces, origin="made")


def area(whole):
    a, b, c = (whole.positions[whole.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def test_files_are_read_as_they_were_written(tmp_path):
    assert read_fused(tmp_path, "points") is None and read_fused(tmp_path, "surface") is None
    points = some_points()
    points.save(tmp_path / "points.ply")
    found = read_fused(tmp_path, "points")
    np.testing.assert_array_equal(found.positions, points.positions)
    np.testing.assert_array_equal(found.colors, points.colors)
    assert found.faces is None and found.origin == "points.ply"
    made = sheet(4)
    mesh = Mesh(vertices=made.positions + 1, faces=made.faces, colors=made.colors, voxel=1.0)
    for name in ("mesh.glb", "mesh.ply"):
        mesh.save(tmp_path / name)
        found = read_fused(tmp_path, "surface")
        assert found.origin == name
        np.testing.assert_allclose(found.positions, mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(found.faces, mesh.faces)
        assert found.colors.dtype == np.uint8
        np.testing.assert_array_equal(found.colors, mesh.colors)


def test_a_surface_of_before_whose_light_has_8_bits_is_read(tmp_path):
    made = sheet(4)
    light = np.rint(255 * linear_from_srgb()[made.colors]).astype(np.uint8)
    old = Trimesh(made.positions, made.faces, vertex_colors=light, process=False)
    (tmp_path / "mesh.glb").write_bytes(old.export(file_type="glb"))
    found = read_fused(tmp_path, "surface")
    np.testing.assert_allclose(found.colors.astype(int), made.colors, atol=4)


@pytest.mark.parametrize(("name", "kind"), [("points.ply", "points"), ("mesh.glb", "surface")])
@pytest.mark.parametrize("data", [b"", b"ply\n", b"glTF\x02\x00\x00\x00"])
def test_damaged_files_are_stated(tmp_path, name, kind, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError, match=name):
        read_fused(tmp_path, kind)


@given(most=st.integers(1, 200))
def test_few_points_are_kept(most):
    points = some_points(100)
    whole = FusedScene(positions=points.positions, colors=points.colors, faces=None, origin="")
    few = limit_size(whole, points=most)
    assert len(few.positions) == len(few.colors) == min(most, 100)
    assert few.point_share == min(most, 100) / 100
    known = {tuple(place): tuple(color) for place, color in zip(*_lists(whole), strict=True)}
    assert all(
        known[tuple(place)] == tuple(color) for place, color in zip(*_lists(few), strict=True)
    )


def _lists(whole):
    return whole.positions.tolist(), whole.colors.tolist()


@pytest.mark.parametrize("most", [10_000, 300, 40])
def test_a_coarser_surface_is_much_the_same(most):
    whole = sheet(41)
    coarse = limit_size(whole, faces=most)
    assert 0 < len(coarse.faces) <= max(most, 1)
    assert coarse.faces.max() < len(coarse.positions) == len(coarse.colors)
    assert area(coarse) == pytest.approx(area(whole), rel=0.6)
    assert (coarse.colors == (10, 200, 30)).all()
    if most > len(whole.faces):
        assert coarse is whole


@given(low=st.floats(-2, 1), wide=st.floats(0, 3))
def test_clipped_points_lie_in_the_box(low, wide):
    box = np.full(3, low), np.full(3, low + wide)
    points = some_points()
    whole = FusedScene(positions=points.positions, colors=points.colors, faces=None, origin="")
    inside = clip_to_box(whole, box)
    assert ((inside.positions >= low) & (inside.positions <= low + wide)).all()
    expected = ((points.positions >= low) & (points.positions <= low + wide)).all(axis=1)
    assert len(inside.positions) == expected.sum()
    assert clip_to_box(whole, None) is whole


def test_a_clipped_surface_has_the_faces_that_lie_inside():
    whole = sheet(5)
    inside = clip_to_box(whole, (np.array((0, 0, -1.0)), np.array((2, 4, 1.0))))
    assert area(inside) == pytest.approx(8)
    assert inside.positions[:, 0].max() == 2


def test_keyframes_of_the_piece_are_fused(tmp_path, monkeypatch):
    write_reconstruction(tmp_path / "r", changes={"keyframes": (0, 1, 2, 3, 4)})
    result = Reconstruction.load(tmp_path / "r")
    whole = fuse_keyframes(result, "points", 0)
    assert len(whole.positions) > 500 and whole.origin == "5 of 5 keyframes, fused"
    truth = film()
    for place in whole.positions[:: len(whole.positions) // 20]:  # each is on what a frame shows
        errors = []
        for pose, depth in zip(truth.poses, truth.depth, strict=True):
            x, y, z = pose[:3, :3].T @ (place - pose[:3, 3])
            cx, cy = truth.camera.center_for(*depth.shape)
            row, column = (
                round(truth.camera.focal * y / z + cy), round(truth.camera.focal * x / z + cx)
            )  # fmt: skip
            if z > 0 and 0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]:
                errors.append(abs(depth[row, column] / z - 1))
        assert min(errors) < 0.05
    monkeypatch.setattr("tisfm.results.fused_scene.MAX_KEYFRAMES", 3)
    assert fuse_keyframes(result, "points", 4).origin == "3 of 5 keyframes, fused"


def test_results_without_keyframes_are_not_fused(tmp_path):
    write_reconstruction(tmp_path / "r", changes={"keyframes": ()})
    with pytest.raises(ValueError, match="no keyframes"):
        open_result(tmp_path / "r").fused("points", 0)


def test_written_points_are_preferred_to_fusion(tmp_path):
    write_reconstruction(tmp_path / "r")
    points = some_points()
    points.save(tmp_path / "r" / "points.ply")
    assert len(open_result(tmp_path / "r").fused("points", 3).positions) == len(points)


def test_the_surface_has_its_colours_in_the_browser():
    from io import BytesIO

    from trimesh import load_scene

    whole = sheet(3)
    data = glb_surface(whole.positions, whole.faces, whole.colors)
    (mesh,) = load_scene(BytesIO(data), file_type="glb", process=False).geometry.values()
    light = mesh.visual.vertex_attributes["color"]
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(255 * shown, whole.colors, atol=0.01)
    assert b"KHR_materials_unlit" in data and len(mesh.faces) == len(whole.faces)
