"""Pairs one after another, each in the scale that the depth of those before gives it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tisfm.evaluation.record import LITTLE_PARALLAX
from tisfm.interpretation import Interpretation
from tisfm.rigid import pose_matrix

APART = 4  # px: the depth of every so many pixels is moved
FEWEST = 0.003  # of those pixels: with fewer that both depths have, the scale is lost

Interpret = Callable[[int, int], Interpretation]  # the frame whose depth it is, and the other
Keep = Callable[[int, Interpretation], None]  # the frame, and the pair whose depth is its own


@dataclass(kw_only=True)
class Chain:
    """What chained pairs give.

    Attributes
    ----------
    poses : list of (4, 4) array
        Camera to world.
    piece : list of int
        Which poses are in one scale.
    status : list of str
    units : list of float
        Of each frame, the length of its pair's unit, in that of its piece.
    """

    poses: list[NDArray[np.float64]] = field(default_factory=list)
    piece: list[int] = field(default_factory=list)
    status: list[str] = field(default_factory=list)
    units: list[float] = field(default_factory=list)


def chain(
    count: int, interpret: Interpret, keep: Keep, *, focal: float, center: tuple[float, float]
) -> Chain:
    """Chain the pairs of consecutive frames.

    The points of the frame before, moved by its pair, are in the scale of what came before; the
    median ratio of their depth to that of this frame's pair is the unit of the pair. A pair without
    depth turns the camera and does not move it, and points are carried over it. The depth of the
    last frame is that of the pair read backwards.

    Parameters
    ----------
    count : int
        Frames, at least 2.
    interpret : callable
        Returns the interpretation of two frames by their indices, with one motion of the camera.
    keep : callable
        Called with every frame that has a depth.
    focal : float
        px.
    center : (float, float)
        Principal point, px.

    Returns
    -------
    Chain
    """
    found = Chain()
    pose, piece = np.eye(4), 0
    points: NDArray[np.float64] | None = None  # (3, K), in the axes of this frame, scaled
    for index in range(count):
        last = index == count - 1
        result = interpret(index, index - 1) if last else interpret(index, index + 1)
        seen = result.status not in LITTLE_PARALLAX and result.motions is not None
        unit = _unit(points, result.inverse_depth, focal, center) if seen else 1.0
        if unit is None:  # the scale is lost: another piece begins
            pose, piece, unit = np.eye(4), piece + 1, 1.0
        found.poses.append(pose)
        found.piece.append(piece)
        found.status.append(str(result.status))
        found.units.append(unit)
        if seen:
            keep(index, result)
        if result.motions is None:
            continue
        motion = pose_matrix(result.motions[0])
        motion[:3, 3] *= unit if seen else 0.0
        if seen:
            points = _points(result.inverse_depth, focal, center) * unit
        if points is not None:
            points = motion[:3, :3] @ points + motion[:3, 3:]
        pose = pose @ np.linalg.inv(motion)
    return found


def _points(
    inverse_depth: NDArray, focal: float, center: tuple[float, float]
) -> NDArray[np.float64]:
    """Return the points of some pixels, (3, K), in the camera's axes and the pair's unit."""
    rows, columns = np.mgrid[: inverse_depth.shape[0] : APART, : inverse_depth.shape[1] : APART]
    inverse = inverse_depth[rows, columns].astype(np.float64)
    near = np.isfinite(inverse) & (inverse > 0)
    rays = np.stack(
        [
            (columns[near] - center[0]) / focal,
            (rows[near] - center[1]) / focal,
            np.ones(np.count_nonzero(near)),
        ]
    )
    return rays / inverse[near]


def _unit(
    points: NDArray | None, inverse_depth: NDArray, focal: float, center: Sequence[float]
) -> float | None:
    """Return the median of depth carried here over depth of this pair; None if they share little.

    It is 1 where nothing was carried: the first pair with depth says what the unit is.
    """
    if points is None:
        return 1.0
    ahead = points[:, points[2] > 0]
    x = np.rint(focal * ahead[0] / ahead[2] + center[0])
    y = np.rint(focal * ahead[1] / ahead[2] + center[1])
    height, width = inverse_depth.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    here = inverse_depth[y[inside].astype(np.intp), x[inside].astype(np.intp)]
    ratios = ahead[2, inside] * here
    ratios = ratios[np.isfinite(ratios) & (ratios > 0)]
    fewest = FEWEST * inverse_depth.size / APART**2
    return float(np.median(ratios)) if len(ratios) > fewest else None
