"""Tuned numbers of mapping; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MappingSettings:
    """Camera poses and sparse points of views."""

    # database
    # observations that two views share, or points of a model that a new view shows
    min_observations: int = 15
    min_shared_tracks: int = 20  # tracks that two views share: fewer shared tracks give no matches
    # distances, in views, between two views whose shared tracks give matches
    view_steps: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16)
    # incremental: poses of views
    # share of inliers among a new view's observations of points of the model
    min_inlier_share: float = 0.15
    max_pose_error: float = 6.0  # px: reprojection error of an inlier of a new view
    min_views: int = 3  # views of a model
    # px: larger residuals have a decreasing weight in an adjustment of all views
    outlier_pixels: float = 0.5
    rough_outlier_pixels: float = 3.0  # px: the same bound in the first adjustment from rough poses
    # growth of the number of views or points after which all views are adjusted
    growth_factor: float = 1.5
    # rounds of an adjustment of all views: of rough poses; of the first views; during the growth
    growth_rounds: tuple[int, int, int] = (3, 2, 1)
    # share of the observations that a round adds or deletes: after a smaller share the rounds end
    max_changed_share: float = 1e-3
    # while a model grows: largest number of steps of a round; relative change of the squared
    # residuals that ends the steps
    growth_limits: tuple[int, float] = (10, 1e-4)
    final_limits: tuple[int, float] = (50, 1e-5)  # the same limits, for the final rounds
    # relative change of the squared residuals that ends an adjustment of neighbouring views
    local_tolerance: float = 1e-5
    min_triangulation_angle: float = 0.5  # degrees between the rays of a triangulated point
    # first_pairs
    # degrees: smallest triangulation angles, tried in this order; a car that drives forward gives
    # only small angles
    first_pair_angles: tuple[float, float, float] = (4.0, 1.0, 0.5)
    max_first_pairs: int = 24  # first pairs that are tried for each angle
    # px: error that RANSAC tolerates. The parallax may be as small as 2 px: with a larger tolerance
    # RANSAC accepts any motion. Films of 160 to 320 px get nearly the same path with 0.5 to 4 px.
    first_pair_tolerance: float = 1.0
    # px: longer side of a frame beyond which this tolerance grows in proportion
    tolerance_frame: int = 1000
    min_parallax: float = 5e-4  # rad: a smaller median parallax is matching noise
    max_parallax: float = 0.03  # rad: a larger parallax makes a first pair no better
    # quantile of the parallax of the points of two views that ranks first pairs
    parallax_quantile: float = 0.75
    # residuals of a homography divided by residuals of the motion, if the focal length is a guess
    min_homography_ratio_guessed: float = 2.5
    # the same ratio, if the focal length is known. On a plane, noise alone makes the residuals of a
    # homography, which have two dimensions, 1.75 times the distances from epipolar lines.
    min_homography_ratio: float = 1.5
    # residuals of a rotation with any focal length, divided by residuals of the motion
    min_rotation_ratio: float = 6.0
    # share of pairs with parallax among the first pairs whose matches fit a motion, if the focal
    # length is an estimate. This share was 0.12 to 0.33 in three sequences where the camera rotated
    # and hardly moved, 0 in noise, and 0.71 to 1 in 20 other sequences.
    min_parallax_pairs: float = 0.4
    # incremental: choice of a model
    # mean score of a match, from 0 to 1 (`model_scores.MatchScorer`), in a right model
    min_mean_score: float = 0.65
    # mean score of a match in the worst view of a right model, divided by the median over all
    # views. It was 0.84 to 1 in right models, 0.67 in a right model of blurred frames, and 0.53 in
    # a bent model.
    min_worst_view_share: float = 0.8
    # relative difference of the scores of two models that confirm each other
    max_score_difference: float = 0.02
    small_model_views: int = 8  # views: smaller models are always built twice, which costs little
    max_first_pair_models: int = 3  # models that are built from different first pairs
    # distance, in views, between the first pairs of two models, divided by the number of views that
    # belong to no model
    min_pair_distance_share: float = 0.25
    max_pair_distance: int = 4  # views: the largest distance that is required
    # model_scores
    # grid points along the longer side; each belongs to the nearest matched point
    grid_cells: int = 32
    # px in a frame with a longer side of 640 px: distance of an explained match from its epipolar
    # line
    epipolar_tolerance: float = 2.0
    # models
    # share of the area of all frames that models of the static scene explain together
    min_coverage: float = 0.75
    pose_tolerance: float = 1e-4  # gradient that ends the refinement of the pose of a frame
    # parallax
    match_noise: float = 5e-4  # rad: it bounds the weight of small angles in the robust fits
    homography_rounds: int = 5  # reweighted rounds of the linear fit of a homography
    rotation_steps: int = 12  # Gauss–Newton steps of the fit of a rotation and a focal length
    # rad, and logarithm of the focal length: a smaller step ends this fit
    min_rotation_step: float = 1e-5
    # fitted focal length divided by the stated focal length. If only the rotation was fitted, and
    # the stated focal length had an error of 20 %, 7 of 8 rendered pure rotations seemed to show
    # parallax.
    min_focal_ratio: float = 0.5
    max_focal_ratio: float = 2.0  # largest value of the same ratio
    # distance between two views that show a point, divided by the median depth of one view
    min_baseline: float = 0.02
    # plane_motion
    plane_rounds: int = 10  # reweighted rounds of the fit of a plane
    # median |m · X − 1| of points: their distance from the plane m · X = 1, divided by the distance
    # of the camera from it. Rendered planes had 0.001 to 0.01, with the right motion and the wrong
    max_plane_residual: float = 0.02
    # second singular value of the vectors w = u + |u|² m / 2 of the views, divided by the first: a
    # larger ratio shows that their directions differ, and that there is no second motion
    max_sideways_share: float = 0.3
    # share of the points that the plane of the second motion has to be in front of
    min_share_before_plane: float = 0.9
    # incremental: largest `rival.Rival.loss` of the second motion of a plane that makes a path
    # doubtful. In 40 films of rendered planes, of 3 to 16 frames, the first motion was right, and
    # the loss of the second was 1.04 or more
    max_rival_loss: float = 1.03
    min_rival_direction: float = 5.0  # degrees between the two directions: motions nearer agree
    # solution: standard deviations of the focal length, relative
    # with a larger deviation, the motion hardly shows the focal length
    max_certain_deviation: float = 0.05
    # with a larger deviation, a guess is as good: focal lengths of 0.6 to 2 longer sides are common
    max_useful_deviation: float = 0.3


MAPPING = MappingSettings()
