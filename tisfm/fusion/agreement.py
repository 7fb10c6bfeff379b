"""Which pixels of a depth map other views agree with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import check_whole_numbers
from tisfm.errors import InputError
from tisfm.fusion.depth_views import MIN_RELATIVE_STD, PosedDepth, PosedViews, check_positive
from tisfm.fusion.neighbours import choose_neighbours

Coverage = Literal["strict", "normal", "complete"]
"""How much of the surface is kept: `COVERAGES`."""

# Set by hand:
NEIGHBOUR_COUNT = 8  # number of views that a view is compared with
CACHED_VIEWS = 2 * NEIGHBOUR_COUNT + 1  # number of views that stay in memory
# difference of inverse depth, in combined standard deviations, up to which two views agree
MAX_DEVIATIONS = 3.0
# relative standard deviation, as stated, up to which depth is compared at all
MAX_COMPARED_STD = 1.0
# Views agree up to this multiple of the median difference. Depth has many more large errors than a
# normal distribution, so that three standard deviations would let errors pass.
_MAX_MEDIANS = 2.0
_GAUSSIAN_MEDIAN = 0.6745  # median of |x| of a standard normal distribution
_NOISE_VIEWS = 12  # views whose differences are measured, evenly from all views
_NOISE_STEP = 4  # px between the measured pixels
_MIN_DIFFERENCES = 100  # with fewer measured pixels, deviations are used as stated
_MIN_DEVIATION_FACTOR = 0.1


@dataclass(frozen=True, kw_only=True)
class AgreementRule:
    """When a pixel of a view is kept.

    Raises TypeError, ValueError if a value is not valid.
    """

    # number of views that must show the point, its own view included; all views if there are fewer
    agreeing: int
    # smallest share of agreeing views, of the compared views that have any depth there
    min_share: float
    # largest relative standard deviation of depth, after deviations were fitted to the differences
    # of the views
    max_relative_std: float
    # this multiple of the median deviation is allowed in any case, so that noisy views give some
    # points
    min_usual_stds: float = 0.0

    def __post_init__(self) -> None:
        check_whole_numbers(1, agreeing=self.agreeing)
        check_positive(self.max_relative_std, "max_relative_std")


# Chosen on TartanAir with known poses; a larger deviation made points of HoloLens less exact.
COVERAGES: dict[Coverage, AgreementRule] = {
    "strict": AgreementRule(agreeing=3, min_share=0.5, max_relative_std=0.01, min_usual_stds=0.5),
    "normal": AgreementRule(agreeing=2, min_share=0.3, max_relative_std=0.02, min_usual_stds=1.5),
    "complete": AgreementRule(agreeing=1, min_share=0.2, max_relative_std=0.1, min_usual_stds=1.5),
}


def agreement_rule(
    coverage: Coverage,
    agreeing: int | None,  # None for that of the coverage
    max_relative_std: float | None,  # None for that of the coverage
) -> AgreementRule:
    """Return the rule of a coverage, with some of its values replaced.

    Raises TypeError, ValueError if a value is not valid.
    """
    if coverage not in COVERAGES:
        raise InputError(f"coverage is {coverage!r}: expected one of {', '.join(COVERAGES)}")
    rule = COVERAGES[coverage]
    if agreeing is not None:
        rule = replace(rule, agreeing=agreeing)
    if max_relative_std is not None:
        rule = replace(rule, max_relative_std=max_relative_std, min_usual_stds=0.0)
    return rule


@dataclass(frozen=True, kw_only=True)
class DepthNoise:
    """How far the depth maps of views differ from one another."""

    # Factor from stated deviations to deviations that fit the differences, at most 1. The
    # deviations of a plane that was found as a whole hold for each of its pixels alone.
    deviation_factor: float = 1.0
    # largest difference of two views that agree, as a share of the inverse depth
    max_difference: float = float("inf")

    def fit(self, view: PosedDepth) -> PosedDepth:
        """Return the view with deviations that fit the differences."""
        min_deviation = np.float32(MIN_RELATIVE_STD) * view.inverse_depth
        deviation = np.float32(self.deviation_factor) * view.deviation
        return replace(view, deviation=np.maximum(deviation, min_deviation))


def measure_noise(views: PosedViews) -> DepthNoise:
    """Measure the differences of some views from their neighbours."""
    from tisfm.kernels.fusion.consistency import measure_differences

    measured = []
    count = min(_NOISE_VIEWS, len(views))
    for n in np.linspace(0, len(views) - 1, count).round().astype(int):
        view = views[int(n)].thinned(_NOISE_STEP)
        for other in choose_neighbours(int(n), views.summaries, NEIGHBOUR_COUNT):
            differences = np.full((*view.inverse_depth.shape, 2), np.nan, np.float32)
            measure_differences(
                view.inverse_depth,
                view.deviation,
                views[other].inverse_depth,
                views[other].deviation,
                differences,
                projection=view.projection_to(views[other]).astype(np.float32),
            )
            measured.append(differences[np.isfinite(differences[..., 0])])
    all_differences = np.concatenate(measured) if measured else np.empty((0, 2), np.float32)
    if len(all_differences) < _MIN_DIFFERENCES:
        return DepthNoise()
    share, deviations = np.median(all_differences, axis=0).astype(float)
    factor = np.clip(deviations / _GAUSSIAN_MEDIAN, _MIN_DEVIATION_FACTOR, 1)
    return DepthNoise(
        deviation_factor=float(factor),
        max_difference=_MAX_MEDIANS * max(share, MIN_RELATIVE_STD),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Agreement:
    """Pixels of a view compared with other views."""

    # (H, W, 5) float32 and (H, W, 3) float32: as in `kernels.fusion.agreement.compare`
    sums: NDArray[np.float32]
    colors: NDArray[np.float32]
    is_kept: NDArray[np.bool_]  # (H, W): pixels that satisfy the rule


def compare_views(
    view: PosedDepth,
    other_views: Sequence[PosedDepth],
    is_candidate: NDArray[np.bool_],  # (H, W): pixels that are compared
    rule: AgreementRule,
    noise: DepthNoise,
) -> Agreement:
    """Compare pixels of a view with other views; all deviations fit the noise."""
    from tisfm.kernels.fusion.agreement import compare

    is_candidate = is_candidate & (view.inverse_depth > 0)
    is_candidate &= view.deviation <= rule.max_relative_std * view.inverse_depth
    inverse_depth = np.where(is_candidate, view.inverse_depth, np.float32(0))
    sums = np.zeros((*inverse_depth.shape, 5), np.float32)
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
            max_difference=noise.max_difference,
        )
    agreeing, seeing_through, showing = np.moveaxis(sums[..., 2:], -1, 0)
    is_kept = is_candidate & (agreeing + 1 >= rule.agreeing) & (seeing_through < agreeing + 1)
    is_kept &= agreeing >= rule.min_share * showing
    return Agreement(sums=sums, colors=colors, is_kept=is_kept)


class FittedViews:
    """Views with deviations that fit their noise; those used last stay in memory."""

    def __init__(self, views: PosedViews, noise: DepthNoise) -> None:
        self._views = views
        self._fit = lru_cache(maxsize=CACHED_VIEWS)(lambda n: noise.fit(views[n]))

    def __len__(self) -> int:
        return len(self._views)

    def __getitem__(self, n: int) -> PosedDepth:
        return self._fit(n)

    def neighbours(self, n: int) -> list[PosedDepth]:
        """Return the views that a view is compared with."""
        return [self[k] for k in choose_neighbours(n, self._views.summaries, NEIGHBOUR_COUNT)]


def fit_rule(rule: AgreementRule, views: PosedViews, noise: DepthNoise) -> AgreementRule:
    """Return the rule with at most as many agreeing views as there are, and a bound that fits."""
    relative_stds = [summary.deviation / summary.depth for summary in views.summaries]
    usual_std = noise.deviation_factor * float(np.median(relative_stds or [0.0]))
    return replace(
        rule,
        agreeing=min(rule.agreeing, max(1, len(views))),
        max_relative_std=max(rule.max_relative_std, rule.min_usual_stds * usual_std),
    )
