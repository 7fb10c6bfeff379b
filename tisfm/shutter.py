"""A shutter that reads row after row, as those of phones do: what it moves, and how to undo it.

A camera that moves meanwhile sees every row from another place. The pose of a frame is that of its
middle row. Row y is read `readout` · (y − middle) / H intervals later, where an interval is the
time from a frame of the source to the next.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.resampling import Resampling
from tisfm.rigid import rigid_twist

BEHIND = 1e-6  # Z of points that a frame sees
LONGEST = 2.0  # times the usual time between frames: over a longer one, nobody knows how it moved
NODES = 33  # along the longer side, between which the way of pixels is interpolated
STEPS = 4  # of the search for the row that a pixel was read in


@dataclass(frozen=True, kw_only=True)
class Rolling:
    """How frames moved while they were read.

    Attributes
    ----------
    camera : Camera
        The pinhole that rates were found with.
    readout : float
        The share of the interval that passes from the first row to the last; negative where the
        last is read first, 0 where all are read at once.
    deviation : float
        Its standard deviation; 0 where it was given.
    rates : dict of int to (6,) float64
        By frame: the twist (T, ω) of what is before the camera, by interval.
    inverse_depth : dict of int to float
        By frame: the usual one of what it shows, 1/unit of the rates.
    """

    camera: Camera
    readout: float
    deviation: float = 0.0
    rates: Mapping[int, np.ndarray] = field(default_factory=dict)
    inverse_depth: Mapping[int, float] = field(default_factory=dict)


def instants_of(indices: Sequence[int], times: Sequence[float | None]) -> np.ndarray:
    """Return when frames were taken, (N,), in intervals between frames of the source.

    Parameters
    ----------
    indices : sequence of int
        Their numbers in the source, which grow.
    times : sequence of float or None
        s; where some are not known, or do not grow, frames are taken to be evenly spaced.
    """
    number = np.array(indices, np.float64)
    known = np.array([time for time in times if time is not None])
    if len(known) < len(times) or (np.diff(known) <= 0).any() or len(known) < 2:
        return number
    return np.asarray((known - known[0]) / np.median(np.diff(known) / np.diff(number)))


def rates_of(
    poses: Mapping[int, np.ndarray], instants: Mapping[int, float] | Sequence[float] | np.ndarray
) -> dict[int, np.ndarray]:
    """Return the twist of what is before the camera at every frame, (6,) float64, by interval.

    Parameters
    ----------
    poses : mapping of int to (4, 4) array
        Camera to world, by frame.
    instants : sequence of float, or mapping
        When each frame was taken, in intervals.
    """
    frames = sorted(poses)
    times = {frame: instants[after] - instants[frame] for frame, after in pairwise(frames)}
    longest = LONGEST * float(np.median(list(times.values()))) if times else 0.0
    ways = {
        frame: _twist(poses[frame], poses[after]) / times[frame]
        for frame, after in pairwise(frames)
    }
    rates = {}
    for number, frame in enumerate(frames):
        near = [k for k in frames[max(0, number - 1) : number + 1] if k in ways]
        short = [k for k in near if times[k] <= longest] or near
        if short:
            rates[frame] = np.mean([ways[k] for k in short], axis=0)
    return rates


def at_middle(
    points: np.ndarray,
    depth: np.ndarray,
    rate: np.ndarray,
    readout: float,
    camera: Camera,
    shape: tuple[int, int],
) -> np.ndarray:
    """Return where points of a frame would be if all rows were read with the middle one, (N, 2).

    Points that would be behind the camera stay where they are.

    Parameters
    ----------
    points : (N, 2) array
        px.
    depth : (N,) array
        Z of each, positive.
    rate : (6,) array
        Of the frame, as in `Rolling`.
    readout : float
    camera : Camera
        A pinhole.
    shape : (int, int)
        Height and width, px.
    """
    center = np.array(camera.center_for(*shape))
    ray = np.column_stack([(points - center) / camera.focal, np.ones(len(points))])
    late = _late(points[:, 1], readout, shape)
    moved = transported(ray * np.asarray(depth)[:, None], rate, -late)
    ahead = moved[:, 2] > BEHIND
    found = np.array(points, np.float64)
    found[ahead] = moved[ahead, :2] / moved[ahead, 2:] * camera.focal + center
    return found


def transported(points: np.ndarray, rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return points, (N, 3), moved by a twist (T, ω) that acts for so long, (N,), each."""
    velocity, spin = rate[:3], rate[3:]
    angle = max(float(np.linalg.norm(spin)), 1e-12)
    axis = spin / angle
    turned = (angle * time)[:, None]
    sine, rest = np.sin(turned), 2 * np.sin(turned / 2) ** 2
    about = np.cross(axis, points)
    across = np.cross(axis, velocity)
    return np.asarray(
        points
        + sine * about
        + rest * np.cross(axis, about)
        + time[:, None] * velocity
        + rest / angle * across
        + (turned - sine) / angle * np.cross(axis, across)
    )


