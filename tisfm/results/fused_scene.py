"""What all frames show together: points or a surface, read from a file or fused."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.formats import FormatError
from tisfm.formats.glb import srgb_from_light
from tisfm.reconstruction.result.reconstruction import Reconstruction

WholeKind = Literal["points", "surface"]
KINDS: tuple[WholeKind, ...] = get_args(WholeKind)
FILES: dict[WholeKind, tuple[str, ...]] = {
    "points": ("points.ply",),
    "surface": ("mesh.ply", "mesh.glb"),
}
MOST_VIEWS = 60  # keyframes that are fused when it is asked for
MOST_POINTS, MOST_FACES = 500_000, 300_000  # that browsers are given
_COARSER = 1.3  # times, until a surface has few enough faces


@dataclass(frozen=True, kw_only=True, eq=False)
class Whole:
    """Points of several frames in the world, or a surface through them.

    Attributes
    ----------
    positions : (N, 3) float32
        In the axes and the unit of the poses.
    colors : (N, 3) uint8
    faces : (M, 3) int32 or None
        None for points.
    origin : str
        Where it is from, in words.
    left : float
        Share of the points that are left.
    """

    positions: NDArray[np.float32]
    colors: NDArray[np.uint8]
    faces: NDArray[np.int32] | None
    origin: str
    left: float = 1.0


def stored_whole(folder: Path, kind: WholeKind) -> Whole | None:
    """Return what `tisfm reconstruct` wrote with ``--ply`` or ``--mesh``; None if it did not.

    Raises
    ------
    tisfm.formats.FormatError
        If the file is damaged.
    """
    path = next((folder / name for name in FILES[kind] if (folder / name).is_file()), None)
    if path is None:
        return None
    from trimesh import load_scene

    try:
        scene = load_scene(path, process=False)
        (geometry,) = scene.geometry.values()
        colors = geometry.colors if kind == "points" else _vertex_colors(geometry.visual)
        positions = np.asarray(geometry.vertices, np.float32)
        colors = np.asarray(colors).reshape(-1, np.shape(colors)[-1])[:, :3]
        if path.suffix == ".glb":  # there Y points up, and colours are amounts of light
            positions = positions * np.array((1, -1, -1), np.float32)
            colors = srgb_from_light(colors)
        else:
            colors = colors.astype(np.uint8)
        found = Whole(
            positions=positions,
            colors=colors,
            faces=None if kind == "points" else np.asarray(geometry.faces, np.int32),
            origin=path.name,
        )
    except Exception as error:  # trimesh fails in many ways
        reason = " ".join(str(error).split())
        raise FormatError(f"{path} is damaged or of another kind: {reason}") from error
    if found.colors.shape != found.positions.shape:
        raise FormatError(f"{path} has {len(found.colors)} colours of {len(positions)} points")
    return found


def _vertex_colors(visual: Any) -> Any:
    """Return the colours of vertices, which trimesh keeps elsewhere where there is a material."""
    if hasattr(visual, "vertex_colors"):
        return visual.vertex_colors
    return visual.vertex_attributes["color"]


def fused_whole(result: Reconstruction, kind: WholeKind, number: int) -> Whole:
    """Fuse the keyframes of a frame's piece that are nearest to it in time.

    Raises
    ------
    ImportError
        If scikit-image is missing, for a surface.
    OSError, ValueError
        If there is nothing to fuse, or a frame cannot be read.
    """
    piece = int(result.piece[number])
    keyframes = [k for k in result.keyframes if result.piece[k] == piece >= 0]
    if not keyframes:
        raise InputError("the piece of this frame has no keyframes to fuse")
    near = sorted(sorted(keyframes, key=lambda k: abs(k - number))[:MOST_VIEWS])
    origin = f"{len(near)} of {len(keyframes)} keyframes, fused"
    if kind == "points":
        points = result.points(near)
        return Whole(positions=points.positions, colors=points.colors, faces=None, origin=origin)
    mesh = result.mesh(near)
    return Whole(positions=mesh.vertices, colors=mesh.colors, faces=mesh.faces, origin=origin)


def thinned(whole: Whole, *, points: int = MOST_POINTS, faces: int = MOST_FACES) -> Whole:
    """Return fewer points, or a coarser surface, if there are more than so many."""
    if whole.faces is None:
        if len(whole.positions) <= points:
            return whole
        chosen = np.sort(np.random.default_rng(0).permutation(len(whole.positions))[:points])
        return replace(
            whole,
            positions=whole.positions[chosen],
            colors=whole.colors[chosen],
            left=points / len(whole.positions),
        )
    if len(whole.faces) <= faces:
        return whole
    edges = whole.positions[whole.faces[:, 0]] - whole.positions[whole.faces[:, 1]]
    side = float(np.median(np.linalg.norm(edges, axis=1))) or 1.0
    coarse = whole
    while coarse.faces is not None and len(coarse.faces) > faces:
        side *= _COARSER
        coarse = _clustered(whole, side)
    return coarse


def clipped(whole: Whole, box: tuple[NDArray[np.float64], NDArray[np.float64]] | None) -> Whole:
    """Return what lies in a box; all of it where there is none."""
    if box is None:
        return whole
    low, high = box
    inside = ((whole.positions >= low) & (whole.positions <= high)).all(axis=1)
    faces = None
    if whole.faces is not None:
        numbers = np.cumsum(inside, dtype=np.int32) - 1
        kept = np.asarray(inside)[whole.faces].all(axis=1)
        faces = numbers[whole.faces[kept]]
    return replace(
        whole, positions=whole.positions[inside], colors=whole.colors[inside], faces=faces
    )


def _clustered(whole: Whole, side: float) -> Whole:
    """Return a surface whose vertices within a cube of this side are one, their mean."""
    assert whole.faces is not None
    cubes = np.floor(whole.positions / side).astype(np.int64)
    _, inverse, count = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    means = [
        np.stack([np.bincount(inverse, column) for column in values.T.astype(float)], axis=1)
        / count[:, None]
        for values in (whole.positions, whole.colors)
    ]
    faces = inverse[whole.faces].astype(np.int32)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return replace(
        whole,
        positions=means[0].astype(np.float32),
        colors=np.rint(means[1]).astype(np.uint8),
        faces=faces,
        left=len(count) / len(whole.positions),
    )
