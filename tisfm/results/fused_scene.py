"""Points or a surface of several frames: read from a file, or fused."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.formats import FormatError
from tisfm.formats.glb import srgb_from_light
from tisfm.reconstruction.result.reconstruction import Reconstruction

FusedKind = Literal["points", "surface"]
KINDS: tuple[FusedKind, ...] = get_args(FusedKind)
FILE_NAMES: dict[FusedKind, tuple[str, ...]] = {
    "points": ("points.ply",),
    "surface": ("mesh.ply", "mesh.glb"),
}
# Set by hand, so that a browser answers without delay.
MAX_KEYFRAMES = 60  # keyframes that are fused
MAX_POINTS = 500_000
MAX_FACES = 300_000
_SIDE_FACTOR = 1.3  # ratio of the cube sides of two successive attempts to thin a surface


@dataclass(frozen=True, kw_only=True, eq=False)
class FusedScene:
    """Points of several frames in the world, or a surface through them."""

    positions: NDArray[np.float32]  # (N, 3) float32: in the axes and the unit of the poses
    colors: NDArray[np.uint8]  # (N, 3) uint8
    faces: NDArray[np.int32] | None  # (M, 3) int32; None for points
    origin: str  # its source, in words: a file, or keyframes
    point_share: float = 1.0  # share of the points after thinning


def read_fused(folder: Path, kind: FusedKind) -> FusedScene | None:
    """Return the points or the surface that `tisfm reconstruct` wrote; None without such a file.

    Raises tisfm.formats.FormatError if the file is damaged.
    """
    path = next((folder / name for name in FILE_NAMES[kind] if (folder / name).is_file()), None)
    if path is None:
        return None
    from trimesh import load_scene

    try:
        (geometry,) = load_scene(path, process=False).geometry.values()
        colors = geometry.colors if kind == "points" else _vertex_colors(geometry.visual)
        positions = np.asarray(geometry.vertices, np.float32)
        colors = np.asarray(colors).reshape(-1, np.shape(colors)[-1])[:, :3]
        if path.suffix == ".glb":  # Y points up there, and colours are linear light
            positions = positions * np.array((1, -1, -1), np.float32)
            colors = srgb_from_light(colors)
        else:
            colors = colors.astype(np.uint8)
        scene = FusedScene(
            positions=positions,
            colors=colors,
            faces=None if kind == "points" else np.asarray(geometry.faces, np.int32),
            origin=path.name,
        )
    except Exception as error:  # trimesh raises errors of many kinds
        reason = " ".join(str(error).split())
        raise FormatError(f"{path} is damaged or of another kind: {reason}") from error
    if scene.colors.shape != scene.positions.shape:
        raise FormatError(f"{path} has {len(scene.colors)} colours of {len(positions)} points")
    return scene


def _vertex_colors(visual: Any) -> Any:
    """Return the colours of vertices; trimesh keeps them elsewhere if there is a material."""
    if hasattr(visual, "vertex_colors"):
        return visual.vertex_colors
    return visual.vertex_attributes["color"]


def fuse_keyframes(result: Reconstruction, kind: FusedKind, number: int) -> FusedScene:
    """Fuse the keyframes that are nearest in time to a frame, of the same piece.

    Raises ImportError if scikit-image is missing, for a surface.

    Raises OSError, ValueError if there are no keyframes, or a frame cannot be read.
    """
    piece = int(result.piece[number])
    keyframes = [k for k in result.keyframes if result.piece[k] == piece >= 0]
    if not keyframes:
        raise InputError("the piece of this frame has no keyframes to fuse")
    nearest_keyframes = sorted(sorted(keyframes, key=lambda k: abs(k - number))[:MAX_KEYFRAMES])
    origin = f"{len(nearest_keyframes)} of {len(keyframes)} keyframes, fused"
    if kind == "points":
        points = result.points(nearest_keyframes)
        return FusedScene(
            positions=points.positions, colors=points.colors, faces=None, origin=origin
        )
    mesh = result.mesh(nearest_keyframes)
    return FusedScene(positions=mesh.vertices, colors=mesh.colors, faces=mesh.faces, origin=origin)


def limit_size(
    scene: FusedScene, *, points: int = MAX_POINTS, faces: int = MAX_FACES
) -> FusedScene:
    """Return at most `points` points, or a coarser surface with at most `faces` faces."""
    if scene.faces is None:
        if len(scene.positions) <= points:
            return scene
        selection = np.sort(np.random.default_rng(0).permutation(len(scene.positions))[:points])
        return replace(
            scene,
            positions=scene.positions[selection],
            colors=scene.colors[selection],
            point_share=points / len(scene.positions),
        )
    if len(scene.faces) <= faces:
        return scene
    edges = scene.positions[scene.faces[:, 0]] - scene.positions[scene.faces[:, 1]]
    side = float(np.median(np.linalg.norm(edges, axis=1))) or 1.0
    coarse_scene = scene
    while coarse_scene.faces is not None and len(coarse_scene.faces) > faces:
        side *= _SIDE_FACTOR
        coarse_scene = _cluster_vertices(scene, side)
    return coarse_scene


def clip_to_box(
    scene: FusedScene, box: tuple[NDArray[np.float64], NDArray[np.float64]] | None
) -> FusedScene:
    """Return the part inside a box; everything without a box."""
    if box is None:
        return scene
    box_min, box_max = box
    is_inside = ((scene.positions >= box_min) & (scene.positions <= box_max)).all(axis=1)
    faces = None
    if scene.faces is not None:
        numbers = np.cumsum(is_inside, dtype=np.int32) - 1
        is_kept = np.asarray(is_inside)[scene.faces].all(axis=1)
        faces = numbers[scene.faces[is_kept]]
    return replace(
        scene, positions=scene.positions[is_inside], colors=scene.colors[is_inside], faces=faces
    )


def _cluster_vertices(scene: FusedScene, side: float) -> FusedScene:
    """Return a surface whose vertices are the means of all vertices in a cube of this side."""
    assert scene.faces is not None
    cubes = np.floor(scene.positions / side).astype(np.int64)
    _, cube_of_vertex, vertex_counts = np.unique(
        cubes, axis=0, return_inverse=True, return_counts=True
    )
    cube_of_vertex = cube_of_vertex.reshape(-1)
    means = [
        np.stack([np.bincount(cube_of_vertex, column) for column in values.T.astype(float)], axis=1)
        / vertex_counts[:, None]
        for values in (scene.positions, scene.colors)
    ]
    faces = cube_of_vertex[scene.faces].astype(np.int32)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return replace(
        scene,
        positions=means[0].astype(np.float32),
        colors=np.rint(means[1]).astype(np.uint8),
        faces=faces,
        point_share=len(vertex_counts) / len(scene.positions),
    )
