"""Views that are fused: a depth map with its deviation, seen from a known pose."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera, check_pinhole
from tisfm.checks import Floats, refuse_masked, unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.rigid import is_rotation

LEAST_RELATIVE_STD = 0.002  # nothing is known better: depth is looked up between pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthView:
    """A frame, its depth and where its camera stood.

    Attributes
    ----------
    inverse_depth : (H, W) float32
        In the inverse unit of the pose. There is no depth where it is not finite or not positive.
    inverse_depth_std : (H, W) float32
        Standard deviation of the inverse depth. Depth is left out where it is not finite.
    pose : (4, 4) float64
        Camera to world. A view with NaN in its pose is left out.
    frame : (H, W) or (H, W, 3) uint8
        Grey, or red, green and blue.
    camera : Camera
        Without distortion.

    Raises
    ------
    TypeError, ValueError
        If an array is not of this shape or kind, or a value is masked; if the pose is no rotation
        and translation; if the camera has distortion.
    """

    inverse_depth: NDArray[np.float32]
    inverse_depth_std: NDArray[np.float32]
    pose: Floats
    frame: NDArray[np.uint8]
    camera: Camera

    def __post_init__(self) -> None:
        inverse_depth = unmasked(self.inverse_depth, "inverse_depth", np.float32)
        if inverse_depth.ndim != 2 or not inverse_depth.size:
            raise InputError(f"inverse_depth is {inverse_depth.shape}: expected (H, W)")
        std = unmasked(self.inverse_depth_std, "inverse_depth_std", np.float32)
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
                f"frame is {frame.shape}: expected {inverse_depth.shape}, that of inverse_depth, "
                "with three colours or none"
            )
        if not isinstance(self.camera, Camera):
            raise InputTypeError(f"camera is {self.camera!r}: expected a tisfm.Camera")
        check_pinhole(self.camera, "give the camera of the frame without it, camera.pinhole()")
        values = {
            "inverse_depth": inverse_depth,
            "inverse_depth_std": std,
            "pose": _checked_pose(self.pose),
            "frame": frame,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedDepth:
    """A view as kernels take it, in a unit of length of its own.

    Attributes
    ----------
    inverse_depth, deviation : (H, W) float32
        0 where there is no depth, or it is left out.
    colors : (H, W, 3) float32
    pose : (4, 4) float64
        Camera to world.
    intrinsics : (3, 3) float64
        From the camera's axes to pixels.
    """

    inverse_depth: NDArray[np.float32]
    deviation: NDArray[np.float32]
    colors: NDArray[np.float32]
    pose: Floats
    intrinsics: Floats

    @property
    def to_pixels(self) -> Floats:
        """(3, 4): (u z, v z, z) of a point of the world."""
        return self.intrinsics @ np.linalg.inv(self.pose)[:3]

    @property
    def to_world(self) -> Floats:
        """(3, 4): the point at depth Z of pixel (x, y) is columns 0–2 times (x, y, 1) Z plus 3."""
        return np.column_stack(
            [self.pose[:3, :3] @ np.linalg.inv(self.intrinsics), self.pose[:3, 3]]
        )

    def projection_to(self, other: "PosedDepth") -> Floats:
        """(3, 4): (g u, g v, g) of a point in another view is it times (x, y, 1, d)."""
        between = np.linalg.inv(other.pose) @ self.pose
        turned = between[:3, :3] @ np.linalg.inv(self.intrinsics)
        return other.intrinsics @ np.column_stack([turned, between[:3, 3]])


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What is known of a view once it was read.

    Attributes
    ----------
    pose : (4, 4) float64
        Camera to world.
    depth, deviation : float
        Medians of Z and of its standard deviation.
    farthest : float
        Greatest Z that is used.
    focal : float
        px.
    field : float
        Angle from the axis to the corners of the image, rad.
    """

    pose: Floats
    depth: float
    deviation: float
    farthest: float
    focal: float
    field: float


