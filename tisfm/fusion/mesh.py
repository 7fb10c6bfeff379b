"""A mesh fused from depth maps, and the file that stores it."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm import runtime
from tisfm.checks import refuse_masked, whole
from tisfm.errors import InputError, MissingPackageError
from tisfm.formats import atomic_write
from tisfm.formats.glb import glb_surface
from tisfm.fusion.depth_views import DepthView, Views, check_positive
from tisfm.fusion.isosurface import surface_of
from tisfm.fusion.signed_distance import MOST_BLOCKS, Field, TooFineError, field_of

SUFFIXES = (".ply", ".glb")


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A surface of triangles.

    Attributes
    ----------
    vertices : (V, 3) float32
        In the world's axes.
    faces : (F, 3) int32
        Three vertices each, anticlockwise seen from outside, from where the surface was seen.
    colors : (V, 3) uint8
        Red, green, blue.
    voxel : float
        Edge of the voxels that it was taken from, in the unit of the vertices.

    Raises
    ------
    ValueError
        If the arrays are not of these shapes and types, a value is masked, or a face names a vertex
        that there is not.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    colors: NDArray[np.uint8]
    voxel: float

    def __post_init__(self) -> None:
        count = len(self.vertices)
        for name, shape, kind in (
            ("vertices", (count, 3), np.float32),
            ("faces", (len(self.faces), 3), np.int32),
            ("colors", (count, 3), np.uint8),
        ):
            array = getattr(self, name)
            refuse_masked(array, name, "leave out the faces that they belong to")
            if array.shape != shape or array.dtype != kind:
                raise InputError(
                    f"{name} is {array.shape} {array.dtype}: expected {shape} {np.dtype(kind).name}"
                )
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < count:
            raise InputError(
                f"faces has vertices {self.faces.min()} to {self.faces.max()}: expected 0 to "
                f"{count - 1}"
            )

    def __repr__(self) -> str:
        return f"Mesh of {len(self.vertices)} vertices and {len(self.faces)} faces"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a binary PLY or GLB file, whole or not at all.

        In a PLY file vertices are as they are here: where the first camera stood upright, Y points
        down. GLB wants Y up: Y and Z change sign.

        Parameters
        ----------
        path : path
            The file, with the suffix ``.ply`` or ``.glb``.

        Raises
        ------
        ValueError
            If the suffix is another, or a GLB file were to hold nothing.
        OSError
            If the folder does not exist or cannot be written to.
        """
        suffix = Path(path).suffix.lower()
        if suffix not in SUFFIXES:
            raise InputError(f"path is {os.fspath(path)}: expected a name in .ply or .glb")
        if suffix == ".glb" and not len(self.faces):
            raise InputError(f"path is {os.fspath(path)}: a GLB file cannot hold an empty mesh")
        content = self._glb() if suffix == ".glb" else self._ply()
        with atomic_write(path) as file:
            file.write(content)

    def _glb(self) -> bytes:
        return glb_surface(
            self.vertices * np.array([1, -1, -1], np.float32), self.faces, self.colors
        )

    def _ply(self) -> bytes:
        from trimesh import Trimesh  # takes a while to load
        from trimesh.exchange.ply import export_ply

        mesh = Trimesh(
            vertices=self.vertices, faces=self.faces, vertex_colors=self.colors, process=False
        )
        return bytes(export_ply(mesh, "binary", vertex_normal=False))


VOXEL = 2.0  # px at the median depth
FINEST = 0.5  # deviations of depth: finer voxels would show mistakes alone
TRUNCATION = 4.0  # voxels
DEVIATIONS = 3.0  # of depth that the truncation has room for
UNSEEN = 128  # grey of vertices that no view shows
_COARSER = 1.1  # at least, where a default was too fine


