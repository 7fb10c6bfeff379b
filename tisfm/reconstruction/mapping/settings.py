"""Tuned numbers of mapping; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MappingSettings:
    """Camera poses and sparse points of views."""

    # database
    min_observations: int = 15  # that two views share, or a view and the known points
    min_shared_tracks: int = 20  # of two views that get matches from tracks
    view_steps: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16)  # views between such two views
    # incremental: poses of views
    min_inlier_share: float = 0.15  # of a new view's observations of known points
    max_pose_error: float = 6.0  # px: reprojection error of an inlier of a new view
    min_views: int = 3  # of a model
    outlier_pixels: float = 0.5  # px: larger residuals have a decreasing weight in an adjustment
    rough_outlier_pixels: float = 3.0  # px: the same, in the first adjustment from rough poses
    # of the number of views or points, after which all views are adjusted
    growth_factor: float = 1.5
    # refinements by such an adjustment: from rough poses, at first, and later
    growth_rounds: tuple[int, int, int] = (3, 2, 1)
    max_changed_share: float = 1e-3  # of the observations: with less in a round, the rounds end
    # steps, and relative change of squared residuals that ends them
    growing_limits: tuple[int, float] = (10, 1e-4)
    final_limits: tuple[int, float] = (50, 1e-5)  # the same, at the end
    local_tolerance: float = 1e-5  # the same change, in an adjustment of neighbouring views
    min_triangulation_angle: float = 0.5  # degrees between the rays of a point
    # incremental: first pairs
    # degrees: smallest triangulation angles, tried in this order; a car that drives forward gives
    # only small angles
    first_pair_angles: tuple[float, float, float] = (4.0, 1.0, 0.5)
    max_first_pairs: int = 24  # that are tried for each angle
    # px: error that RANSAC tolerates. The parallax may be as small as 2 px: with a larger tolerance
    # RANSAC accepts any motion. Films of 160 to 320 px get nearly the same path with 0.5 to 4 px.
    first_pair_tolerance: float = 1.0
    tolerance_frame: int = 1000  # px: longer side beyond which this tolerance grows in proportion
    min_parallax: float = 5e-4  # rad: a smaller parallax is matching noise
    max_parallax: float = 0.03  # rad: a larger parallax makes a first pair no better
    parallax_quantile: float = 0.75  # of two views, that ranks first pairs
    # of the residuals of a homography to those of the motion, if the focal length is a guess
    min_homography_ratio_guessed: float = 2.5
    # the same ratio, if the focal length is known. On a plane, noise alone makes the residuals of a
    # homography, which have two dimensions, 1.75 times the distances from epipolar lines.
    min_homography_ratio: float = 1.5
    min_rotation_ratio: float = 6.0  # the same, for a rotation with any focal length
    # share of pairs with parallax, of the best pairs with a motion, at an estimated focal length.
    # It was 0.12 to 0.33 in three sequences where the camera rotated and hardly moved, 0 in noise,
    # and 0.71 to 1 in 20 other sequences.
    min_parallax_pairs: float = 0.4
    # incremental: choice of a model
    min_mean_score: float = 0.65  # per match of a right model
    # score of the worst view of a right model, in scores of the median view. Worst views of right
    # models had 0.84 to 1 (blurred: 0.67), the worst view of a bent model 0.53.
    min_worst_view_share: float = 0.8
    max_score_difference: float = 0.02  # of models that confirm each other, relative
    small_model_views: int = 8  # models of at most this size are built twice, which costs little
    max_first_pair_models: int = 3  # from different first pairs
    min_pair_distance_share: float = 0.25  # of the remaining views, between first pairs,
    max_pair_distance: int = 4  # views: limit of this distance
    # model_scores
    grid_cells: int = 32  # along the longer side; each belongs to the nearest match
    epipolar_tolerance: float = 2.0  # px, if the longer side has 640: of an explained match
    # models
    min_coverage: float = 0.75  # share of the frames that models of the static scene explain
    pose_tolerance: float = 1e-4  # gradient that ends the refinement of the pose of a frame
    # parallax
    match_noise: float = 5e-4  # rad: it bounds the weight of small angles in the robust fits
    homography_rounds: int = 5  # reweighted rounds of the linear fit
    rotation_steps: int = 12  # Gauss–Newton steps of the fit of a rotation and a focal length
    min_rotation_step: float = 1e-5  # rad, and logarithm of the focal length: smaller ones end it
    # of this focal length to the stated one. When only the stated one was allowed, 20 % off, 7 of 8
    # rendered pure rotations passed for parallax.
    min_focal_ratio: float = 0.5
    max_focal_ratio: float = 2.0  # the same
    min_baseline: float = 0.02  # median depths of a view: to another view that sees a point
    # solution: standard deviations of the focal length, relative
    max_seen_deviation: float = 0.05  # with more, the motion hardly shows the focal length
    # with more, a guess is as good: 0.6 to 2 longer sides are common
    max_useful_deviation: float = 0.3


MAPPING = MappingSettings()
