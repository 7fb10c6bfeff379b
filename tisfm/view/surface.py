"""The textured surface through the points of a frame."""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.formats.glb import make_unlit
from tisfm.view.frame_cloud import FrameCloud

_MAX_DEPTH_STEP = 0.05  # relative depth difference of neighbours on one surface; set by hand
_JPEG_QUALITY = 92  # of the texture


def triangles_between(
    points: FrameCloud,
    shape: tuple[int, int],  # height and width of the frame
) -> NDArray[np.int32]:
    """Return triangles between neighbouring points of one surface, (M, 3) indices."""
    height, width = (-(-side // points.step) for side in shape)
    index = np.full((height, width), -1, np.int32)
    index[tuple((points.pixels // points.step).T)] = np.arange(len(points), dtype=np.int32)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    corners = ((a, c, b), (b, c, d))
    triangles = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in corners])
    triangles = triangles[(triangles >= 0).all(axis=1)]
    depth = points.positions[:, 2][triangles]
    is_smooth = np.ptp(depth, axis=1) <= _MAX_DEPTH_STEP * points.step**0.5 * depth.min(axis=1)
    smooth: NDArray[np.int32] = triangles[is_smooth]
    return smooth


def surface_file(
    points: FrameCloud,
    triangles: NDArray[np.int32],  # (M, 3) int32
    colors: NDArray[np.uint8],  # (H, W, 3) uint8: of all pixels of the frame
) -> bytes:
    """Return a surface as a GLB file."""
    from trimesh import Trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    height, width = colors.shape[:2]
    picture = io.BytesIO()
    Image.fromarray(colors).save(picture, "JPEG", quality=_JPEG_QUALITY)
    across = (points.pixels[:, 1] + 0.5) / width
    up = 1 - (points.pixels[:, 0] + 0.5) / height
    material = PBRMaterial(baseColorTexture=Image.open(picture), doubleSided=True)
    mesh = Trimesh(
        vertices=points.positions,
        faces=triangles,
        visual=TextureVisuals(uv=np.stack([across, up], axis=-1), material=material),
        process=False,
    )
    return bytes(export_glb(mesh.scene(), include_normals=False, tree_postprocessor=make_unlit))
