"""Coloured points and surfaces as binary glTF (GLB).

glTF stores linear light at a vertex, not the sRGB value of an image. A viewer shades the colours by
its own lamps unless the material is unlit.

References
----------
Khronos Group, glTF 2.0 specification, §3.9.2, and the extension KHR_materials_unlit.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tisfm.formats.srgb import linear_from_srgb, srgb_from_linear

if TYPE_CHECKING:
    from trimesh import Scene

_FLOAT32_TYPE = 5126  # componentType of float32 in the glTF specification
UNLIT = "KHR_materials_unlit"
"""Extension of glTF for a material that viewers show in its own colours, without shading."""


def glb_surface(
    vertices: NDArray[np.floating],  # (N, 3) float
    faces: NDArray[np.integer],  # (M, 3) int
    colors: NDArray[np.uint8],  # (N, 3) uint8: sRGB
    *,
    note: str = "",  # a text for the extras of the file
) -> bytes:
    """Return a surface with a colour at each vertex, visible from both sides."""
    from trimesh import Trimesh  # slow to import

    mesh = Trimesh(vertices=vertices, faces=faces, vertex_colors=colors, process=False)
    return _export(mesh.scene(), colors, note)


def glb_points(
    positions: NDArray[np.floating],  # (N, 3) float: at least one
    colors: NDArray[np.uint8],  # (N, 3) uint8: sRGB
    *,
    note: str = "",  # a text for the extras of the file
) -> bytes:
    """Return coloured points."""
    from trimesh import PointCloud, Scene  # slow to import

    opaque_colors = np.column_stack([colors, np.full(len(colors), 255, np.uint8)])
    return _export(Scene(PointCloud(positions, colors=opaque_colors)), colors, note)


def srgb_from_light(light: NDArray[np.floating] | NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the sRGB colours of linear light, (..., 3) uint8.

    Floats are light from 0 to 1. uint8 is light from 0 to 255, as trimesh writes it; several dark
    sRGB values share one such level, so dark tones come back in coarse steps.
    """
    if light.dtype == np.uint8:
        return srgb_from_linear()[257 * light.astype(np.uint16)]
    return srgb_from_linear()[np.rint(65535 * np.clip(light, 0, 1)).astype(np.uint16)]


def make_unlit(tree: dict[str, Any]) -> None:
    """Mark all materials of a glTF tree as unlit; the tree is modified in place."""
    tree.setdefault("extensionsUsed", []).append(UNLIT)
    for material in tree["materials"]:
        material.setdefault("extensions", {})[UNLIT] = {}


def _export(scene: "Scene", colors: NDArray[np.uint8], note: str) -> bytes:
    """Return a scene of one object as GLB; the light of its colours, (N, 3), as float32.

    trimesh writes light in 8 bits, in which several dark sRGB values share one level.
    """
    from trimesh.exchange.gltf import export_glb

    light = linear_from_srgb()[colors]

    def replace_colours(buffers: dict[Any, bytes], tree: dict[str, Any]) -> None:
        ((primitive,),) = (mesh["primitives"] for mesh in tree["meshes"])
        accessor = list(tree["accessors"].values())[primitive["attributes"]["COLOR_0"]]
        del accessor["normalized"]
        bounds = {"min": light.min(axis=0).tolist(), "max": light.max(axis=0).tolist()}
        accessor.update(componentType=_FLOAT32_TYPE, type="VEC3", **bounds)
        buffers[list(buffers)[accessor["bufferView"]]] = light.tobytes()

    def finish_tree(tree: dict[str, Any]) -> None:
        _use_one_material(tree)
        if note:
            tree["asset"]["extras"] = {"note": note}

    data = export_glb(
        scene,
        include_normals=False,
        buffer_postprocessor=replace_colours,
        tree_postprocessor=finish_tree,
    )
    return bytes(data)


def _use_one_material(tree: dict[str, Any]) -> None:
    """Give all meshes of a glTF tree one unlit, double-sided material."""
    tree["materials"] = [{"doubleSided": True}]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
    make_unlit(tree)
