"""How two chunks lie to one another, by the frames that both have."""

from collections.abc import Iterator, Sequence

import numpy as np

from tisfm.reconstruction.result import Reconstruction
from tisfm.reconstruction.similarities import agreed, fitted, misfit, moved, refined, scale_of
from tisfm.reconstruction.similarity_graph import Edge

SURE = 0.05  # relative deviation: depth that is less sure does not count
SHOWN, PIXELS = 12, 400  # frames whose depth is compared, and pixels of each, about
FEWEST, AGREE = 60, 0.5  # points that agree, at least, and their share
KEPT = 60  # points of an edge
# Of places alone: how many there are, at least; how far from one another, in their mean distance,
# and how well they have to fit, of that.
PLACES, APART, FIT = 4, 1e-6, 0.1
EXACT = 0.002  # of their distance: no points are more exact

Shared = Sequence[tuple[int, int]]
"""Numbers of the same frame in two results."""


def edge_of(
    first: Reconstruction, second: Reconstruction, shared: Shared, nodes: tuple[int, int]
) -> Edge | None:
    """Return how a piece of one chunk lies to a piece of another; None if frames do not tell.

    Parameters
    ----------
    first, second : Reconstruction
    shared : sequence of (int, int)
        Frames that both have, with a pose in these pieces.
    nodes : (int, int)
        What the edge is to call the pieces.
    """
    poses = tuple(one.poses[[pair[k] for pair in shared]] for k, one in enumerate((first, second)))
    points = [_points(first, second, shared, at) for at in _with_depth(first, second, shared)]
    if points:
        here, there, away = (np.concatenate(part) for part in zip(*points, strict=True))
        found = agreed(here, there, away, fewest=FEWEST, share=AGREE)
        if found is not None:
            similarity, agree = found
            here, there, away = here[agree], there[agree], away[agree]
            similarity = refined(similarity, (here, there), away, (poses[0], poses[1]))
            return _edge(nodes, similarity, here, there, away)
    return _edge_of_places(poses[0], poses[1], nodes)


def _with_depth(
    first: Reconstruction, second: Reconstruction, shared: Shared
) -> Iterator[tuple[int, int]]:
    """Give some of the frames that the first has depth of, each with the nearest of the second's.

    Both are numbers of `shared`.
    """
    from tisfm.reconstruction.folder import depth_path

    ours, theirs = (
        [k for k, pair in enumerate(shared) if depth_path(one.folder, pair[side]).exists()]
        for side, one in enumerate((first, second))
    )
    if not ours or not theirs:
        return
    for k in np.unique(np.linspace(0, len(ours) - 1, min(len(ours), SHOWN)).astype(int)):
        yield ours[k], min(theirs, key=lambda one: (abs(one - ours[k]), one))


def _points(
    first: Reconstruction, second: Reconstruction, shared: Shared, at: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points of the first, the same as the second has them, (N, 3), and their distances.

    They are those of pixels of one frame, and where these are in the other, as the first has it.
    """
    height, width = first.shape
    fx, fy = first.camera.focals
    cx, cy = first.camera.center_for(height, width)
    lens = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    frame, (ours, theirs) = shared[at[0]][0], shared[at[1]]
    apart = max(1, int(np.sqrt(height * width / PIXELS)))
    rows, columns = np.mgrid[apart // 2 : height : apart, apart // 2 : width : apart]
    rows, columns = rows.ravel(), columns.ravel()
    depth = _sure_depth(first, frame)[rows, columns]
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=1)
    points = moved(first.poses[frame], depth[:, None] * (pixels @ np.linalg.inv(lens).T))
    seen = moved(np.linalg.inv(first.poses[ours]), points) @ lens.T
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = seen / np.where(seen[:, 2:] > 0, seen[:, 2:], np.nan)
    x, y = np.rint(np.nan_to_num(seen[:, :2], nan=-1.0).clip(-1, 1e6)).astype(int).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    other = np.full(len(points), np.nan)
    other[inside] = _sure_depth(second, theirs)[y[inside], x[inside]]
    others = moved(second.poses[theirs], other[:, None] * (seen @ np.linalg.inv(lens).T))
    known = np.isfinite(others[:, 0]) & np.isfinite(points[:, 0])
    away = np.linalg.norm(points - first.poses[frame, :3, 3], axis=1)
    return points[known], others[known], away[known]


def _sure_depth(result: Reconstruction, frame: int) -> np.ndarray:
    """Return the depth of a frame, (H, W) float64, NaN where it is not sure."""
    inverse = result.inverse_depth(frame).astype(np.float64)
    with np.errstate(invalid="ignore"):
        sure = (inverse > 0) & (result.inverse_depth_std(frame) < SURE * inverse)
    return 1 / np.where(sure, inverse, np.nan)


def _edge_of_places(poses: np.ndarray, others: np.ndarray, nodes: tuple[int, int]) -> Edge | None:
    """Return how pieces lie to one another by poses alone, (N, 4, 4), where the camera moves."""
    here, there = poses[:, :3, 3], others[:, :3, 3]
    if len(poses) < PLACES:
        return None
    apart = float(np.linalg.norm(here - here.mean(axis=0), axis=1).mean())
    apart_there = float(np.linalg.norm(there - there.mean(axis=0), axis=1).mean())
    if min(apart, apart_there) < APART:
        return None
    away = np.full(len(poses), apart)
    begun = fitted(here, there, np.ones(len(poses)))
    similarity = refined(begun, (here, there), away, (poses, others))
    off = misfit(similarity, here, there, away)
    if scale_of(similarity) <= 0 or np.median(off) > FIT:
        return None
    return _edge(nodes, similarity, here, there, away)


def _edge(
    nodes: tuple[int, int],
    similarity: np.ndarray,
    points: np.ndarray,
    others: np.ndarray,
    away: np.ndarray,
) -> Edge:
    some = np.linspace(0, len(points) - 1, min(len(points), KEPT)).astype(int)
    off = float(np.median(misfit(similarity, points, others, away)))
    return Edge(
        first=nodes[0],
        second=nodes[1],
        similarity=similarity,
        points=points[some],
        distances=away[some],
        deviation=max(off, EXACT),
        worth=float(len(points)),
        certain=True,
    )
