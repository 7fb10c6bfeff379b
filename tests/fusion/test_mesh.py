"""Meshes of what views show, and the files that keep them."""

import builtins
import dataclasses
import hashlib

import numpy as np
import pytest
import trimesh

from tests.fusion.rooms import completeness, noisy_views, poses_in_room, relative_error, room_view
from tests.fusion.test_points import wall, walls
from tisfm.formats.glb import srgb_from_light
from tisfm.fusion import Mesh, fused_mesh, signed_distance
from tisfm.fusion.depth_views import PosedViews
from tisfm.fusion.isosurface import extract_surface
from tisfm.fusion.signed_distance import DistanceField, block_coordinates, block_numbers


def bits():
    rendered = [(pose, room_view(pose, 31, 47)) for pose in poses_in_room(6)]
    mesh = fused_mesh(noisy_views(rendered, outliers=0.05))
    assert len(mesh.faces) > 500
    parts = (mesh.vertices, mesh.faces, mesh.colors)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def samples(mesh, number=20000):
    """Return points on the mesh, as many per area everywhere."""
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return trimesh.sample.sample_surface(surface, number, seed=0)[0]


def some_mesh():
    vertices = np.array([[0, 0, 2], [1, 0, 2], [0, 1, 2.5]], np.float32)
    return Mesh(
        vertices=vertices,
        faces=np.array([[0, 1, 2]], np.int32),
        colors=np.array([[1, 2, 3], [40, 50, 60], [255, 0, 128]], np.uint8),
        voxel=0.1,
    )


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_mesh_of_a_room(rendered, outliers):
    mesh = fused_mesh(noisy_views(rendered, outliers=outliers))
    error = relative_error(samples(mesh), rendered)
    assert np.mean(error < 0.02) > 0.95
    assert np.median(error) < 0.004
    assert completeness(mesh.vertices, rendered) > 0.85
    # No face bridges the gap between a box and what it hides.
    edges = mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)]
    assert np.linalg.norm(edges, axis=2).max() < 2 * mesh.voxel


def test_views_that_differ_in_scale(rendered):
    """Each has an error of its own, the same at all pixels, as large as its deviation."""
    factors = 1 + 0.03 * np.random.default_rng(3).normal(size=len(rendered))
    views = [
        dataclasses.replace(
            view,
            inverse_depth=view.inverse_depth * np.float32(factor),
            inverse_depth_std=3 * view.inverse_depth_std,
        )
        for view, factor in zip(noisy_views(rendered), factors, strict=True)
    ]
    mesh = fused_mesh(views)
    error = relative_error(samples(mesh), rendered)
    assert np.median(error) < 0.015 and np.mean(error < 0.04) > 0.95
    assert completeness(mesh.vertices, rendered, within=0.04) > 0.85


def test_colors_are_those_of_the_frames(rendered):
    mesh = fused_mesh(noisy_views(rendered, noise=0.001))
    pose, (_, frame, camera) = rendered[0]
    height, width = frame.shape
    x, y, z = ((mesh.vertices - pose[:3, 3]) @ pose[:3, :3]).T
    inside = (z > 0) & (np.abs(x / z) < 0.7) & (np.abs(y / z) < 0.5)
    column, row = (
        np.rint(camera.focal * a[inside] / z[inside] + c).astype(int)
        for a, c in ((x, (width - 1) / 2), (y, (height - 1) / 2))
    )
    assert np.corrcoef(frame[row, column], mesh.colors[inside, 0])[0, 1] > 0.9


def sphere(radius=10.3, center=(2.2, -3.1, 1.7)):
    """A field about a sphere, in voxels of 1, with negative coordinates."""
    low = np.array(np.meshgrid(*[np.arange(-3, 3)] * 3, indexing="ij")).reshape(3, -1).T
    numbers = np.sort(block_numbers(low.astype(np.int64)))
    offsets = np.array(list(np.ndindex(8, 8, 8)))
    at = block_coordinates(numbers)[:, None] * 8 + offsets
    distance = np.clip((np.linalg.norm(at - center, axis=2) - radius) / 4, -1, 1)
    views = np.full(distance.shape, 2, np.int32)
    return DistanceField(
        voxel=1.0, numbers=numbers, distance=distance.astype(np.float32), views=views
    )


