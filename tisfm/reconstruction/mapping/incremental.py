"""Incremental mapping: a first pair of views, then each view that shows enough mapped points.

Views have pycolmap's ids, which begin with 1.
"""

from collections.abc import Collection, Mapping
from typing import Any, Protocol

import numpy as np

from tisfm.reconstruction.mapping.database import pycolmap
from tisfm.reconstruction.mapping.first_pairs import FirstPairs, Pairs, first_pair_tolerance
from tisfm.reconstruction.mapping.parallax import LowParallaxFilter
from tisfm.reconstruction.mapping.plane_motion import find_other_motion
from tisfm.reconstruction.mapping.rival import Rival, compare_motions
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.result.calibration import Calibrate


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
    pairs: Pairs,
    count: int,  # number of views
    scorer: Scorer,  # it compares models that begin with different pairs
    # the part of the camera that is adjusted together with poses and points, from its current value
    calibrate: Calibrate = "nothing",
    *,
    # Whether the focal length is known. Then a first pair needs parallax beyond a rotation, and may
    # show a single plane. With a guess, a first pair needs parallax beyond a homography.
    is_focal_known: bool = True,
    # It is filled: by the smallest view id of a model, the motion that lost though it came near.
    rivals: dict[int, Rival] | None = None,
) -> list[Any]:
    """Return pycolmap's reconstructions of the views in a database, the largest first."""
    cache, mapper, options = _open_mapper(database, calibrate)
    remaining = set(range(1, count + 1)) & set(cache.images)
    first_pairs = FirstPairs(pairs, is_focal_known)
    models = []
    while len(remaining) >= MAPPING.min_views:
        model = _build_model(mapper, scorer, options, first_pairs, remaining)
        if model is None:
            break
        if calibrate == "nothing":
            model, rival = _choose_motion(cache, mapper, scorer, options, model, remaining)
            if rivals is not None and rival is not None:
                rivals[min(model.reg_image_ids())] = rival
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
    known_poses = {
        view_id: pose for view_id, pose in known_poses.items() if view_id in cache.images
    }
    others = set(cache.images) if allowed_views is None else set(cache.images) & set(allowed_views)
    return _continue_from(
        cache, mapper, options, known_poses, others, are_poses_fixed=are_poses_fixed
    )


def _continue_from(
    cache: Any,
    mapper: Any,
    options: Any,
    known_poses: Mapping[int, np.ndarray],  # as for `grow_from_poses`
    allowed_views: Collection[int],
    *,
    are_poses_fixed: bool,
) -> Any:
    """Return a reconstruction with views of known poses, and other allowed views."""
    model = pycolmap().Reconstruction()
    model.load(cache)
    if len(known_poses) < 2:  # the other views with known poses share no points with any view
        return model
    for view_id, pose in known_poses.items():
        model.frame(view_id).rig_from_world = pycolmap().Rigid3d(pose)
        model.register_frame(view_id)
    mapper.begin_reconstruction(model)
    for view_id in known_poses:
        mapper.triangulate_image(options.triangulation, view_id)
    others = set(allowed_views) - set(known_poses)
    _add_views(mapper, model, options, others, is_rough=not are_poses_fixed)
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
    first_pairs = FirstPairs(pairs, is_focal_known=True)
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


def _build_model(
    mapper: Any, scorer: Scorer, options: Any, first_pairs: FirstPairs, remaining: set[int]
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


def _choose_motion(
    cache: Any, mapper: Any, scorer: Scorer, options: Any, model: Any, remaining: set[int]
) -> tuple[Any, Rival | None]:
    """Return a model, or the model with the other motion of a plane, if it explains more matches.

    A first pair of views of a plane allows two motions, and RANSAC may choose the wrong one. The
    motion that lost is returned as well if it explains nearly as much.
    """
    view_ids = sorted(model.reg_image_ids())
    poses = np.array([model.images[view_id].cam_from_world().matrix() for view_id in view_ids])
    points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
    other_poses = find_other_motion(poses, points)
    if other_poses is None:
        return model, None
    known_poses = dict(zip(view_ids, other_poses, strict=True))
    other = _continue_from(cache, mapper, options, known_poses, remaining, are_poses_fixed=False)
    scores = {id(each): scorer.score(each) for each in (model, other)}
    winner, loser = (model, other) if scores[id(model)] >= scores[id(other)] else (other, model)
    count = scorer.match_count(set(winner.reg_image_ids()))
    losses = [count - scores[id(each)] for each in (winner, loser)]
    return winner, _find_near_rival(winner, loser, losses[1] / max(losses[0], 1e-9))


def _find_near_rival(winner: Any, loser: Any, loss: float) -> Rival | None:
    """Return the motion of a model that lost; None if it clearly lost."""
    view_ids = sorted(set(winner.reg_image_ids()) & set(loser.reg_image_ids()))
    if loss > MAPPING.max_rival_loss or len(view_ids) < 2:
        return None
    poses, other_poses = (
        np.array([each.images[view_id].cam_from_world().matrix() for view_id in view_ids])
        for each in (winner, loser)
    )
    rival = compare_motions(poses, other_poses, loss)
    return rival if rival.direction > MAPPING.min_rival_direction else None


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
