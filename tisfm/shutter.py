"""Removal of the effect of a rolling shutter, which reads the rows of a frame one after another.

A moving camera sees every row from another position. The pose of a frame is that of its middle row.
Row y is read `readout` · (y − middle) / H intervals after the middle row; an interval is the time
from one frame of the source to the next.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.resampling import Resampling
from tisfm.rigid import rigid_twist

# All of these were set by hand.
MIN_DEPTH = 1e-6  # smallest Z of a visible point
MAX_GAP_RATIO = 2.0  # gap between frames divided by the median gap: longer gaps give no rate
NODES_ON_LONGER_SIDE = 33  # between these nodes, displacements are interpolated
ROW_ITERATIONS = 4  # iterations to find the row in which a pixel was read


@dataclass(frozen=True, kw_only=True)
class RollingShutterMotion:
    """The camera's motion while frames were read."""

    camera: Camera  # the pinhole camera with which the rates were estimated
    # readout time from the first row to the last, intervals; negative if the last row is read
    # first, 0 if all rows are read at once
    readout: float
    deviation: float = 0.0  # standard deviation of the readout; 0 if the readout was given
    # dict of int to (6,) float64: by frame, the twist (T, ω) of the scene relative to the camera,
    # per interval
    rates: Mapping[int, np.ndarray] = field(default_factory=dict)
    # by frame, the median inverse depth, 1/unit of the rates
    inverse_depth: Mapping[int, float] = field(default_factory=dict)


def frame_instants(
    indices: Sequence[int],  # numbers of the frames in the source, increasing
    # s; if a time is unknown or does not increase, frames are assumed to be evenly spaced
    times: Sequence[float | None],
) -> np.ndarray:
    """Return the times of frames, (N,), in intervals between frames of the source."""
    frame_numbers = np.array(indices, np.float64)
    known_times = np.array([time for time in times if time is not None])
    if len(known_times) < len(times) or (np.diff(known_times) <= 0).any() or len(known_times) < 2:
        return frame_numbers
    interval = np.median(np.diff(known_times) / np.diff(frame_numbers))
    return np.asarray((known_times - known_times[0]) / interval)


def motion_rates(
    poses: Mapping[int, np.ndarray],  # mapping of int to (4, 4) array: camera to world, by frame
    # time of each frame, in intervals
    instants: Mapping[int, float] | Sequence[float] | np.ndarray,
) -> dict[int, np.ndarray]:
    """Return the twist of the scene relative to the camera at every frame, (6,), per interval."""
    frames = sorted(poses)
    times = {
        frame: instants[next_frame] - instants[frame] for frame, next_frame in pairwise(frames)
    }
    max_gap = MAX_GAP_RATIO * float(np.median(list(times.values()))) if times else 0.0
    twists = {
        frame: _twist_between(poses[frame], poses[next_frame]) / times[frame]
        for frame, next_frame in pairwise(frames)
    }
    rates = {}
    for k, frame in enumerate(frames):
        neighbours = [start for start in frames[max(0, k - 1) : k + 1] if start in twists]
        near_neighbours = [start for start in neighbours if times[start] <= max_gap] or neighbours
        if near_neighbours:
            rates[frame] = np.mean([twists[start] for start in near_neighbours], axis=0)
    return rates


def points_at_middle_row(
    points: np.ndarray,  # (N, 2) array: px
    depth: np.ndarray,  # (N,) array: Z of each point, positive
    rate: np.ndarray,  # (6,) array: rate of the frame, as in `RollingShutterMotion`
    readout: float,
    camera: Camera,  # a pinhole
    shape: tuple[int, int],  # height and width, px
) -> np.ndarray:
    """Return points of a frame as if all rows were read with the middle row, (N, 2) px.

    Points that would be behind the camera stay unchanged.
    """
    center = np.array(camera.center_for(*shape))
    ray = np.column_stack([(points - center) / camera.focal, np.ones(len(points))])
    delay = _delay(points[:, 1], readout, shape)
    moved_points = move_by_twist(ray * np.asarray(depth)[:, None], rate, -delay)
    in_front = moved_points[:, 2] > MIN_DEPTH
    corrected_points = np.array(points, np.float64)
    corrected_points[in_front] = (
        moved_points[in_front, :2] / moved_points[in_front, 2:] * camera.focal + center
    )
    return corrected_points


