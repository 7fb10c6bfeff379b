"""Points that several depth maps agree on."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tisfm import runtime
from tisfm.checks import Floats, check_whole_numbers
from tisfm.fusion.depth_views import DepthView, PosedDepth, PosedViews, ViewSummary, check_positive
from tisfm.point_cloud import MAX_MEDIAN_DEPTHS, PointCloud

# Bounds of the difference of two views (`_differences`), set by hand:
SIMILAR_DIFFERENCE = 0.7  # views with a smaller difference see much of the same surface
MAX_DIFFERENCE = 1.5  # views with a larger difference see hardly any of it


def choose_neighbours(
    n: int,  # number of the view
    summaries: Sequence[ViewSummary],  # all views
    count: int,  # greatest number of views returned
) -> list[int]:
    """Return other views that see the same surface as a view, the most similar ones first.

    Of the similar views (difference up to `SIMILAR_DIFFERENCE`), `count` are chosen, evenly from
    the most to the least similar view, because neighbours in time may share the same errors. If
    fewer views are similar, the views up to `MAX_DIFFERENCE` follow.
    """
    difference = _differences(summaries[n], summaries)
    difference[n] = math.inf
    order = np.argsort(difference, kind="stable")
    min_count = min(count, np.count_nonzero(difference <= MAX_DIFFERENCE))
    views = order[: max(min_count, np.count_nonzero(difference <= SIMILAR_DIFFERENCE))]
    indices = np.linspace(0, len(views) - 1, min(count, len(views))).round().astype(int)
    return [int(views[k]) for k in indices]


def _differences(view: ViewSummary, summaries: Sequence[ViewSummary]) -> Floats:
    """Return the differences of all views from a view, (N,).

    The point on the optical axis of the view, at its median depth, is compared in all views. Each
    difference is a sum of three terms: the angle between the point and the optical axis of the
    other view, as a share of its field angle; the angle between the two rays to the point, rad; and
    the absolute logarithm of the ratio of the distances.
    """
    axis = view.pose[:3, 2]
    poses = np.array([other.pose for other in summaries])
    rays = view.pose[:3, 3] + view.depth * axis - poses[:, :3, 3]
    distance = np.linalg.norm(rays, axis=1)
    is_at_point = distance == 0
    distance[is_at_point] = 1
    rays /= distance[:, None]
    from_axis = np.arccos(np.clip((rays * poses[:, :3, 2]).sum(axis=1), -1, 1))
    parallax = np.arccos(np.clip(rays @ axis, -1, 1))
    fields = np.array([other.field_angle for other in summaries])
    difference = from_axis / fields + parallax + np.abs(np.log(distance / view.depth))
    return np.where(is_at_point, math.inf, difference)


NEIGHBOUR_COUNT = 8
"""Number of views that a view is compared with. Set by hand."""

MAX_DEVIATIONS = 3.0
"""Difference of inverse depth, in combined standard deviations, up to which two views agree."""


def fused_points(
    # Any object with a length and items. Views are read one by one, several times each; a few at a
    # time are in memory.
    views: Sequence[DepthView],
    *,
    # number of views that must show a point, including the view it comes from; all views if there
    # are fewer
    agreeing: int = 3,
    # depth with a larger relative standard deviation is not used
    max_relative_std: float = 0.05,
    # depth beyond this multiple of the median depth of its view is not used;
    # None for no bound
    max_depth: float | None = MAX_MEDIAN_DEPTHS,
    # Edge of cubes, in the unit of the poses: the points of a cube are replaced by their mean,
    # weighted by precision. By default all points are kept, about one for each pixel of the view
    # that shows the surface best.
    voxel: float | None = None,
) -> PointCloud:
    """Fuse depth maps into the points that several views agree on.

    Each pixel of a view is projected into up to eight other views of the same surface. A view
    agrees if its inverse depth there is within three combined standard deviations; it sees through
    the point if its surface there is farther. A point is kept if enough views agree, and fewer see
    through it. It lies on its ray at the mean of the inverse depths, weighted by precision. Pixels
    that show a point found before are skipped.

    The points have the axes and the unit of the world. Colours are means over the views that agree.
    The confidence is a / (a + s + 1), where a other views agree and s views see through the point.

    Raises TypeError, ValueError if an option or a view is not valid.
    """
    check_whole_numbers(1, agreeing=agreeing)
    if voxel is not None:
        check_positive(voxel, "voxel")
    posed_views = PosedViews(
        views,
        max_relative_std=max_relative_std,
        max_depth=max_depth,
        cached_views=2 * NEIGHBOUR_COUNT + 1,
    )
    runtime.start()
    min_views = min(agreeing, len(posed_views))
    points = _PointList()
    for n, view in enumerate(posed_views):
        other_views = [
            posed_views[other]
            for other in choose_neighbours(n, posed_views.summaries, NEIGHBOUR_COUNT)
        ]
        points.add(*_agreed_points(view, other_views, points.shown_pixels(view), min_views))
    if voxel is not None:
        points.thin(voxel / posed_views.unit)
    return PointCloud(
        positions=(points.positions * np.float64(posed_views.unit)).astype(np.float32),
        colors=np.rint(points.colors).astype(np.uint8),
        confidence=points.confidence,
    )


class _PointList:
    """The points found so far."""

    def __init__(self) -> None:
        self.positions = np.empty((0, 3), np.float32)  # (N, 3) float32
        # (N,) float32: relative standard deviation of the inverse depth
        self.relative_deviation = np.empty(0, np.float32)
        self.colors = np.empty((0, 3), np.float32)  # (N, 3) float32
        self.confidence = np.empty(0, np.float32)  # (N,) float32

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

    def shown_pixels(self, view: PosedDepth) -> NDArray[np.bool_]:
        """Return the pixels of a view, (H, W) bool, that show one of the points."""
        from tisfm.kernels.fusion.agreement import mark_pixels_of_points

        is_shown = np.zeros(view.inverse_depth.shape, np.int32)
        if len(self.positions):
            mark_pixels_of_points(
                self.positions,
                self.relative_deviation,
                view.inverse_depth,
                view.deviation,
                is_shown,
                projection=view.to_pixels.astype(np.float32),
                tolerance=MAX_DEVIATIONS,
            )
        return is_shown > 0

    def thin(self, voxel: float) -> None:
        """Replace the points in each cube by their mean, weighted by precision."""
        cubes = np.floor(self.positions / voxel)
        _, first_indices, cube = np.unique(cubes, axis=0, return_index=True, return_inverse=True)
        cube, count = cube.ravel(), len(first_indices)
        weight = 1 / self.relative_deviation.astype(float) ** 2
        weight_sum = np.bincount(cube, weight, count)

        def mean(values: NDArray) -> NDArray[np.float32]:
            return (np.bincount(cube, weight * values, count) / weight_sum).astype(np.float32)

        self.positions = np.stack([mean(axis) for axis in self.positions.T], axis=1)
        self.colors = np.stack([mean(color) for color in self.colors.T], axis=1)
        self.confidence = mean(self.confidence)
        self.relative_deviation = (1 / np.sqrt(weight_sum)).astype(np.float32)


def _agreed_points(
    view: PosedDepth, other_views: Sequence[PosedDepth], is_shown: NDArray[np.bool_], min_views: int
) -> tuple[NDArray[np.float32], ...]:
    """Return the points of a view that enough views agree on: the arguments of `_PointList.add`."""
    from tisfm.kernels.fusion.agreement import compare

    is_candidate = (view.inverse_depth > 0) & ~is_shown
    inverse_depth = np.where(is_candidate, view.inverse_depth, np.float32(0))
    sums = np.zeros((*inverse_depth.shape, 4), np.float32)
    colors = view.colors.copy()
    for other_view in other_views:
        compare(
            inverse_depth,
            view.deviation,
            other_view.inverse_depth,
            other_view.deviation,
            other_view.colors,
            sums,
            colors,
            projection=view.projection_to(other_view).astype(np.float32),
            tolerance=MAX_DEVIATIONS,
        )
    agreeing, seeing_through = sums[..., 2], sums[..., 3]
    is_kept = is_candidate & (agreeing + 1 >= min_views) & (seeing_through < agreeing + 1)
    row, column = np.nonzero(is_kept)
    weight, weighted_difference, agreeing, seeing_through = sums[is_kept].T.astype(float)
    precision = 1 / view.deviation[is_kept].astype(float) ** 2 + weight
    fused_inverse = inverse_depth[is_kept] + weighted_difference / precision
    to_world = view.to_world
    pixels = np.stack([column, row, np.ones(len(row))])
    positions = ((to_world[:, :3] @ pixels) / fused_inverse).T + to_world[:, 3]
    return (
        positions.astype(np.float32),
        (1 / (np.sqrt(precision) * fused_inverse)).astype(np.float32),
        (colors[is_kept] / (agreeing[:, None] + 1)).astype(np.float32),
        (agreeing / (agreeing + seeing_through + 1)).astype(np.float32),
    )