def fused_mesh(
    views: Sequence[DepthView],
    *,
    agreeing: int = 3,
    max_relative_std: float = 0.05,
    max_depth: float | None = 5.0,
    voxel: float | None = None,
    truncation: float | None = None,
) -> Mesh:
    """Fuse depth maps into a mesh, by a truncated field of signed distances.

    Voxels near the surface hold the mean of their distances from it, weighted by precision. What a
    view sees through counts as empty, so that single mistakes vanish. The mesh lies where the mean
    changes its sign, and is open where too few views look.

    Parameters
    ----------
    views : sequence of DepthView
        Anything with a length and items. Views are read one by one, four times each.
    agreeing : int, default 3
        How many views must show the surface at a place; all where there are fewer views.
    max_relative_std : float, default 0.05
        Depth of a larger deviation, relative to itself, is left out.
    max_depth : float, default 5
        Depth beyond so many median depths of its view is left out; None for no bound.
    voxel : float, optional
        Edge of a voxel, in the unit of the poses. By default 2 px at the median depth, or half the
        median deviation of depth where that is more, or what fills 1 GB; the result says which.
    truncation : float, optional
        How far from the surface the field reaches, in the unit of the poses. Things must be thicker
        than that. By default 4 voxels, or 3 median deviations of depth where that is more.

    Returns
    -------
    Mesh
        In the world's axes and unit, without faces where there is nothing to see. Colours are means
        over the views, weighted by 1/Z².

    Raises
    ------
    ModuleNotFoundError
        If scikit-image is not installed.
    TypeError, ValueError
        If an option or a view is not as above, or voxels of the size that was asked for would fill
        too much memory.

    References
    ----------
    Curless and Levoy, "A volumetric method for building complex models from range images", SIGGRAPH
    1996, doi 10.1145/237170.237269; Lewiner et al., "Efficient implementation of marching cubes'
    cases with topological guarantees", 2003, doi 10.1080/10867651.2003.10487582.
    """
    whole(1, agreeing=agreeing)
    for name, value in (("voxel", voxel), ("truncation", truncation)):
        if value is not None:
            check_positive(value, name)
    check_library()
    read = Views(views, max_relative_std=max_relative_std, max_depth=max_depth)
    if not len(read):
        empty = np.empty((0, 3))
        return Mesh(
            vertices=empty.astype(np.float32),
            faces=empty.astype(np.int32),
            colors=empty.astype(np.uint8),
            voxel=float(voxel or 0),
        )
    runtime.start()
    needed = min(agreeing, len(read))
    field, reach = _field(read, voxel, truncation, needed)
    vertices, faces = surface_of(field, needed)
    colors = _colors(read, vertices, reach)
    return Mesh(
        vertices=(vertices * read.unit).astype(np.float32),
        faces=faces,
        colors=colors,
        voxel=field.voxel * read.unit,
    )


def _field(
    views: Views, voxel: float | None, truncation: float | None, agreeing: int
) -> tuple[Field, float]:
    """Return the field and its truncation, in the views' unit; choose what was not given."""
    deviation = float(np.median([seen.deviation for seen in views.seen]))
    if voxel is None:
        pixel = float(np.median([seen.depth / seen.focal for seen in views.seen]))
        side = max(VOXEL * pixel, FINEST * deviation)
    else:
        side = voxel / views.unit
    while True:
        if truncation is None:
            reach = max(TRUNCATION * side, DEVIATIONS * deviation)
        else:
            reach = truncation / views.unit
        try:
            return field_of(views, side, reach, agreeing), reach
        except TooFineError as error:
            if voxel is not None:
                raise InputError(
                    f"voxel is {voxel:g}: the surface would need more than {MOST_BLOCKS} blocks of "
                    f"8×8×8 voxels, the most that is kept in memory; give at least "
                    f"{1.05 * error.larger * voxel:.2g}, or a smaller max_depth"
                ) from None
            side *= max(_COARSER, error.larger)


def _colors(views: Views, vertices: NDArray[np.float64], near: float) -> NDArray[np.uint8]:
    """Return the mean colour of each vertex, (V, 3)."""
    from tisfm.kernels.fusion.colors import add_colors

    points = vertices.astype(np.float32)
    sums = np.zeros((len(points), 4), np.float32)
    for view in views if len(points) else ():
        add_colors(
            points,
            view.inverse_depth,
            view.colors,
            sums,
            projection=view.to_pixels.astype(np.float32),
            near=near,
        )
    shown = sums[:, 3:] > 0
    mean = np.where(shown, sums[:, :3] / np.where(shown, sums[:, 3:], 1), UNSEEN)
    return np.rint(mean).astype(np.uint8)


def check_library() -> None:
    """Raise ModuleNotFoundError, which says what to install, if there is no scikit-image."""
    try:
        import skimage.measure  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            "a mesh needs scikit-image, which is not installed: pip install 'tisfm[mesh]'",
            name=error.name,
        ) from None