def move_by_twist(points: np.ndarray, rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return points, (N, 3), moved by a twist (T, ω) for the given times, (N,)."""
    velocity, spin = rate[:3], rate[3:]
    angle = max(float(np.linalg.norm(spin)), 1e-12)
    axis = spin / angle
    rotation_angle = (angle * time)[:, None]
    sine, one_minus_cosine = np.sin(rotation_angle), 2 * np.sin(rotation_angle / 2) ** 2
    axis_cross_points = np.cross(axis, points)
    axis_cross_velocity = np.cross(axis, velocity)
    return np.asarray(
        points
        + sine * axis_cross_points
        + one_minus_cosine * np.cross(axis, axis_cross_points)
        + time[:, None] * velocity
        + one_minus_cosine / angle * axis_cross_velocity
        + (rotation_angle - sine) / angle * np.cross(axis, axis_cross_velocity)
    )


class GlobalShutterMap(Resampling):
    """The map from a frame to the same frame with all rows read with the middle row."""

    def __init__(
        self,
        camera: Camera,  # a pinhole
        readout: float,
        rate: np.ndarray,  # (6,) array: rate of the frame, as in `RollingShutterMotion`
        # float or (h, w) array: inverse depth of the whole frame, or at its `interpolation_nodes`
        # at the time of the middle row, 1/unit of the rate. Zero and negative values count as far.
        inverse_depth: float | np.ndarray,
        shape: tuple[int, ...],  # height and width, px
    ) -> None:
        height, width = shape
        center = np.array(camera.center_for(height, width))
        nodes_xy = interpolation_nodes(shape)
        targets = nodes_xy.reshape(-1, 2)
        depth = 1 / np.maximum(np.ravel(inverse_depth), 1e-12)
        ray = np.column_stack([(targets - center) / camera.focal, np.ones(len(targets))])
        sources = targets
        for _ in range(ROW_ITERATIONS):
            delay = _delay(sources[:, 1], readout, shape)
            moved_points = move_by_twist(ray * depth[:, None], rate, delay)
            sources = (
                moved_points[:, :2] / np.maximum(moved_points[:, 2:], MIN_DEPTH) * camera.focal
                + center
            )
        node_flow = (sources - targets).reshape(nodes_xy.shape).astype(np.float32)
        rows, columns = nodes_xy.shape[:2]
        node_columns = np.linspace(0, columns - 1, width, dtype=np.float32)
        node_rows = np.linspace(0, rows - 1, height, dtype=np.float32)
        flow = cv2.remap(node_flow, *np.meshgrid(node_columns, node_rows), cv2.INTER_LINEAR)
        super().__init__(np.ascontiguousarray(np.moveaxis(flow, -1, 0)))


class GlobalShutterFrameMap(GlobalShutterMap):
    """`GlobalShutterMap` of a frame of a sequence.

    The whole frame is assumed to have one depth. The correction for the camera's rotation is exact;
    the correction for its translation is exact for points at this depth.
    """

    def __init__(
        self,
        motion: RollingShutterMotion,
        frame: int,  # a frame with a rate
        shape: tuple[int, int],  # height and width, px
    ) -> None:
        rate, median_inverse_depth = motion.rates[frame], motion.inverse_depth[frame]
        super().__init__(motion.camera, motion.readout, rate, median_inverse_depth, shape)


def interpolation_nodes(shape: tuple[int, ...]) -> np.ndarray:
    """Return the nodes for interpolating displacements: pixels (x, y), (h, w, 2)."""
    height, width = shape
    spacing = max(shape) / (NODES_ON_LONGER_SIDE - 1)
    columns, rows = (max(2, round(side / spacing) + 1) for side in (width, height))
    x, y = np.meshgrid(np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows))
    return np.stack([x, y], axis=-1)


def _delay(y: np.ndarray, readout: float, shape: tuple[int, ...]) -> np.ndarray:
    """Return the time from the readout of the middle row to the readout of row y, intervals."""
    return readout * (y - (shape[0] - 1) / 2) / shape[0]


def _twist_between(pose: np.ndarray, next_pose: np.ndarray) -> np.ndarray:
    motion = np.linalg.inv(next_pose) @ pose
    return rigid_twist(motion[:3, :3], motion[:3, 3])
