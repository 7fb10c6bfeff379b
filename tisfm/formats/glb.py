"""Coloured points and surfaces as binary glTF (GLB).

What glTF keeps at a vertex is an amount of light, not the coded value of a picture, and a viewer
casts light on it unless the material is unlit.

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

_FLOAT = 5126  # in the specification
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

    mesh = Trimesh(vertices=vertices, faces=faces, vertex_colors=colors, process=False)
    return _exported(mesh.scene(), colors)


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

    opaque = np.column_stack([colors, np.full(len(colors), 255, np.uint8)])
    return _exported(Scene(PointCloud(positions, colors=opaque)), colors)


def colors_of(light: NDArray[np.floating] | NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the sRGB colours of light, (..., 3) uint8.

    Light is from 0 to 1, or in 8 bits, as trimesh and older files have it: then the dark tones are
    those of a few steps.
    """
    if light.dtype == np.uint8:
        return srgb_from_linear()[257 * light.astype(np.uint16)]
    return srgb_from_linear()[np.rint(65535 * np.clip(light, 0, 1)).astype(np.uint16)]


def unlit(tree: dict[str, Any]) -> None:
    """Let no light fall on the materials of a glTF tree; it is modified."""
    tree.setdefault("extensionsUsed", []).append(UNLIT)
    for material in tree["materials"]:
        material.setdefault("extensions", {})[UNLIT] = {}


def _exported(scene: "Scene", colors: NDArray[np.uint8]) -> bytes:
    """Return a scene of one thing, the light of its colours, (N, 3), in floats.

    trimesh writes 8 bits, of which the dark tones of a picture would share a few.
    """
    from trimesh.exchange.gltf import export_glb

    light = linear_from_srgb()[colors]

    def put_light(buffers: dict[Any, bytes], tree: dict[str, Any]) -> None:
        ((primitive,),) = (mesh["primitives"] for mesh in tree["meshes"])
        accessor = list(tree["accessors"].values())[primitive["attributes"]["COLOR_0"]]
        del accessor["normalized"]
        ends = {"min": light.min(axis=0).tolist(), "max": light.max(axis=0).tolist()}
        accessor.update(componentType=_FLOAT, type="VEC3", **ends)
        buffers[list(buffers)[accessor["bufferView"]]] = light.tobytes()

    data = export_glb(
        scene, include_normals=False, buffer_postprocessor=put_light, tree_postprocessor=_plain
    )
    return bytes(data)


def _plain(tree: dict[str, Any]) -> None:
    tree["materials"] = [{"doubleSided": True}]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
    unlit(tree)