def test_the_surface_of_a_sphere_is_whole():
    vertices, faces = extract_surface(sphere(), 2)
    np.testing.assert_allclose(np.linalg.norm(vertices - (2.2, -3.1, 1.7), axis=1), 10.3, atol=0.03)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2
    # Outwards, where distances are positive; a little less than the sphere holds.
    assert 0.98 < mesh.volume / (4 / 3 * np.pi * 10.3**3) < 1


def test_a_sphere_through_voxels_is_whole():
    """Distances of exactly zero, where a vertex would belong to several edges."""
    vertices, faces = extract_surface(sphere(radius=10.0, center=(0.0, 0.0, 0.0)), 2)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.euler_number == 2


def test_the_surface_in_several_batches_is_the_same(monkeypatch):
    from tisfm.fusion import isosurface

    expected = extract_surface(sphere(), 2)
    monkeypatch.setattr(isosurface, "_BATCH_SIDE", 3)
    found = extract_surface(sphere(), 2)
    np.testing.assert_allclose(found[0], expected[0], atol=1e-5)
    np.testing.assert_array_equal(np.sort(found[1].ravel()), np.sort(expected[1].ravel()))


def test_the_surface_is_open_where_too_few_views_look():
    assert len(extract_surface(sphere(), 3)[1]) == 0
    field = sphere()
    field.views[block_coordinates(field.numbers)[:, 0] >= 0] = 1
    vertices, _ = extract_surface(field, 2)
    assert vertices[:, 0].max() <= 0 and len(vertices) > 100


def test_numbers_of_blocks():
    at = np.array([[0, 0, 0], [-1, 5, 2**16 - 1], [-(2**16), 1, -7]])
    np.testing.assert_array_equal(block_coordinates(block_numbers(at)), at)


def test_normals_point_to_the_views():
    mesh = fused_mesh(walls(3, size=(30, 40)))
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert len(surface.faces) > 100
    np.testing.assert_allclose(surface.face_normals, [[0, 0, -1]] * len(mesh.faces), atol=1e-3)
    # The wall goes through voxels, from which the surface is kept 1/1024 truncations away.
    np.testing.assert_allclose(mesh.vertices[:, 2], 2, atol=4 * mesh.voxel / 1000)
    assert (mesh.colors == (10, 20, 30)).all()


def test_mistakes_of_one_view_vanish():
    views = walls(4, size=(30, 40))
    inverse_depth = views[0].inverse_depth.copy()
    inverse_depth[10:20, 10:20] = 1 / 0.9  # a patch before the wall, which others see through
    wrong = dataclasses.replace(views[0], inverse_depth=inverse_depth)
    mesh = fused_mesh([wrong, *views[1:]])
    assert len(mesh.faces) > 100 and mesh.vertices[:, 2].min() > 1.99


def test_depth_is_not_bridged():
    """Half of the views' image is nearer: no face lies between."""
    inverse_depth = np.full((30, 40), 0.5, np.float32)
    inverse_depth[:, 20:] = 1.0
    mesh = fused_mesh([wall(inverse_depth=inverse_depth, size=(30, 40))] * 2)
    z = mesh.vertices[mesh.faces][..., 2]
    assert (z.min(axis=1) < 1.1).any() and (z.max(axis=1) > 1.9).any()
    assert not ((z.min(axis=1) < 1.5) & (z.max(axis=1) > 1.5)).any()
    assert np.mean((z > 1.05) & (z < 1.95)) < 0.05


