"""Coloured points and surfaces as binary glTF (GLB).

What glTF keeps at a vertex is an amount of light, not the coded value of a picture, and a viewer
casts light on it unless the material is unlit.

References
----------
Khronos Group, glTF 2.0 specification, §3.9.2, and the extension KHR_materials_unlit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tisfm.formats.srgb import linear_from_srgb, srgb_from_linear

UNLIT = "KHR_materials_unlit"  # colours are those of a picture or a legend: no light on them


def glb_surface(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], colors: NDArray[np.uint8]
) -> bytes:
    """Return a surface with a colour at each vertex, seen from both sides.

    Parameters
    ----------
    vertices : (N, 3) float
    faces : (M, 3) int
    colors : (N, 3) uint8
        sRGB.
    """
    from trimesh import Trimesh  # takes a while to load
    from trimesh.exchange.gltf import export_glb

    mesh = Trimesh(vertices=vertices, faces=faces, vertex_colors=light_of(colors), process=False)
    return bytes(export_glb(mesh.scene(), include_normals=False, tree_postprocessor=_plain))


def glb_points(positions: NDArray[np.floating], colors: NDArray[np.uint8]) -> bytes:
    """Return coloured points.

    Parameters
    ----------
    positions : (N, 3) float
        At least one.
    colors : (N, 3) uint8
        sRGB.
    """
    from trimesh import PointCloud, Scene  # takes a while to load
    from trimesh.exchange.gltf import export_glb

    opaque = np.column_stack([light_of(colors), np.full(len(colors), 255, np.uint8)])
    cloud = PointCloud(positions, colors=opaque)
    return bytes(export_glb(Scene(cloud), tree_postprocessor=_plain))


def light_of(colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the light of sRGB colours, 255 for white: (..., 3) uint8."""
    return np.rint(255 * linear_from_srgb()).astype(np.uint8)[colors]


def colors_of(light: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the sRGB colours of light, as well as its 8 bits tell them: (..., 3) uint8."""
    return srgb_from_linear()[257 * light.astype(np.uint16)]


def unlit(tree: dict[str, Any]) -> None:
    """Let no light fall on the materials of a glTF tree; it is modified."""
    tree.setdefault("extensionsUsed", []).append(UNLIT)
    for material in tree["materials"]:
        material.setdefault("extensions", {})[UNLIT] = {}


def _plain(tree: dict[str, Any]) -> None:
    tree["materials"] = [{"doubleSided": True}]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
    unlit(tree)
