"""Views for fusion: depth maps with standard deviations and camera poses."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera, check_pinhole
from tisfm.checks import Floats, check_unmasked, refuse_masked
from tisfm.errors import InputError, InputTypeError
from tisfm.rigid import is_rotation

MIN_RELATIVE_STD = 0.002
"""Lower bound of the relative standard deviation of depth: interpolation between pixels adds as
much error. Set by hand."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthView:
    """A frame, its depth, and the pose of its camera.

    Raises TypeError, ValueError if an array has another shape or type, or a value is masked; if the
    pose is not a rotation and a translation; if the camera has distortion.
    """

    # (H, W) float32: inverse depth, per unit of the pose. Unknown where it is not finite or not
    # positive.
    inverse_depth: NDArray[np.float32]
    # (H, W) float32: standard deviation of the inverse depth. Pixels where it is not finite are not
    # used.
    inverse_depth_std: NDArray[np.float32]
    pose: Floats  # (4, 4) float64: camera to world. A view with NaN in its pose is not used.
    frame: NDArray[np.uint8]  # (H, W) or (H, W, 3) uint8: grey, or red, green and blue
    camera: Camera  # without distortion

    def __post_init__(self) -> None:
        inverse_depth = check_unmasked(self.inverse_depth, "inverse_depth", np.float32)
        if inverse_depth.ndim != 2 or not inverse_depth.size:
            raise InputError(f"inverse_depth is {inverse_depth.shape}: expected (H, W)")
        std = check_unmasked(self.inverse_depth_std, "inverse_depth_std", np.float32)
        if std.shape != inverse_depth.shape:
            raise InputError(
                f"inverse_depth_std is {std.shape} but inverse_depth is {inverse_depth.shape}: "
                "they must have the same size"
            )
        refuse_masked(self.frame, "frame", "fill them first, for instance by frame.filled(0)")
        frame = np.asarray(self.frame)
        if frame.dtype != np.uint8:
            raise InputTypeError(f"frame is {frame.dtype}: expected uint8")
        if frame.shape not in (inverse_depth.shape, (*inverse_depth.shape, 3)):
            raise InputError(
                f"frame is {frame.shape}: expected {inverse_depth.shape}, the shape of "
                "inverse_depth, with three colours or none"
            )
        if not isinstance(self.camera, Camera):
            raise InputTypeError(f"camera is {self.camera!r}: expected a tisfm.Camera")
        check_pinhole(self.camera, "give the camera of the frame without it, camera.pinhole()")
        values = {
            "inverse_depth": inverse_depth,
            "inverse_depth_std": std,
            "pose": _check_pose(self.pose),
            "frame": frame,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedDepth:
    """A view in the form that kernels take, with lengths in the unit of `PosedViews`."""

    # inverse_depth, deviation: (H, W) float32, inverse depth and its standard deviation; 0 where
    # depth is unknown or not used
    inverse_depth: NDArray[np.float32]
    deviation: NDArray[np.float32]
    colors: NDArray[np.float32]  # (H, W, 3) float32
    pose: Floats  # (4, 4) float64: camera to world
    intrinsics: Floats  # (3, 3) float64: from camera axes to pixels

    def thinned(self, step: int) -> "PosedDepth":
        """Return the view of every `step`-th row and column."""
        to_thinned = np.diag([1 / step, 1 / step, 1])
        return PosedDepth(
            inverse_depth=np.ascontiguousarray(self.inverse_depth[::step, ::step]),
            deviation=np.ascontiguousarray(self.deviation[::step, ::step]),
            colors=np.ascontiguousarray(self.colors[::step, ::step]),
            pose=self.pose,
            intrinsics=to_thinned @ self.intrinsics,
        )

    @property
    def to_pixels(self) -> Floats:
        """(3, 4) matrix from a point of the world to (u z, v z, z)."""
        return self.intrinsics @ np.linalg.inv(self.pose)[:3]

    @property
    def to_world(self) -> Floats:
        """(3, 4) matrix M: pixel (x, y) at depth Z is the point M[:, :3] (x, y, 1) Z + M[:, 3]."""
        return np.column_stack(
            [self.pose[:3, :3] @ np.linalg.inv(self.intrinsics), self.pose[:3, 3]]
        )

    def projection_to(self, other: "PosedDepth") -> Floats:
        """(3, 4) matrix from (x, y, 1, inverse depth) to (g u, g v, g) in another view."""
        motion = np.linalg.inv(other.pose) @ self.pose
        rotated_rays = motion[:3, :3] @ np.linalg.inv(self.intrinsics)
        return other.intrinsics @ np.column_stack([rotated_rays, motion[:3, 3]])


@dataclass(frozen=True, kw_only=True)
class ViewSummary:
    """A summary of a view."""

    pose: Floats  # (4, 4) float64: camera to world
    # depth, deviation: medians of depth Z and of its standard deviation
    depth: float
    deviation: float
    max_z: float  # greatest Z that is used
    focal: float  # focal length, px
    field_angle: float  # angle from the optical axis to the farthest corner of the image, rad


class PosedViews:
    """Views that are read when they are needed; the views used last stay in memory.

    Views without a pose, or without usable depth, are left out: `len` and indices count only the
    other views. The unit of length is the median of the median depths of the views, so that numbers
    are near 1.

    Raises TypeError, ValueError if an option or a view is not valid.
    """

    def __init__(
        self,
        # any object with a length and items, which may read a view from a file at each access
        views: Sequence[DepthView],
        *,
        max_relative_std: float,  # depth with a larger relative standard deviation is not used
        # depth beyond this multiple of the median depth of its view is not used
        max_depth: float | None,
        cached_views: int = 1,  # number of views that stay in memory
        # by index of a view: (H, W) bool as `numpy.packbits` packs it, the pixels that are used; by
        # default all
        masks: dict[int, NDArray[np.uint8]] | None = None,
    ) -> None:
        if not (hasattr(views, "__len__") and hasattr(views, "__getitem__")):
            raise InputTypeError(
                f"views is a {type(views).__name__}: expected a sequence, which has a length and "
                "items, since every view is read more than once"
            )
        check_positive(max_relative_std, "max_relative_std")
        if max_depth is not None:
            check_positive(max_depth, "max_depth", "a positive number of median depths, or None")
        self._views = views
        self._max_relative_std, self._max_depth = max_relative_std, max_depth
        self._masks = masks
        self._prepare_cached = lru_cache(maxsize=cached_views)(self._prepare)
        summaries = [(index, self._summarise(index)) for index in range(len(views))]
        self._indices = [index for index, summary in summaries if summary]
        self._unscaled_summaries = [summary for _, summary in summaries if summary]
        # the unit of length, in the unit of the poses; 1 without views
        self.unit = float(
            np.median([summary.depth for summary in self._unscaled_summaries] or [1.0])
        )
        # summaries of the views, in that unit
        self.summaries = [
            ViewSummary(
                pose=_scale_pose(summary.pose, self.unit),
                depth=summary.depth / self.unit,
                deviation=summary.deviation / self.unit,
                max_z=summary.max_z / self.unit,
                focal=summary.focal,
                field_angle=summary.field_angle,
            )
            for summary in self._unscaled_summaries
        ]

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[PosedDepth]:
        return (self[n] for n in range(len(self)))

    def __getitem__(self, n: int) -> PosedDepth:
        return self._prepare_cached(n)

    def _prepare(self, n: int) -> PosedDepth:
        view = self._view(self._indices[n])
        is_usable = self._usable_pixels(self._indices[n], view, self._unscaled_summaries[n].max_z)
        height, width = is_usable.shape
        frame = view.frame if view.frame.ndim == 3 else view.frame[..., None]
        cx, cy = view.camera.center_for(height, width)
        inverse_depth = np.where(is_usable, view.inverse_depth, 0) * np.float64(self.unit)
        with np.errstate(invalid="ignore"):
            deviation = np.where(is_usable, view.inverse_depth_std, 0) * np.float64(self.unit)
        focal = view.camera.focal
        return PosedDepth(
            inverse_depth=inverse_depth.astype(np.float32),
            deviation=np.maximum(deviation, MIN_RELATIVE_STD * inverse_depth).astype(np.float32),
            colors=np.ascontiguousarray(
                np.broadcast_to(frame, (height, width, 3)), dtype=np.float32
            ),
            pose=_scale_pose(view.pose, self.unit),
            intrinsics=np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]),
        )

    def _view(self, index: int) -> DepthView:
        view = self._views[index]
        if not isinstance(view, DepthView):
            raise InputTypeError(f"views[{index}] is a {type(view).__name__}: expected a DepthView")
        return view

    def _summarise(self, index: int) -> ViewSummary | None:
        """Return a summary in the unit of the poses; None if the view is not used."""
        view = self._view(index)
        if not np.isfinite(view.pose).all():
            return None
        is_usable = self._usable_pixels(index, view, math.inf)
        if not is_usable.any():
            return None
        values = view.inverse_depth[is_usable].astype(float)
        median = float(np.median(values))
        relative = float(np.median(view.inverse_depth_std[is_usable] / values))
        min_inverse_depth = 0.0 if self._max_depth is None else median / self._max_depth
        height, width = is_usable.shape
        cx, cy = view.camera.center_for(height, width)
        half_sizes = [max(c + 0.5, n - 0.5 - c) for c, n in ((cx, width), (cy, height))]
        return ViewSummary(
            pose=view.pose,
            depth=1 / median,
            deviation=max(relative, MIN_RELATIVE_STD) / median,
            max_z=1 / max(float(values.min()), min_inverse_depth),
            focal=view.camera.focal,
            field_angle=math.atan2(math.hypot(*half_sizes), view.camera.focal),
        )

    def index(self, n: int) -> int:
        """Return the index that a view has among all views, the unused ones included."""
        return self._indices[n]

    def _usable_pixels(self, index: int, view: DepthView, max_z: float) -> NDArray[np.bool_]:
        inverse_depth, std = view.inverse_depth, view.inverse_depth_std
        is_usable = np.isfinite(inverse_depth) & (inverse_depth > 0) & np.isfinite(std) & (std >= 0)
        with np.errstate(invalid="ignore", over="ignore"):
            is_usable &= std <= self._max_relative_std * inverse_depth
            is_usable &= inverse_depth * np.float64(max_z) >= 1 - 1e-6
        if self._masks is not None:
            packed_mask = self._masks.get(index, np.zeros(-(-is_usable.size // 8), np.uint8))
            mask = np.unpackbits(packed_mask, count=is_usable.size).reshape(is_usable.shape)
            is_usable &= mask.astype(bool)
        return is_usable


def check_positive(value: object, name: str, expected: str = "a positive number") -> None:
    """Raise unless a value is a positive, finite number."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputTypeError(f"{name} is {value!r}: expected {expected}")
    if not 0 < float(value) < math.inf:
        raise InputError(f"{name} is {value:g}: expected {expected}")


def _scale_pose(pose: Floats, unit: float) -> Floats:
    scaled_pose = pose.copy()
    scaled_pose[:3, 3] /= unit
    return scaled_pose


def _check_pose(pose: Floats) -> Floats:
    matrix = np.array(check_unmasked(pose, "pose"), dtype=float)
    if matrix.shape != (4, 4):
        raise InputError(f"pose is {matrix.shape}: expected (4, 4), camera to world")
    if not np.isfinite(matrix).all():
        return matrix  # a frame without a pose
    if not is_rotation(matrix[:3, :3]) or np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise InputError(
            f"pose is {matrix.tolist()}: expected a rotation and a translation above (0, 0, 0, 1)"
        )
    return matrix
