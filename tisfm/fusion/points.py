"""Points that several depth maps agree on."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tisfm import runtime
from tisfm.fusion.agreement import (
    CACHED_VIEWS,
    MAX_COMPARED_STD,
    MAX_DEVIATIONS,
    AgreementRule,
    Coverage,
    DepthNoise,
    FittedViews,
    agreement_rule,
    compare_views,
    fit_rule,
    measure_noise,
)
from tisfm.fusion.depth_views import DepthView, PosedDepth, PosedViews, check_positive
from tisfm.point_cloud import MAX_MEDIAN_DEPTHS, PointCloud

# Set by hand: a view sees through a point if its surface lies behind by at least this share
MIN_SEEN_THROUGH = 0.03
# A point is removed if at least this number of views see through it, and more than this share of
# the views that show it.
MIN_VIEWS_SEEING_THROUGH = 2
MAX_SHARE_SEEING_THROUGH = 0.5


def fused_points(
    # Any object with a length and items. Views are read one by one, several times each; a few at a
    # time are in memory.
    views: Sequence[DepthView],
    *,
    # How much is kept. "strict": what three views agree on precisely. "normal": what two agree on.
    # "complete": also uncertain depth, and what a single view shows.
    coverage: Coverage = "normal",
    # number of views that must show a point, including the view it comes from; all views if there
    # are fewer; by default 3, 2 or 1, by the coverage
    agreeing: int | None = None,
    # Depth with a larger relative standard deviation gives no points. By default 0.01, 0.02 or 0.1,
    # by the coverage, or a multiple of the median deviation if this is larger.
    max_relative_std: float | None = None,
    # depth beyond this multiple of the median depth of its view is not used;
    # None for no bound
    max_depth: float | None = MAX_MEDIAN_DEPTHS,
    # Edge of cubes, in the unit of the poses: the points of a cube are replaced by their mean,
    # weighted by precision. By default all points are kept, about one for each pixel of the view
    # that shows the surface best.
    voxel: float | None = None,
) -> PointCloud:
    """Fuse depth maps into the points that several views agree on.

    Each pixel of a view is projected into up to eight other views of the same surface. First the
    differences of depth there are measured: if they are smaller than the stated standard deviations
    say, these are reduced. A view agrees if its inverse depth differs by at most three combined
    standard deviations, and by at most twice the median of all differences. It sees through the
    point if its surface is farther. A point is kept if enough views agree, also as a
    share of those with depth there, and fewer see through it. It lies on its ray at the mean of the
    inverse depths, weighted by precision. Pixels that show a point found before are skipped.

    At the end all views are compared with all points: a point is removed if two or more views see
    through it, and more than half as many as show it.

    The points have the axes and the unit of the world. Colours are means over the views that agree.
    The confidence is a / (a + s + 1), where a other views agree and s views see through the point.

    Raises TypeError, ValueError if an option or a view is not valid.
    """
    rule = agreement_rule(coverage, agreeing, max_relative_std)
    if voxel is not None:
        check_positive(voxel, "voxel")
    posed_views = PosedViews(
        views,
        max_relative_std=MAX_COMPARED_STD,
        max_depth=max_depth,
        cached_views=CACHED_VIEWS,
    )
    runtime.start()
    noise = measure_noise(posed_views)
    rule = fit_rule(rule, posed_views, noise)
    points, fitted_views = _PointList(), FittedViews(posed_views, noise)
    for n in range(len(fitted_views)):
        view, others = fitted_views[n], fitted_views.neighbours(n)
        is_candidate = ~points.shown_pixels(view, noise)
        points.add(*_agreed_points(view, others, is_candidate, rule, noise))
    points.carve(fitted_views)
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

    def shown_pixels(self, view: PosedDepth, noise: DepthNoise) -> NDArray[np.bool_]:
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
                # Stated deviations, because a pixel that differs from a point by more than three
                # fitted deviations mostly shows the same surface less exactly.
                tolerance=MAX_DEVIATIONS / noise.deviation_factor,
            )
        return is_shown > 0

    def carve(self, views: FittedViews) -> None:
        """Remove points that several views see through."""
        from tisfm.kernels.fusion.consistency import count_views

        counts = np.zeros((len(self.positions), 2), np.int32)
        for n in range(len(views)) if len(counts) else ():
            view = views[n]
            count_views(
                self.positions,
                self.relative_deviation,
                view.inverse_depth,
                view.deviation,
                counts,
                projection=view.to_pixels.astype(np.float32),
                tolerance=MAX_DEVIATIONS,
                min_difference=MIN_SEEN_THROUGH,
            )
        showing, seeing_through = counts.T
        is_removed = seeing_through >= MIN_VIEWS_SEEING_THROUGH
        is_removed &= seeing_through > MAX_SHARE_SEEING_THROUGH * showing
        self.positions = self.positions[~is_removed]
        self.relative_deviation = self.relative_deviation[~is_removed]
        self.colors = self.colors[~is_removed]
        self.confidence = self.confidence[~is_removed]

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
    view: PosedDepth,
    other_views: Sequence[PosedDepth],
    is_candidate: NDArray[np.bool_],
    rule: AgreementRule,
    noise: DepthNoise,
) -> tuple[NDArray[np.float32], ...]:
    """Return the points of a view that enough views agree on: the arguments of `_PointList.add`."""
    agreement = compare_views(view, other_views, is_candidate, rule, noise)
    is_kept = agreement.is_kept
    row, column = np.nonzero(is_kept)
    weight, weighted_difference, agreeing, seeing_through, _ = agreement.sums[is_kept].T.astype(
        float
    )
    precision = 1 / view.deviation[is_kept].astype(float) ** 2 + weight
    fused_inverse = view.inverse_depth[is_kept] + weighted_difference / precision
    to_world = view.to_world
    pixels = np.stack([column, row, np.ones(len(row))])
    positions = ((to_world[:, :3] @ pixels) / fused_inverse).T + to_world[:, 3]
    return (
        positions.astype(np.float32),
        (1 / (np.sqrt(precision) * fused_inverse)).astype(np.float32),
        (agreement.colors[is_kept] / (agreeing[:, None] + 1)).astype(np.float32),
        (agreeing / (agreeing + seeing_through + 1)).astype(np.float32),
    )
