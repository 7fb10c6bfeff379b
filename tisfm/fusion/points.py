"""Points that several depth maps agree on."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tisfm import runtime
from tisfm.checks import Floats, whole
from tisfm.fusion.depth_views import DepthView, PosedDepth, Seen, Views, check_positive
from tisfm.point_cloud import FARTHEST_MEDIANS, PointCloud

# Of the sum of angles, in fields of view and rad, and of the logarithm of the ratio of distances:
NEAR = 0.7  # much is seen by both
FARTHEST = 1.5  # hardly anything is


def neighbours(n: int, seen: Sequence[Seen], count: int) -> list[int]:
    """Return other views that see much of what a view sees, from the nearest to the farthest.

    They are judged by the point in the middle of what the view sees: how far from their axis they
    see it, in their field of view, how much their direction to it differs, and their distance. Of
    the views that are near in this, `count` are taken from the nearest to the farthest: neighbours
    in time alone may show the same mistakes. Where there are fewer, others follow.

    Parameters
    ----------
    n : int
        The view.
    seen : sequence of Seen
        All views.
    count : int
        How many are taken at most.
    """
    apart = _apart(seen[n], seen)
    apart[n] = math.inf
    order = np.argsort(apart, kind="stable")
    usable = min(count, np.count_nonzero(apart <= FARTHEST))
    near = order[: max(usable, np.count_nonzero(apart <= NEAR))]
    chosen = np.linspace(0, len(near) - 1, min(count, len(near))).round().astype(int)
    return [int(near[k]) for k in chosen]


def _apart(mine: Seen, seen: Sequence[Seen]) -> Floats:
    """Return how differently each view sees the point in the middle of a view, (N,)."""
    axis = mine.pose[:3, 2]
    poses = np.array([other.pose for other in seen])
    rays = mine.pose[:3, 3] + mine.depth * axis - poses[:, :3, 3]
    distance = np.linalg.norm(rays, axis=1)
    there = distance == 0
    distance[there] = 1
    rays /= distance[:, None]
    from_axis = np.arccos(np.clip((rays * poses[:, :3, 2]).sum(axis=1), -1, 1))
    parallax = np.arccos(np.clip(rays @ axis, -1, 1))
    fields = np.array([other.field for other in seen])
    apart = from_axis / fields + parallax + np.abs(np.log(distance / mine.depth))
    return np.where(there, math.inf, apart)


NEIGHBOURS = 8  # that a view is compared with
TOLERANCE = 3.0  # combined deviations within which two views agree


def fused_points(
    views: Sequence[DepthView],
    *,
    agreeing: int = 3,
    max_relative_std: float = 0.05,
    max_depth: float | None = FARTHEST_MEDIANS,
    voxel: float | None = None,
) -> PointCloud:
    """Fuse depth maps into the points that enough of them agree on.

    Each point of a view is looked for in up to eight others that see much of the same. One that
    shows an inverse depth within three combined deviations agrees; one that sees something farther
    there sees through the point. A point is kept where enough views agree and fewer see through
    it. It then lies on its ray at the mean of their inverse depths, weighted by precision. What a
    point that was found before shows is not taken again.

    Parameters
    ----------
    views : sequence of DepthView
        Anything with a length and items. Views are read one by one, some times each, and a few are
        held at a time.
    agreeing : int, default 3
        How many views must show a point, its own among them; all where there are fewer views.
    max_relative_std : float, default 0.05
        Depth of a larger deviation, relative to itself, is left out.
    max_depth : float, default 10
        Depth beyond so many median depths of its view is left out; None for no bound.
    voxel : float, optional
        Edge of cubes, in the unit of the poses, of whose points one is left: their mean, weighted
        by precision. By default all are kept, about one for each pixel that shows the surface best.

    Returns
    -------
    PointCloud
        In the world's axes and unit. Colours are means over the views that agree. The confidence is
        a / (a + s + 1), where a other views agree and s see through the point.

    Raises
    ------
    TypeError, ValueError
        If an option or a view is not as above.
    """
    whole(1, agreeing=agreeing)
    if voxel is not None:
        check_positive(voxel, "voxel")
    read = Views(
        views, max_relative_std=max_relative_std, max_depth=max_depth, held=2 * NEIGHBOURS + 1
    )
    runtime.start()
    needed = min(agreeing, len(read))
    found = _Found()
    for n, view in enumerate(read):
        others = [read[other] for other in neighbours(n, read.seen, NEIGHBOURS)]
        found.add(*_points_of(view, others, found.shown_by(view), needed))
    if voxel is not None:
        found.thin(voxel / read.unit)
    return PointCloud(
        positions=(found.positions * np.float64(read.unit)).astype(np.float32),
        colors=np.rint(found.colors).astype(np.uint8),
        confidence=found.confidence,
    )


class _Found:
    """The points found so far.

    Attributes
    ----------
    positions : (N, 3) float32
    relative_deviation : (N,) float32
        Of the inverse depth.
    colors : (N, 3) float32
    confidence : (N,) float32
    """

    def __init__(self) -> None:
        self.positions = np.empty((0, 3), np.float32)
        self.relative_deviation = np.empty(0, np.float32)
        self.colors = np.empty((0, 3), np.float32)
        self.confidence = np.empty(0, np.float32)

    def add(
        self,
        positions: NDArray[np.float32],
        relative_deviation: NDArray[np.float32],
        colors: NDArray[np.float32],
        confidence: NDArray[np.float32],
    ) -> None:
        self.positions = np.concatenate([self.positions, positions])
        self.relative_deviation = np.concatenate([self.relative_deviation, relative_deviation])
        self.colors = np.concatenate([self.colors, colors])
        self.confidence = np.concatenate([self.confidence, confidence])

    def shown_by(self, view: PosedDepth) -> NDArray[np.bool_]:
        """Return the pixels of a view that show a point found."""
        from tisfm.kernels.fusion.agreement import mark_shown

        shown = np.zeros(view.inverse_depth.shape, np.int32)
        if len(self.positions):
            mark_shown(
                self.positions,
                self.relative_deviation,
                view.inverse_depth,
                view.deviation,
                shown,
                projection=view.to_pixels.astype(np.float32),
                tolerance=TOLERANCE,
            )
        return shown > 0

    def thin(self, voxel: float) -> None:
        """Leave one point in each cube: the mean, weighted by precision."""
        cubes = np.floor(self.positions / voxel)
        _, first, cube = np.unique(cubes, axis=0, return_index=True, return_inverse=True)
        cube, count = cube.ravel(), len(first)
        weight = 1 / self.relative_deviation.astype(float) ** 2
        total = np.bincount(cube, weight, count)

        def mean(values: NDArray) -> NDArray[np.float32]:
            return (np.bincount(cube, weight * values, count) / total).astype(np.float32)

        self.positions = np.stack([mean(axis) for axis in self.positions.T], axis=1)
        self.colors = np.stack([mean(color) for color in self.colors.T], axis=1)
        self.confidence = mean(self.confidence)
        self.relative_deviation = (1 / np.sqrt(total)).astype(np.float32)


def _points_of(
    view: PosedDepth, others: Sequence[PosedDepth], shown: NDArray[np.bool_], needed: int
) -> tuple[NDArray[np.float32], ...]:
    """Return the points of a view that enough views agree on, as `_Found.add` takes them."""
    from tisfm.kernels.fusion.agreement import compare

    wanted = (view.inverse_depth > 0) & ~shown
    inverse_depth = np.where(wanted, view.inverse_depth, np.float32(0))
    sums = np.zeros((*inverse_depth.shape, 4), np.float32)
    colors = view.colors.copy()
    for other in others:
        compare(
            inverse_depth,
            view.deviation,
            other.inverse_depth,
            other.deviation,
            other.colors,
            sums,
            colors,
            projection=view.projection_to(other).astype(np.float32),
            tolerance=TOLERANCE,
        )
    agree, through = sums[..., 2], sums[..., 3]
    kept = wanted & (agree + 1 >= needed) & (through < agree + 1)
    row, column = np.nonzero(kept)
    weight, moved, agree, through = sums[kept].T.astype(float)
    precision = 1 / view.deviation[kept].astype(float) ** 2 + weight
    fused = inverse_depth[kept] + moved / precision
    rays = view.to_world
    ahead = np.stack([column, row, np.ones(len(row))])
    positions = ((rays[:, :3] @ ahead) / fused).T + rays[:, 3]
    return (
        positions.astype(np.float32),
        (1 / (np.sqrt(precision) * fused)).astype(np.float32),
        (colors[kept] / (agree[:, None] + 1)).astype(np.float32),
        (agree / (agree + through + 1)).astype(np.float32),
    )
