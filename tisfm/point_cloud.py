"""Coloured 3D points of a depth map, and their PLY file."""

import os
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from tisfm.camera import Camera, check_pinhole
from tisfm.checks import check_unmasked, refuse_masked
from tisfm.errors import InputError, InputTypeError

# Largest depth of a point, median depths: where inverse depth is nearly 0, depth is a guess.
MAX_MEDIAN_DEPTHS = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PointCloud(NDArrayOperatorsMixin):
    """Points in front of the camera, with colours and confidence.

    A cloud can be used as the array of its positions: it has their shape, type, length, items and
    arithmetic, and NumPy's functions accept it.

    Raises ValueError if the arrays are not of these shapes and types, or a value is masked.
    """

    # (N, 3) float32: X right, Y down, Z forward, in the axes of the camera at frame 0 and the
    # relative scale of the depth
    positions: np.ndarray
    colors: np.ndarray  # (N, 3) uint8: red, green, blue; three equal values for a grey frame
    confidence: np.ndarray  # (N,) float32: in [0, 1]
    # a text for the file, such as a warning of the grade of the result
    note: str = ""

    def __post_init__(self) -> None:
        count = len(self.positions)
        for name, shape, kind in (
            ("positions", (count, 3), np.float32),
            ("colors", (count, 3), np.uint8),
            ("confidence", (count,), np.float32),
        ):
            array = getattr(self, name)
            refuse_masked(array, name, "leave out the points that they belong to")
            if array.shape != shape or array.dtype != kind:
                raise InputError(
                    f"{name} is {array.shape} {array.dtype}: expected {shape} {np.dtype(kind).name}"
                )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the positions, (N, 3)."""
        return self.positions.shape

    @property
    def dtype(self) -> np.dtype:
        """Type of the positions, float32."""
        return self.positions.dtype

    @property
    def ndim(self) -> int:
        """Number of dimensions of the positions, 2."""
        return self.positions.ndim

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, index: Any) -> Any:
        """Return positions, indexed like an array."""
        return self.positions[index]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy:
            return np.array(self.positions, dtype=dtype)
        if copy is False and dtype is not None and np.dtype(dtype) != self.dtype:
            raise InputError(
                f"the positions are {self.dtype}, and {np.dtype(dtype)} needs a copy: leave out "
                f"copy=False, or ask for {self.dtype}"
            )
        return np.asarray(self.positions, dtype=dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if "out" in options:  # from +=, after which the colours would belong to other points
            return NotImplemented
        arrays = [value.positions if isinstance(value, PointCloud) else value for value in inputs]
        return getattr(ufunc, method)(*arrays, **options)

    def __repr__(self) -> str:
        return f"PointCloud of {len(self)} points"

    def save(
        self,
        # The file. Its customary suffix is ``.ply``; no suffix is added.
        path: str | os.PathLike[str],
    ) -> None:
        """Write a binary PLY file; after an error there is no incomplete file.

        Every vertex has x, y, z and confidence (float), and red, green, blue (uchar). Viewers such
        as MeshLab, CloudCompare and Blender read it. Y points down: a viewer whose Y points up
        shows the scene upside down at first.

        Raises OSError if the folder does not exist or cannot be written to.
        """
        from trimesh import Trimesh  # slow to import
        from trimesh.exchange.ply import export_ply

        from tisfm.formats import atomic_write
        from tisfm.formats.ply_note import add_ply_note

        red, green, blue = self.colors.T
        attributes = {"red": red, "green": green, "blue": blue, "confidence": self.confidence}
        mesh = Trimesh(vertices=self.positions, vertex_attributes=attributes, process=False)
        with atomic_write(path) as file:
            file.write(
                add_ply_note(export_ply(mesh, encoding="binary", vertex_normal=False), self.note)
            )


def point_cloud(
    depth: np.ndarray,  # (H, W) float32: Z; only pixels with a finite positive depth give a point
    camera: Camera,  # without distortion
    *,
    frame: np.ndarray,  # (H, W) or (H, W, 3) uint8: the image that gives the colours
    confidence: np.ndarray,  # (H, W) float32
    occlusion: np.ndarray,  # (H, W) bool
    # min_confidence, max_depth, occluded: as for `tisfm.Interpretation.points`
    min_confidence: float = 0.0,
    max_depth: float | None = MAX_MEDIAN_DEPTHS,
    occluded: bool = False,
) -> PointCloud:  # in the order of the pixels, row by row
    """Return the 3D points of the pixels of a depth map.

    Raises TypeError, ValueError if `min_confidence` is not in [0, 1], or `max_depth` not positive;
    if a value is masked; if the camera has distortion.
    """
    check_pinhole(camera, "give the camera of the frame without it, camera.pinhole()")
    _check_number(min_confidence, "min_confidence", "a number in [0, 1]")
    if not 0 <= min_confidence <= 1:
        raise InputError(f"min_confidence is {min_confidence:g}: expected a number in [0, 1]")
    if max_depth is not None:
        _check_number(max_depth, "max_depth", "a number of median depths, or None")
        if not max_depth > 0:
            raise InputError(f"max_depth is {max_depth:g}: expected a positive number, or None")
    depth = check_unmasked(depth, "depth")
    frame, confidence, occlusion = (
        check_unmasked(array, name, advice=f"fill them first, for instance by {name}.filled(0)")
        for name, array in (("frame", frame), ("confidence", confidence), ("occlusion", occlusion))
    )
    is_kept = np.isfinite(depth) & (depth > 0) & (confidence >= min_confidence)
    if not occluded:
        is_kept &= ~occlusion
    if max_depth is not None and is_kept.any():
        # In float64: the product may be beyond float32.
        is_kept &= depth <= max_depth * np.median(depth[is_kept].astype(float))
    row, column = np.nonzero(is_kept)
    cx, cy = camera.center_for(*depth.shape)
    positions = np.empty((len(row), 3), np.float32)
    z = depth[row, column]
    with np.errstate(over="ignore"):
        positions[:, 0] = z * ((column - cx) / camera.focal)
        positions[:, 1] = z * ((row - cy) / camera.focal)
    positions[:, 2] = z
    colors = frame[row, column]
    if colors.ndim == 1:
        colors = np.repeat(colors[:, None], 3, axis=1)
    point_confidence = confidence[row, column]
    is_finite = np.isfinite(positions).all(axis=1)  # False where float32 overflowed
    return PointCloud(
        positions=positions[is_finite],
        colors=colors[is_finite],
        confidence=point_confidence[is_finite],
    )


def _check_number(value: object, name: str, expected: str) -> None:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputTypeError(f"{name} is {value!r}: expected {expected}")
