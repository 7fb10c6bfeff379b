"""Incremental mapping: a first pair of views, then each view that shows enough mapped points.

Views have pycolmap's ids, which begin with 1.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from tisfm.reconstruction.mapping.database import pycolmap
from tisfm.reconstruction.mapping.parallax import (
    LowParallaxFilter,
    epipolar_angles,
    homography_residuals,
    rotation_residuals,
)
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.result.calibration import Calibrate

Pairs = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]


class Scorer(Protocol):
    """Scores how well models explain the matches of views: see `MatchScorer`."""

    def score(self, model: Any) -> float:
        """Return the sum of the scores of the matches between the views of a model."""

    def worst_view_share(self, model: Any) -> float:
        """Return the mean match score of the worst view, divided by the median over all views."""

    def match_count(self, views: Collection[int] | None = None) -> int:
        """Return the number of matches between views with these ids; by default of all views."""


def grow_models(
    database: Any,
    # by pair of view ids: unit directions to the matching points in both views, two (N, 3) arrays
    pairs: Pairs,
    count: int,  # number of views
    scorer: Scorer,  # it compares models that begin with different pairs
    # the part of the camera that is adjusted together with poses and points, from its current value
    calibrate: Calibrate = "nothing",
    *,
    # Whether the focal length is known. Then a first pair needs parallax beyond a rotation, and may
    # show a single plane. With a guess, a first pair needs parallax beyond a homography.
    is_focal_known: bool = True,
) -> list[Any]:
    """Return pycolmap's reconstructions of the views in a database, the largest first."""
    cache, mapper, options = _open_mapper(database, calibrate)
    remaining = set(range(1, count + 1)) & set(cache.images)
    first_pairs = _FirstPairs(pairs, is_focal_known)
    models = []
    while len(remaining) >= MAPPING.min_views:
        model = _build_model(mapper, scorer, options, first_pairs, remaining)
        if model is None:
            break
        remaining -= set(model.reg_image_ids())
        models.append(model)
    return sorted(models, key=lambda model: (-model.num_reg_images(), min(model.reg_image_ids())))


def grow_from_poses(
    database: Any,
    # by view id, for at least two views: (3, 4) array, world to camera
    known_poses: Mapping[int, np.ndarray],
    *,
    # Whether the known poses stay fixed. Otherwise they are adjusted with all other poses.
    are_poses_fixed: bool = True,
    # ids of the views that may be added; by default all views without a known pose
    allowed_views: Collection[int] | None = None,
) -> Any:
    """Return pycolmap's reconstruction, continued from views with known poses."""
    cache, mapper, options = _open_mapper(database)
    options.mapper.fix_existing_frames = are_poses_fixed
    model = pycolmap().Reconstruction()
    model.load(cache)
    known_poses = {
        view_id: pose for view_id, pose in known_poses.items() if view_id in cache.images
    }
    if len(known_poses) < 2:  # the other views with known poses share no points with any view
        return model
    for view_id, pose in known_poses.items():
        model.frame(view_id).rig_from_world = pycolmap().Rigid3d(pose)
        model.register_frame(view_id)
    mapper.begin_reconstruction(model)
    for view_id in known_poses:
        mapper.triangulate_image(options.triangulation, view_id)
    others = set(cache.images) if allowed_views is None else set(cache.images) & set(allowed_views)
    _add_views(mapper, model, options, others - set(known_poses), is_rough=not are_poses_fixed)
    mapper.end_reconstruction(False)
    return model


def shows_parallax(
    database: Any,  # its camera has the estimated focal length
    # as for `grow_models`, with directions for this focal length
    pairs: Pairs,
) -> bool:
    """Return whether enough of the best pairs show parallax beyond a rotation.

    If few pairs show parallax, matching errors determine the focal length and the path.
    """
    _, mapper, options = _open_mapper(database)
    first_pairs = _FirstPairs(pairs, is_focal_known=True)
    return first_pairs.parallax_share(mapper, options) >= MAPPING.min_parallax_pairs


def _open_mapper(database: Any, calibrate: Calibrate = "nothing") -> tuple[Any, Any, Any]:
    """Return the cache of a database, its mapper and the options of the mapper."""
    cache_options = pycolmap().DatabaseCacheOptions()
    cache_options.min_num_matches = MAPPING.min_observations
    cache = pycolmap().DatabaseCache.create(database, cache_options)
    options = _mapper_options(calibrate)
    camera = next(iter(cache.cameras.values()))
    options.mapper.init_max_error = first_pair_tolerance(max(camera.width, camera.height))
    return cache, pycolmap().IncrementalMapper(cache), options


def first_pair_tolerance(
    longer_side: float,  # longer side of the frames, px
) -> float:
    """Return the largest error, px, of a match of a first pair."""
    return MAPPING.first_pair_tolerance * max(1.0, longer_side / MAPPING.tolerance_frame)


class _FirstPairs:
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