class UnrolledPixels(Resampling):
    """The map from a frame to what it would be if all rows were read with the middle one.

    Parameters
    ----------
    camera : Camera
        A pinhole.
    readout : float
    rate : (6,) array
        Of the frame, as in `Rolling`.
    inverse_depth : float or (h, w) array
        Of all that the frame shows, or, as that would be with the middle row, at `nodes_of` it;
        1/unit of the rate. What is not before the camera is taken to be far.
    shape : (int, int)
        Height and width, px.
    """

    def __init__(
        self,
        camera: Camera,
        readout: float,
        rate: np.ndarray,
        inverse_depth: float | np.ndarray,
        shape: tuple[int, ...],
    ) -> None:
        height, width = shape
        center = np.array(camera.center_for(height, width))
        grid = nodes_of(shape)
        wanted = grid.reshape(-1, 2)
        depth = 1 / np.maximum(np.ravel(inverse_depth), 1e-12)
        ray = np.column_stack([(wanted - center) / camera.focal, np.ones(len(wanted))])
        there = wanted
        for _ in range(STEPS):
            late = _late(there[:, 1], readout, shape)
            moved = transported(ray * depth[:, None], rate, late)
            there = moved[:, :2] / np.maximum(moved[:, 2:], BEHIND) * camera.focal + center
        nodes = (there - wanted).reshape(grid.shape).astype(np.float32)
        rows, columns = grid.shape[:2]
        at_x = np.linspace(0, columns - 1, width, dtype=np.float32)
        at_y = np.linspace(0, rows - 1, height, dtype=np.float32)
        flow = cv2.remap(nodes, *np.meshgrid(at_x, at_y), cv2.INTER_LINEAR)
        super().__init__(np.ascontiguousarray(np.moveaxis(flow, -1, 0)))


class UnrolledFrame(UnrolledPixels):
    """`UnrolledPixels` of a frame of a sequence.

    All that the frame shows is taken to be of one depth: what is nearer or farther is moved by the
    turn of the camera, and by its way as if it were there.

    Parameters
    ----------
    rolling : Rolling
    frame : int
        One that has a rate.
    shape : (int, int)
        Height and width, px.
    """

    def __init__(self, rolling: Rolling, frame: int, shape: tuple[int, int]) -> None:
        rate, usual = rolling.rates[frame], rolling.inverse_depth[frame]
        super().__init__(rolling.camera, rolling.readout, rate, usual, shape)


def nodes_of(shape: tuple[int, ...]) -> np.ndarray:
    """Return the pixels, (h, w, 2) as (x, y), between which the way of others is interpolated."""
    height, width = shape
    spacing = max(shape) / (NODES - 1)
    columns, rows = (max(2, round(side / spacing) + 1) for side in (width, height))
    x, y = np.meshgrid(np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows))
    return np.stack([x, y], axis=-1)


def _late(y: np.ndarray, readout: float, shape: tuple[int, ...]) -> np.ndarray:
    """Return how much later than the middle row rows are read, intervals."""
    return readout * (y - (shape[0] - 1) / 2) / shape[0]


def _twist(pose: np.ndarray, after: np.ndarray) -> np.ndarray:
    motion = np.linalg.inv(after) @ pose
    return rigid_twist(motion[:3, :3], motion[:3, 3])