def test_few_views():
    assert len(fused_mesh([]).faces) == 0
    assert len(fused_mesh([wall(pose=np.full((4, 4), np.nan))]).faces) == 0
    assert len(fused_mesh([wall(inverse_depth=np.full((9, 13), np.nan, np.float32))]).faces) == 0
    assert len(fused_mesh([wall(size=(30, 40))]).faces) > 100


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (6, 1), (5, 8), (31, 17)])
def test_any_size(size):
    mesh = fused_mesh([wall(size=size) for _ in range(3)])
    assert (len(mesh.faces) > 0) == (min(size) >= 5)


def test_contradicting_views_leave_no_surface():
    assert len(fused_mesh([wall(depth=z, size=(30, 40)) for z in (1, 1.5, 2, 3)]).faces) == 0


def test_options_change_the_mesh(rendered):
    views = noisy_views(rendered[:5])
    usual = fused_mesh(views)
    coarse = fused_mesh(views, voxel=0.2)
    assert coarse.voxel == pytest.approx(0.2) and len(coarse.faces) < len(usual.faces) / 4
    assert len(fused_mesh(views, agreeing=5).faces) < len(usual.faces)
    assert len(fused_mesh(views, max_relative_std=0.005).faces) == 0
    assert fused_mesh(views, max_depth=1.0).vertices[:, 2].max() < usual.vertices[:, 2].max()
    uncertain = [wall(std=0.4, size=(30, 40))] * 3
    assert fused_mesh(uncertain, max_relative_std=0.5).voxel == pytest.approx(0.5 * 0.4 * 2)
    wide = fused_mesh(views, truncation=1.0)
    assert not np.array_equal(wide.vertices[:50], usual.vertices[:50])


def test_coverage_changes_the_mesh(rendered):
    """A complete mesh keeps surfaces of one view; a strict mesh needs three views."""
    views = noisy_views(rendered[:5])
    strict, usual, complete = (
        fused_mesh(views, coverage=coverage) for coverage in ("strict", "normal", "complete")
    )
    assert len(strict.faces) < len(usual.faces) < len(complete.faces)
    share = completeness(complete.vertices, rendered[:5], within=0.05)
    assert share > completeness(usual.vertices, rendered[:5], within=0.05) + 0.02


def test_a_view_that_others_contradict_gives_no_surface():
    """Three of four views agree; complete leaves out the depth of the fourth before them."""
    inverse_depth = np.full((30, 40), 1 / 1.5, np.float32)
    wrong = wall(inverse_depth=inverse_depth, inverse_depth_std=0.01 * inverse_depth, size=(30, 40))
    mesh = fused_mesh([wrong, *walls(3, size=(30, 40))], coverage="complete")
    assert len(mesh.faces) > 100 and mesh.vertices[:, 2].min() > 1.9


def test_the_unit_of_length_is_of_no_matter():
    small = [
        wall(1e-4 * n, inverse_depth=np.full((30, 40), 500, np.float32),
             inverse_depth_std=np.full((30, 40), 5, np.float32), size=(30, 40))
        for n in range(3)
    ]  # fmt: skip
    found, expected = fused_mesh(small), fused_mesh(walls(3, size=(30, 40)))
    assert found.voxel == pytest.approx(expected.voxel / 1000)
    assert abs(len(found.faces) - len(expected.faces)) < 0.02 * len(expected.faces)


def test_voxels_that_fill_too_much_are_refused(monkeypatch):
    monkeypatch.setattr(signed_distance, "MAX_BLOCKS", 20)
    views = walls(3, size=(30, 40))
    with pytest.raises(ValueError, match=r"voxel is 0.05: .* give at least 0\.") as error:
        fused_mesh(views, voxel=0.05)
    advised = float(str(error.value).split("at least ")[1].split(",")[0])
    assert fused_mesh(views, voxel=1.2 * advised).voxel == pytest.approx(1.2 * advised)
    with pytest.raises(ValueError, match="voxel is 1e-07: "):
        fused_mesh(views, voxel=1e-7)
    with pytest.raises(ValueError, match=r"voxel is 0\.001: "):
        fused_mesh(views, voxel=1e-3, truncation=1.0)
    # By default they are made as large as they must be.
    usual = 2 * 2 / 20  # 2 px
    assert fused_mesh(views).voxel == pytest.approx(usual)
    monkeypatch.setattr(signed_distance, "MAX_BLOCKS", 8)
    assert fused_mesh(views).voxel > 1.09 * usual


