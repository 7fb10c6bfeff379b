"""First pairs: the pairs of views from which a path may begin."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from tisfm.reconstruction.mapping.parallax import (
    epipolar_angles,
    homography_residuals,
    rotation_residuals,
)
from tisfm.reconstruction.mapping.settings import MAPPING

Pairs = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]
"""By pair of view ids: unit directions to the matching points in both views, two (N, 3) arrays."""


def first_pair_tolerance(
    longer_side: float,  # longer side of the frames, px
) -> float:
    """Return the largest error, px, of a match of a first pair."""
    return MAPPING.first_pair_tolerance * max(1.0, longer_side / MAPPING.tolerance_frame)


class FirstPairs:
    """Selects the pairs of views from which a path may begin."""

    def __init__(self, pairs: Pairs, is_focal_known: bool) -> None:  # as for `grow_models`
        self._pairs, self._is_focal_known = pairs, is_focal_known
        self._residual_angles = rotation_residuals if is_focal_known else homography_residuals
        self._ranked_pairs = self._rank()

    def candidates(
        self, mapper: Any, options: Any, remaining: set[int], used_views: Sequence[int]
    ) -> Iterator[tuple[int, int, Any]]:
        """Yield pairs of remaining views, with the motion from the first to the second.

        Pairs near `used_views` are left out. The caller may extend this list between two pairs.
        """
        pairs = [pair for pair in self._ranked_pairs if remaining.issuperset(pair)]
        min_distance = min(
            max(MAPPING.min_pair_distance_share * len(remaining), 1), MAPPING.max_pair_distance
        )
        for angle in MAPPING.first_pair_angles:
            options.mapper.init_min_tri_angle = angle
            for pair in pairs[: MAPPING.max_first_pairs]:
                if any(
                    abs(view - used_view) < min_distance
                    for view in pair
                    for used_view in used_views
                ):
                    continue
                motion = mapper.estimate_initial_two_view_geometry(options.mapper, *pair)
                if motion is not None and self._has_parallax(motion.matrix(), *pair):
                    yield *pair, motion

    def parallax_share(self, mapper: Any, options: Any) -> float:
        """Return the share, from 0 to 1, of the best pairs from which a path may begin.

        Pairs whose matches fit no motion are left out of the count.
        """
        options.mapper.init_min_tri_angle = MAPPING.first_pair_angles[-1]
        has_parallax = []
        for pair in self._ranked_pairs[: MAPPING.max_first_pairs]:
            motion = mapper.estimate_initial_two_view_geometry(options.mapper, *pair)
            if motion is not None:
                has_parallax.append(self._has_parallax(motion.matrix(), *pair))
        return float(np.mean(has_parallax)) if has_parallax else 0.0

    def _rank(self) -> list[tuple[int, int]]:
        """Return the pairs with enough matches and parallax, in decreasing order of both."""
        weights = {}
        for pair, (before, after) in self._pairs.items():
            if len(before) >= 2 * MAPPING.min_observations:
                angles = self._residual_angles(before, after)
                if np.median(angles) > MAPPING.min_parallax:
                    weights[pair] = len(before) * min(
                        float(np.quantile(angles, MAPPING.parallax_quantile)), MAPPING.max_parallax
                    )
        return sorted(weights, key=lambda pair: (-weights[pair], pair))

    def _has_parallax(self, motion: np.ndarray, first: int, second: int) -> bool:
        """Return whether a motion, (3, 4), explains directions much better than simpler motions.

        The required ratios exceed 1, because a motion with a free depth for each point fits noise
        better, too.
        """
        before, after = self._pairs[first, second]
        epipolar_angle = float(np.median(epipolar_angles(np.eye(4)[:3], motion, before, after)))
        homography_angle = float(np.median(homography_residuals(before, after)))
        if not self._is_focal_known:
            return homography_angle > MAPPING.min_homography_ratio_guessed * epipolar_angle
        rotation_angle = float(np.median(rotation_residuals(before, after)))
        return (
            rotation_angle > MAPPING.min_rotation_ratio * epipolar_angle
            and homography_angle > MAPPING.min_homography_ratio * epipolar_angle
        )
