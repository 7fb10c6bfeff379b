"""A frame of a result: picture, depth, motion and labels, and the values of one pixel."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.errors import OutOfRangeError
from tisfm.status import Status

Floats = NDArray[np.float32]
# A ray with Z = 1 points behind the camera after a motion if its Z is smaller than this value. The
# value is larger than rounding errors.
_MIN_MOVED_Z = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class ResultFrame:
    """The data of one frame of a result."""

    number: int  # index in the result
    picture: NDArray[np.uint8] = field(repr=False)  # (H, W, 3) uint8: red, green, blue
    camera: Camera  # pinhole camera of all maps
    # (H, W) float32: in the inverse unit of the result; NaN if unknown
    inverse_depth: Floats = field(repr=False)
    status: Status
    # factor that takes depth to the unit of the scene: the mean inverse depth if the scale of each
    # frame is unknown, else 1
    scale: float = 1.0
    # (H, W) float32 or None: infinite if unknown
    inverse_depth_std: Floats | None = field(default=None, repr=False)
    confidence: Floats | None = field(default=None, repr=False)  # (H, W) float32 or None: in [0, 1]
    # (H, W) int or None: moving object of each pixel; 0 for the static scene
    labels: NDArray[np.integer] | None = field(default=None, repr=False)
    # (H, W) bool or None: pixels that are not visible in the next frame
    hidden: NDArray[np.bool_] | None = field(default=None, repr=False)
    # (6, H, W) float32 or None: (τ, ω)·f of the model in which every pixel has its own motion, with
    # τ the translation over depth, ω the rotation, and f the focal length
    rho: Floats | None = field(default=None, repr=False)
    # (H, W, 2) float32 or None: image motion to the next frame, px, if the result stores it
    stored_flow: Floats | None = field(default=None, repr=False)
    # dict of int to ((6,) twist, (4, 4) pose): by label, the motion relative to the camera until
    # the next frame, in the unit of depth; empty if unknown
    motions: dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(
        default_factory=dict, repr=False
    )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        height, width = self.inverse_depth.shape
        return height, width

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, including those that properties compute and keep."""
        arrays: list[NDArray[Any] | None] = [
            self.picture, self.inverse_depth, self.inverse_depth_std, self.confidence, self.labels,
            self.hidden, self.rho, self.stored_flow,
        ]  # fmt: skip
        computed_bytes = 8 * self.inverse_depth.size if self.stored_flow is None else 0
        computed_bytes += 4 * self.inverse_depth.size if self.inverse_depth_std is not None else 0
        return sum(array.nbytes for array in arrays if array is not None) + computed_bytes

    @property
    def has_depth(self) -> NDArray[np.bool_]:
        """Pixels with a positive finite depth, (H, W) bool."""
        return np.isfinite(self.inverse_depth) & (self.inverse_depth > 0)

    @property
    def median_depth(self) -> float:
        """The median depth in the scene; 1 without depth."""
        known_values = self.inverse_depth[self.has_depth]
        return self.scale / float(np.median(known_values)) if known_values.size else 1.0

    @cached_property
    def relative_deviation(self) -> Floats | None:
        """Standard deviation of inverse depth over inverse depth, (H, W); NaN if unknown."""
        if self.inverse_depth_std is None:
            return None
        has_deviation = self.has_depth & np.isfinite(self.inverse_depth_std)
        ratio = np.full(self.shape, np.nan, np.float32)
        np.divide(self.inverse_depth_std, self.inverse_depth, out=ratio, where=has_deviation)
        return ratio

    @cached_property
    def flow(self) -> Floats | None:
        """Image motion to the next frame, (H, W, 2) px, NaN if unknown; None without any motion."""
        if self.stored_flow is not None or not self.motions:
            return self.stored_flow
        flow = np.full((*self.shape, 2), np.nan, np.float32)
        for label, (_, pose) in self.motions.items():
            pixels = (
                self.has_depth if self.labels is None else self.has_depth & (self.labels == label)
            )
            flow[pixels] = self.flow_of_motion(pose, pixels)
        return flow

    def flow_of_motion(
        self,
        pose: NDArray[np.float64],  # (4, 4) float64: the motion, in the unit of depth
        pixels: NDArray[np.bool_],  # (H, W) bool: pixels with depth
    ) -> Floats:
        """Return the image motion of a motion of the scene relative to the camera.

        Returns (N, 2) float32, px; NaN for points behind the camera.
        """
        rows, columns = np.nonzero(pixels)
        return self._flow_and_slope(rows, columns, pose)[0]

    def rays(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Floats:
        """Return the rays of pixels, (N, 3), with Z = 1, in the axes of the camera."""
        cx, cy = self.camera.center_for(*self.shape)
        x = (columns - cx) / self.camera.focal
        y = (rows - cy) / self.camera.focal
        return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)

    def reading(self, row: int, column: int) -> "PixelReading":
        """Return the values of a pixel.

        Raises IndexError if the pixel lies outside the frame.
        """
        height, width = self.shape
        if not (0 <= row < height and 0 <= column < width):
            raise OutOfRangeError(
                f"the pixel is ({column}, {row}): expected a column below {width} and a row below "
                f"{height}"
            )
        inverse = float(self.inverse_depth[row, column])
        has_depth = bool(self.has_depth[row, column])
        deviation = self._value_at(self.inverse_depth_std, row, column)
        label = None if self.labels is None else int(self.labels[row, column])
        flow = None if self.flow is None else self.flow[row, column].astype(float)
        tau = omega = tau_std = flow_std = None
        motion = self.motions.get(label or 0)
        if self.rho is not None:
            tau, omega = np.split(self.rho[:, row, column] / self.camera.focal, 2)
        elif motion is not None:
            omega = motion[0][3:]
            tau = motion[0][:3] * inverse if has_depth else None
        if motion is not None and has_depth and deviation is not None and np.isfinite(deviation):
            tau_std = np.abs(motion[0][:3]) * deviation
            slope = self._flow_and_slope(np.array([row]), np.array([column]), motion[1])[1][0]
            flow_std = np.abs(slope) * deviation
        depth = 1 / inverse if has_depth else None
        return PixelReading(
            row=row,
            column=column,
            depth=depth,
            # to first order, from the deviation of inverse depth
            depth_std=None
            if depth is None or deviation is None or not np.isfinite(deviation)
            else deviation * depth**2,
            tau=tau,
            tau_std=tau_std,
            omega=omega,
            flow=None if flow is None or not np.isfinite(flow).all() else flow,
            flow_std=flow_std,
            confidence=self._value_at(self.confidence, row, column),
            label=label,
            hidden=self.hidden is not None and bool(self.hidden[row, column]),
        )

    def _value_at(self, values: Floats | None, row: int, column: int) -> float | None:
        return None if values is None else float(values[row, column])

    def _flow_and_slope(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], pose: NDArray[np.float64]
    ) -> tuple[Floats, Floats]:
        """Return the image motion of pixels, (N, 2) px, and its derivative by inverse depth.

        NaN for points that come to lie behind the camera.
        """
        rays = self.rays(rows, columns).astype(np.float64)
        inverse = self.inverse_depth[rows, columns].astype(np.float64)[:, None]
        moved_rays = rays @ pose[:3, :3].T + inverse * pose[:3, 3]
        depth = np.where(moved_rays[:, 2:] > _MIN_MOVED_Z, moved_rays[:, 2:], np.nan)
        focal = self.camera.focal
        flow = focal * (moved_rays[:, :2] / depth - rays[:, :2])
        slope = focal * (pose[:2, 3] * depth - moved_rays[:, :2] * pose[2, 3]) / depth**2
        return flow.astype(np.float32), slope.astype(np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelReading:
    """The values of a pixel; None for unknown values."""

    row: int
    column: int
    # depth, depth_std: Z and its standard deviation, in the unit of the result
    depth: float | None
    depth_std: float | None
    # tau, tau_std: (3,) or None: τ = T/Z, 1/frame
    tau: NDArray[np.floating] | None
    tau_std: NDArray[np.floating] | None
    omega: NDArray[np.floating] | None  # (3,) or None: ω, rad/frame
    # flow, flow_std: (2,) or None: image motion, and its standard deviation caused by the deviation
    # of depth, px
    flow: NDArray[np.floating] | None
    flow_std: NDArray[np.floating] | None
    confidence: float | None
    label: int | None
    hidden: bool  # whether the pixel is not visible in the next frame


def mean_inverse_depth(inverse_depth: Floats) -> float:
    """Return the mean inverse depth of a frame, in which unknown pixels count as infinitely far.

    It is the scale of a frame whose depth has a unit of its own.
    """
    finite_values = np.maximum(np.nan_to_num(inverse_depth, nan=0.0, posinf=0.0), 0)
    return float(finite_values.mean(dtype=np.float64))