def test_candidates_of_one_view_are_dropped_where_they_are_too_many(monkeypatch):
    views = [*walls(3, size=(30, 40)), wall(depth=1.0, size=(30, 40))]
    expected = fused_mesh(views, voxel=0.1)
    count = len(
        signed_distance._select_blocks(
            PosedViews(views, max_relative_std=0.1, max_depth=None), 0.05, 0.2, 1
        )
    )
    monkeypatch.setattr(signed_distance, "MAX_CANDIDATES", count - 1)
    found = fused_mesh(views, voxel=0.1)
    assert len(expected.faces) > 100
    np.testing.assert_array_equal(found.faces, expected.faces)
    monkeypatch.setattr(signed_distance, "MAX_CANDIDATES", 5)
    with pytest.raises(ValueError, match=r"voxel is 0\.1: "):
        fused_mesh(views, voxel=0.1)


def test_the_same_bits_twice():
    assert bits() == bits()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"agreeing": 0}, ValueError),
        ({"coverage": "some"}, ValueError),
        ({"voxel": 0}, ValueError),
        ({"voxel": "fine"}, TypeError),
        ({"truncation": np.nan}, ValueError),
        ({"max_depth": -1}, ValueError),
    ],
)
def test_options_are_checked(options, error):
    with pytest.raises(error, match=f"{next(iter(options))} is .*: expected"):
        fused_mesh(walls(), **options)


def test_a_missing_library_is_named(monkeypatch):
    real = builtins.__import__

    def missing(name, *arguments, **options):
        if name.startswith("skimage"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'tisfm\[mesh\]'"):
        fused_mesh(walls())


# Files


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".PLY"])
def test_files_hold_the_mesh(tmp_path, suffix):
    mesh = some_mesh()
    mesh.save(tmp_path / f"mesh{suffix}")
    scene = trimesh.load_scene(tmp_path / f"mesh{suffix}", process=False)
    (read,) = scene.geometry.values()
    up = np.array([1, -1, -1]) if suffix == ".glb" else 1
    np.testing.assert_allclose(read.vertices, mesh.vertices * up)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    if suffix == ".glb":
        light = read.visual.vertex_attributes["color"]
        np.testing.assert_array_equal(srgb_from_light(light), mesh.colors)
    else:
        np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], mesh.colors)
    assert [p.name for p in tmp_path.iterdir()] == [f"mesh{suffix}"]


def test_the_same_mesh_gives_the_same_file(tmp_path):
    for suffix in (".ply", ".glb"):
        some_mesh().save(tmp_path / f"0{suffix}")
        some_mesh().save(tmp_path / f"1{suffix}")
        assert (tmp_path / f"0{suffix}").read_bytes() == (tmp_path / f"1{suffix}").read_bytes()


def test_an_empty_mesh_is_a_ply_file_alone(tmp_path):
    empty = fused_mesh([])
    empty.save(tmp_path / "empty.ply")
    assert b"element vertex 0" in (tmp_path / "empty.ply").read_bytes()
    with pytest.raises(ValueError, match="cannot hold an empty mesh"):
        empty.save(tmp_path / "empty.glb")


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"mesh.obj: expected a name in .ply or .glb"):
        some_mesh().save(tmp_path / "mesh.obj")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        some_mesh().save(tmp_path / "nowhere" / "mesh.ply")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.zeros((3, 2), np.float32)}, r"vertices is \(3, 2\)"),
        ({"faces": np.zeros((1, 3))}, r"faces is \(1, 3\) float64"),
        ({"faces": np.array([[0, 1, 3]], np.int32)}, "faces has vertices 0 to 3: expected 0 to 2"),
        ({"colors": np.zeros((2, 3), np.uint8)}, r"colors is \(2, 3\)"),
    ],
)
def test_arrays_are_checked(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(some_mesh(), **change)
