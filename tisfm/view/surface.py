"""The surface between the points of a frame, with its picture on it."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.view.cloud import Cloud

_TORN = 0.05  # neighbours whose depth differs by a larger share are of different surfaces
_UNLIT = "KHR_materials_unlit"  # colours are those of a picture or a legend: no light on them


def triangles_between(points: Cloud, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Return triangles between neighbouring points, (M, 3) indices, torn where depth jumps.

    Parameters
    ----------
    points : Cloud
    shape : (int, int)
        Height and width of the frame.
    """
    height, width = (-(-side // points.step) for side in shape)
    index = np.full((height, width), -1, np.int32)
    index[tuple((points.pixels // points.step).T)] = np.arange(len(points), dtype=np.int32)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    corners = ((a, c, b), (b, c, d))
    triangles = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in corners])
    triangles = triangles[(triangles >= 0).all(axis=1)]
    depth = points.positions[:, 2][triangles]
    whole = np.ptp(depth, axis=1) <= _TORN * points.step**0.5 * depth.min(axis=1)
    kept: NDArray[np.int32] = triangles[whole]
    return kept


def surface_file(points: Cloud, triangles: NDArray[np.int32], colors: NDArray[np.uint8]) -> bytes:
    """Return a surface as a GLB file.

    Parameters
    ----------
    points : Cloud
    triangles : (M, 3) int32
    colors : (H, W, 3) uint8
        Of all pixels of the frame.
    """
    from trimesh import Trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    height, width = colors.shape[:2]
    picture = io.BytesIO()
    Image.fromarray(colors).save(picture, "JPEG", quality=92)
    across = (points.pixels[:, 1] + 0.5) / width
    up = 1 - (points.pixels[:, 0] + 0.5) / height
    material = PBRMaterial(baseColorTexture=Image.open(picture), doubleSided=True)
    mesh = Trimesh(
        vertices=points.positions,
        faces=triangles,
        visual=TextureVisuals(uv=np.stack([across, up], axis=-1), material=material),
        process=False,
    )
    return bytes(export_glb(mesh.scene(), include_normals=False, tree_postprocessor=_unlit))


def colored_file(
    positions: NDArray[np.float32], triangles: NDArray[np.int32], colors: NDArray[np.uint8]
) -> bytes:
    """Return a surface with a colour at each vertex as a GLB file.

    Parameters
    ----------
    positions : (N, 3) float32
    triangles : (M, 3) int32
    colors : (N, 3) uint8
    """
    from trimesh import Trimesh
    from trimesh.exchange.gltf import export_glb

    light = _linear(colors)  # which is what such files keep at vertices
    mesh = Trimesh(vertices=positions, faces=triangles, vertex_colors=light, process=False)
    return bytes(export_glb(mesh.scene(), include_normals=False, tree_postprocessor=_plain))


def _linear(colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return sRGB colours as shares of light, (N, 3) uint8."""
    share = np.arange(256) / 255
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.rint(255 * light).astype(np.uint8)[colors]


def _plain(tree: dict[str, Any]) -> None:
    """Let colours of vertices be seen from both sides, without light."""
    tree["materials"] = [{"doubleSided": True}]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
    _unlit(tree)


def _unlit(tree: dict[str, Any]) -> None:
    tree.setdefault("extensionsUsed", []).append(_UNLIT)
    for material in tree["materials"]:
        material.setdefault("extensions", {})[_UNLIT] = {}