class Views:
    """Views that are read when they are needed: some are held, those used last.

    What has no pose or no depth to use is left out; `len` and indices are those of the others. The
    unit of length is the median of the views' median depths, so that numbers are near 1.

    Parameters
    ----------
    views : sequence of DepthView
        Anything with a length and items, which may read a view from a file each time.
    max_relative_std : float
        Depth of a larger relative deviation is left out.
    max_depth : float or None
        As is depth beyond so many median depths of its view.
    held : int
        How many views are kept in memory.

    Attributes
    ----------
    unit : float
        In the unit of the poses; 1 without a view.
    seen : list of Seen
        In that unit.

    Raises
    ------
    TypeError, ValueError
        If an option or a view is not as above.
    """

    def __init__(
        self,
        views: Sequence[DepthView],
        *,
        max_relative_std: float,
        max_depth: float | None,
        held: int = 1,
    ) -> None:
        if not (hasattr(views, "__len__") and hasattr(views, "__getitem__")):
            raise InputTypeError(
                f"views is a {type(views).__name__}: expected a sequence, which has a length and "
                "items, since every view is read more than once"
            )
        check_positive(max_relative_std, "max_relative_std")
        if max_depth is not None:
            check_positive(max_depth, "max_depth", "a positive number of median depths, or None")
        self._views, self._held = views, held
        self._max_relative_std, self._max_depth = max_relative_std, max_depth
        self._cache: dict[int, PosedDepth] = {}
        found = [(index, self._look(index)) for index in range(len(views))]
        self._indices = [index for index, seen in found if seen]
        self._given = [seen for _, seen in found if seen]
        self.unit = float(np.median([seen.depth for seen in self._given] or [1.0]))
        self.seen = [
            Seen(
                pose=_scaled(seen.pose, self.unit),
                depth=seen.depth / self.unit,
                deviation=seen.deviation / self.unit,
                farthest=seen.farthest / self.unit,
                focal=seen.focal,
                field=seen.field,
            )
            for seen in self._given
        ]

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[PosedDepth]:
        return (self[n] for n in range(len(self)))

    def __getitem__(self, n: int) -> PosedDepth:
        if n in self._cache:
            self._cache[n] = self._cache.pop(n)  # the last of them
            return self._cache[n]
        view = self._view(self._indices[n])
        usable = self._usable(view, self._given[n].farthest)
        height, width = usable.shape
        frame = view.frame if view.frame.ndim == 3 else view.frame[..., None]
        cx, cy = view.camera.center_for(height, width)
        inverse_depth = np.where(usable, view.inverse_depth, 0) * np.float64(self.unit)
        with np.errstate(invalid="ignore"):
            deviation = np.where(usable, view.inverse_depth_std, 0) * np.float64(self.unit)
        focal = view.camera.focal
        prepared = PosedDepth(
            inverse_depth=inverse_depth.astype(np.float32),
            deviation=np.maximum(deviation, LEAST_RELATIVE_STD * inverse_depth).astype(np.float32),
            colors=np.ascontiguousarray(
                np.broadcast_to(frame, (height, width, 3)), dtype=np.float32
            ),
            pose=_scaled(view.pose, self.unit),
            intrinsics=np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]),
        )
        self._cache[n] = prepared
        if len(self._cache) > self._held:
            del self._cache[next(iter(self._cache))]
        return prepared

    def _view(self, index: int) -> DepthView:
        view = self._views[index]
        if not isinstance(view, DepthView):
            raise InputTypeError(f"views[{index}] is a {type(view).__name__}: expected a DepthView")
        return view

    def _look(self, index: int) -> Seen | None:
        view = self._view(index)
        if not np.isfinite(view.pose).all():
            return None
        usable = self._usable(view, math.inf)
        if not usable.any():
            return None
        values = view.inverse_depth[usable].astype(float)
        median = float(np.median(values))
        relative = float(np.median(view.inverse_depth_std[usable] / values))
        bound = 0.0 if self._max_depth is None else median / self._max_depth
        height, width = usable.shape
        cx, cy = view.camera.center_for(height, width)
        half = [max(c + 0.5, n - 0.5 - c) for c, n in ((cx, width), (cy, height))]
        return Seen(
            pose=view.pose,
            depth=1 / median,
            deviation=max(relative, LEAST_RELATIVE_STD) / median,
            farthest=1 / max(float(values.min()), bound),
            focal=view.camera.focal,
            field=math.atan2(math.hypot(*half), view.camera.focal),
        )

    def _usable(self, view: DepthView, farthest: float) -> NDArray[np.bool_]:
        inverse_depth, std = view.inverse_depth, view.inverse_depth_std
        usable = np.isfinite(inverse_depth) & (inverse_depth > 0) & np.isfinite(std) & (std >= 0)
        with np.errstate(invalid="ignore", over="ignore"):
            usable &= std <= self._max_relative_std * inverse_depth
            usable &= inverse_depth * np.float64(farthest) >= 1 - 1e-6
        return usable


def check_positive(value: object, name: str, expected: str = "a positive number") -> None:
    """Raise unless a value is a positive, finite number."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputTypeError(f"{name} is {value!r}: expected {expected}")
    if not 0 < float(value) < math.inf:
        raise InputError(f"{name} is {value:g}: expected {expected}")


def _scaled(pose: Floats, unit: float) -> Floats:
    scaled = pose.copy()
    scaled[:3, 3] /= unit
    return scaled


def _checked_pose(pose: Floats) -> Floats:
    matrix = np.array(unmasked(pose, "pose"), dtype=float)
    if matrix.shape != (4, 4):
        raise InputError(f"pose is {matrix.shape}: expected (4, 4), camera to world")
    if not np.isfinite(matrix).all():
        return matrix  # a frame whose pose was not found
    if not is_rotation(matrix[:3, :3]) or np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise InputError(
            f"pose is {matrix.tolist()}: expected a rotation and a translation above (0, 0, 0, 1)"
        )
    return matrix
