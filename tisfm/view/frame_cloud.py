"""The points of a frame, filtered by thresholds and a box, and the surface through them."""

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tisfm.formats.glb import make_unlit
from tisfm.results.frame import ResultFrame
from tisfm.view.colors import Quantity, Ranges, pixel_colors

MAX_DEPTH = 10.0  # in median depths: farther depth is a guess, as in `tisfm.point_cloud`


@dataclass(frozen=True, kw_only=True)
class PointFilter:
    """Selects the points of a frame."""

    min_confidence: float = 0.0  # In [0, 1]. Without confidence all pixels pass.
    # Relative deviation of depth, as a share; infinite for no limit. With a limit, pixels of
    # unknown deviation are left out, if the result has deviations.
    max_deviation: float = float("inf")
    # ((3,), (3,)) or None: least and greatest coordinates, in the world of the scene
    box: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    max_points: int = 200_000  # limit of the points; beyond it, every n-th row and column is taken
    with_hidden: bool = True  # whether pixels pass that are not visible in the next frame


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameCloud:
    """Points of a frame, in the axes of its camera and the scale of the scene."""

    positions: NDArray[np.float32]  # (N, 3) float32: X right, Y down, Z forward
    colors: NDArray[np.uint8]  # (N, 3) uint8
    pixels: NDArray[np.int32]  # (N, 2) int32: row and column of each point
    step: int  # distance of the rows and columns that were taken, px
    size: float  # size of a point at which neighbours touch at the median depth

    def __len__(self) -> int:
        return len(self.positions)


def frame_cloud(
    frame: ResultFrame,
    quantity: Quantity,  # gives the colours of the points
    ranges: Ranges,
    points: PointFilter,
    # (4, 4): camera to world, for the box; by default the world is that of the camera
    pose: NDArray[np.float64] | None = None,
) -> FrameCloud:
    """Return the points of a frame."""
    is_kept = _passing_pixels(frame, points)
    step = _grid_step(int(is_kept.sum()), points.max_points)
    rows, columns = np.nonzero(is_kept[::step, ::step])
    rows, columns = step * rows, step * columns
    positions = _positions(frame, rows, columns)
    if points.box is not None and len(positions):
        world = positions if pose is None else positions @ pose[:3, :3].T + pose[:3, 3]
        low, high = points.box
        is_inside = ((world >= low) & (world <= high)).all(axis=1)
        rows, columns, positions = rows[is_inside], columns[is_inside], positions[is_inside]
    median = float(np.median(positions[:, 2])) if len(positions) else 1.0
    return FrameCloud(
        positions=positions,
        colors=pixel_colors(frame, quantity, ranges)[rows, columns],
        pixels=np.stack([rows, columns], axis=-1).astype(np.int32),
        step=step,
        size=step * median / frame.camera.focal,
    )


def _passing_pixels(frame: ResultFrame, points: PointFilter) -> NDArray[np.bool_]:
    """Return which pixels pass the thresholds, (H, W) bool."""
    is_kept = frame.has_depth
    if frame.hidden is not None and not points.with_hidden:
        is_kept &= ~frame.hidden
    if frame.confidence is not None and points.min_confidence > 0:
        is_kept &= frame.confidence >= points.min_confidence
    if frame.relative_deviation is not None and np.isfinite(points.max_deviation):
        is_kept &= frame.relative_deviation <= points.max_deviation  # false for NaN
    if is_kept.any():
        min_inverse_depth = float(np.median(frame.inverse_depth[is_kept])) / MAX_DEPTH
        is_kept &= frame.inverse_depth >= min_inverse_depth
    return is_kept


def _grid_step(count: int, max_count: int) -> int:
    """Return the distance of rows and columns that leaves at most `max_count` of `count` pixels."""
    return max(1, int(np.ceil(np.sqrt(count / max(max_count, 1)))))


def _positions(
    frame: ResultFrame, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Return the points of pixels, (N, 3), in the axes of the camera."""
    depth = np.float32(frame.scale) / frame.inverse_depth[rows, columns]
    return frame.rays(rows, columns) * depth[:, None]


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
    smooth_triangles: NDArray[np.int32] = triangles[is_smooth]
    return smooth_triangles


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
    texture = io.BytesIO()
    Image.fromarray(colors).save(texture, "JPEG", quality=_JPEG_QUALITY)
    u = (points.pixels[:, 1] + 0.5) / width
    v = 1 - (points.pixels[:, 0] + 0.5) / height
    material = PBRMaterial(baseColorTexture=Image.open(texture), doubleSided=True)
    mesh = Trimesh(
        vertices=points.positions,
        faces=triangles,
        visual=TextureVisuals(uv=np.stack([u, v], axis=-1), material=material),
        process=False,
    )
    return bytes(export_glb(mesh.scene(), include_normals=False, tree_postprocessor=make_unlit))
