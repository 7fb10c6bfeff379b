"""A coloured mesh, and the file that keeps it."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import refuse_masked
from tisfm.formats import atomic_write
from tisfm.formats.glb import glb_surface

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
                raise ValueError(
                    f"{name} is {array.shape} {array.dtype}: expected {shape} {np.dtype(kind).name}"
                )
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < count:
            raise ValueError(
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
            raise ValueError(f"path is {os.fspath(path)}: expected a name in .ply or .glb")
        if suffix == ".glb" and not len(self.faces):
            raise ValueError(f"path is {os.fspath(path)}: a GLB file cannot hold an empty mesh")
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