def _build_model(
    mapper: Any, scorer: Scorer, options: Any, first_pairs: _FirstPairs, remaining: set[int]
) -> Any | None:
    """Return a reconstruction of some of the remaining views, or None.

    A first pair may not determine the motion, and views may get wrong poses. A model is accepted if
    it explains all views well, or if a model from another first pair gets the same score. Otherwise
    the model with the best score is returned.
    """
    best_model, best_score, used_views, is_accepted = None, 0.0, list[int](), False
    min_score = MAPPING.min_mean_score * scorer.match_count(remaining)
    for pair in first_pairs.candidates(mapper, options, remaining, used_views):
        used_views += pair[:2]
        model = pycolmap().Reconstruction()
        mapper.begin_reconstruction(model)
        mapper.register_initial_image_pair(options.mapper, *pair)
        mapper.triangulate_image(options.triangulation, pair[0])
        _add_views(mapper, model, options, remaining)
        mapper.end_reconstruction(False)
        if model.num_reg_images() >= MAPPING.min_views:
            total_score = scorer.score(model)
            is_consistent = (
                model.num_reg_images() > MAPPING.small_model_views
                and total_score > min_score
                and scorer.worst_view_share(model) > MAPPING.min_worst_view_share
            )
            is_accepted = (
                is_consistent
                or abs(total_score - best_score) < MAPPING.max_score_difference * best_score
            )
            if is_consistent or total_score > best_score:
                best_model, best_score = model, total_score
        if is_accepted or len(used_views) >= 2 * MAPPING.max_first_pair_models:
            break
    return best_model


def _add_views(
    mapper: Any, model: Any, options: Any, remaining: set[int], *, is_rough: bool = False
) -> None:
    """Add remaining views to a model; if the poses of the model are rough, adjust them first."""
    local_options = options.get_local_bundle_adjustment()
    low_parallax_filter = LowParallaxFilter(mapper, model)

    def adjust_all(
        rounds: int,
        limits: tuple[int, float],  # largest number of steps, and tolerance
        outlier_pixels: float = MAPPING.outlier_pixels,  # px
    ) -> tuple[int, int]:
        """Adjust all views; return the numbers of views and of points."""
        mapper.iterative_global_refinement(
            rounds,
            MAPPING.max_changed_share,
            options.mapper,
            robust_adjustment(options.get_global_bundle_adjustment(), *limits, outlier_pixels),
            options.triangulation,
            normalize_reconstruction=not options.mapper.fix_existing_frames,
        )
        return model.num_reg_images(), model.num_points3D()

    rough_rounds, first_rounds, later_rounds = MAPPING.growth_rounds
    if is_rough:
        adjust_all(rough_rounds, MAPPING.final_limits, MAPPING.rough_outlier_pixels)
    views, points = adjust_all(first_rounds, MAPPING.growth_limits)
    if points == 0:
        return
    while True:
        for view_id in mapper.find_next_images(options.mapper, False):
            if view_id in remaining and mapper.register_next_image(options.mapper, view_id):
                break
        else:
            break
        mapper.triangulate_image(options.triangulation, view_id)
        low_parallax_filter.delete_points(view_id)
        mapper.iterative_local_refinement(
            1,
            MAPPING.max_changed_share,
            options.mapper,
            local_options,
            options.triangulation,
            view_id,
        )
        low_parallax_filter.delete_points(view_id)
        counts = model.num_reg_images(), model.num_points3D()
        if (
            counts[0] >= MAPPING.growth_factor * views
            or counts[1] >= MAPPING.growth_factor * points
        ):
            views, points = adjust_all(later_rounds, MAPPING.growth_limits)
    adjust_all(later_rounds, MAPPING.growth_limits)
    adjust_all(later_rounds, MAPPING.final_limits)


def _mapper_options(calibrate: Calibrate) -> Any:
    """Return pycolmap's options of incremental mapping, with one thread and fixed seeds."""
    options = pycolmap().IncrementalPipelineOptions()
    options.ba_refine_focal_length = calibrate != "nothing"
    options.ba_refine_extra_params = calibrate == "radial"
    options.ba_local_function_tolerance = MAPPING.local_tolerance
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.mapper.abs_pose_min_num_inliers = MAPPING.min_observations
    options.mapper.abs_pose_min_inlier_ratio = MAPPING.min_inlier_share
    options.mapper.init_min_num_inliers = 2 * MAPPING.min_observations
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = (
        MAPPING.min_triangulation_angle
    )
    options.mapper.init_max_forward_motion = 1.0  # the triangulation angle decides instead
    for part_options in (options, options.mapper):
        part_options.num_threads = 1
    for part_options in (options, options.mapper, options.triangulation):
        part_options.random_seed = 0
    return options


def robust_adjustment(adjustment: Any, steps: int, tolerance: float, outlier_pixels: float) -> Any:
    """Set a robust loss and the limits of steps in pycolmap's options; return the options.

    `tolerance` is the relative change of the squared residuals that ends the steps.
    """
    adjustment.print_summary = False
    adjustment.ceres.loss_function_type = pycolmap().LossFunctionType.CAUCHY
    adjustment.ceres.loss_function_scale = outlier_pixels
    solver = adjustment.ceres.solver_options
    solver.num_threads = 1
    solver.max_num_iterations, solver.function_tolerance = steps, tolerance
    return adjustment
