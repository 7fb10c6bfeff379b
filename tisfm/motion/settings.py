"""Tuned numbers of motion models; without another source, a number was set by hand.

Each stage has one frozen class and one instance. `python -m bench.sensitivity` varies the fields.
A length in longer sides is a share of the image's longer side. D is inverse depth in px/frame.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EgomotionSettings:
    """First motion of the camera, from a flow field."""

    # egomotion
    samples: int = 5000  # approximate number of pixels in the fit to a flow; neighbours are similar
    # px: distances of inliers from epipolar lines that USAC tries
    inlier_distances: tuple[float, ...] = (0.05, 0.2, 0.8)
    max_draws: int = 2000  # random samples of five correspondences
    start_samples: int = 1000  # samples that select the best start
    start_iterations: int = 6  # iterations of the fit from each start
    iterations: int = 30  # iterations of the fit from the best start
    # confident samples: five give an essential matrix, and the others verify it
    min_confident_samples: int = 8
    # epipolar_fit
    min_confidence: float = 0.1  # confidence of rays from which essential matrices are sampled
    min_step: float = 1e-6  # rad, and share of ‖t‖: a shorter step ends the iterations
    min_scale: float = 0.01  # px: smallest scale of the robust fit, the accuracy of the best flow
    # rad/frame: standard deviation of an object's rotation relative to the background
    rotation_deviation: float = 0.001
    correlated_pixels: int = 50  # pixels with a common error of the flow, a patch of about 7 × 7
    # first_motion
    min_warps: int = 2  # linearisations on the level of the flow field
    # Parallax divided by the residual of the fit. Noise gives 2 if the camera only rotates. On
    # hand-held sequences, depth with a ratio below `good_parallax` was little better than a
    # constant: errors of lens and shutter exceed a parallax below a pixel, and the residual does
    # not contain them. From `fair_parallax` on, depth was better than a constant in most pairs.
    min_parallax: float = 2.5
    fair_parallax: float = 4.0
    good_parallax: float = 6.0
    good_subpixel_parallax: float = 9.0  # `good_parallax` if the parallax is less than 1 px
    min_residual: float = 0.005  # px of the level: smallest residual, the accuracy of a flow
    # px of the level: residual of a fit above which points are matched. At most 0.045 on rendered
    # scenes and in a textured studio; from 0.065 on in rooms with bare walls and between distant
    # frames, where the direction of the translation had errors of degrees.
    max_flow_residual: float = 0.06
    max_still_flow: float = 0.1  # px: median flow of a camera at rest
    max_still_flow_in_noise: float = 0.3  # px: `max_still_flow` in noisy frames
    # rolling_shutter
    shutter_rounds: int = 2  # estimates of the motion, each from the previous corrected frames
    shutter_iterations: int = 4  # iterations that find the pixel of frame 0 for a pixel of frame 1


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """Dense depth of rigid motions."""

    # camera
    # longer sides: difference of parallax between near and far points from which depth is carried
    # across textureless parts. With less parallax, coarse to fine follows weak texture better.
    min_carried_range: float = 0.019
    # textureless share of a frame above which the images show mostly noise, so a finer flow field
    # refines the motion
    max_textureless_in_refinement: float = 0.15
    min_first_pixels: int = 2**14  # pixels of the flow field that gives the first motion
    # plane_sweep
    # weight of the mean of neighbours in triangulation, divided by the weight of the pixel itself
    neighbour_weight: float = 0.05
    neighbour_window: int = 7  # px: side of this window
    sweep_median_window: int = 5  # px: side of the window of the median of swept depth
    # px: difference of parallax between near and far points from which a plane sweep is needed:
    # coarse to fine loses objects that are smaller than their displacement
    min_sweep_range: float = 20.0
    max_range_pixels: int = 2**15  # pixels of the level on which the range of depths is searched
    max_range_parallax: float = 0.2  # longer sides: largest parallax of that search
    range_percentiles: tuple[int, int] = (1, 99)  # percentiles of depth that bound the range
    range_margin: float = 0.3  # share by which the hypotheses extend beyond that range
    # largest difference of brightness in costs, divided by the mean |ΔI| between neighbours in
    # frame 0; for derivatives of brightness a quarter of it
    max_brightness_difference: float = 2.4
    guess_distance: float = 4.0  # px/frame: depth that differs more from the guess costs more
    guess_cost: float = 0.05  # cost of such a depth, if the guess has no trust
    # addition to this cost, if the guess has full trust; it decides where texture is missing
    guess_cost_of_trust: float = 0.3
    step_cost: float = 0.3  # cost of a change between neighbours by one hypothesis
    jump_cost: float = 5.0  # cost of a larger change
    # |ΔI| between neighbours at which a jump costs half, divided by the mean |ΔI|
    edge_steps: float = 1.2
    hidden_cost_weight: float = 0.02  # weight of the cost of a pixel that is not visible in frame 1
    hidden_distance: float = 1.5  # px of D: a pixel so far behind another surface is hidden
    # rigid_depth
    warps_factor: int = 3  # linearisations on the last level for each of `Settings.warps`
    deviation_window: int = 15  # px: side of the window that averages curvature and residual
    # With this factor, 68% of the visible pixels of rendered scenes, with noise of 0 to 5 grey
    # levels, lie within one deviation. Errors of the motion or the model are not included.
    deviation_factor: float = 0.75
    min_deviation: float = 0.001  # px: smallest standard deviation of D
    # rigid_level
    min_refined_scale: float = 0.45  # sampling density of a level on which motions are refined
    # factor of α in steps of the motion: smoothness is weak, so that a pixel's depth adapts
    weak_smoothness: float = 1e-4
    median_window: int = 5  # px: side of the window of the median of depth after each linearisation
    max_quiet_residual: float = 0.15  # px: a larger median residual increases the smoothness
    # residual of a pixel with a quarter of the weight, divided by the median residual
    outlier_residual: float = 1.5
    # estimate
    # px: residual of flow fields of rendered scenes under a rigid motion, from noise alone. A
    # larger residual shows an error of lens, shutter or pose.
    max_noise_residual: float = 0.016
    excess_residual_factor: float = 1.5  # error of D, px, for each px of more residual
    # textureless_depth
    # share of the pixels that match: with a smaller share, depth is not carried
    min_matched_share: float = 0.02
    texture_window: int = 11  # px: side of the window whose variance is compared with the noise
    # share of textureless windows in a frame that is partly textureless
    min_textureless_share: float = 0.04
    # variance of a window with texture, divided by the variance of the noise
    min_texture_variance: float = 1.8
    constraint_weight: float = 0.5  # weight of a constraint divided by that of a matched pixel
    # variance of a window where constraints have half the weight, divided by that of the noise
    half_weight_variance: float = 100.0
    carried_warps: int = 3  # linearisations while depth is carried
    carried_iterations: int = 2  # iterations of each of these linearisations
    max_carried_ratio: float = 2.0  # carried depth divided by the largest matched depth
    # share of the matched pixels, those with the largest depth, that this limit ignores
    ignored_far_share: float = 0.01
    # The standard deviation of D is the root of the sum of three squares: two parts below, and the
    # mean change of nearby matched pixels by the refinement. The error is within one deviation at
    # 76% of the pixels of TartanAir, and at 52% in a HoloLens recording with inexact poses.
    match_deviation: float = 0.1  # px: deviation of a matched pixel
    carried_deviation: float = 0.05  # px for every px of distance from the nearest matched pixel
    refinement_window: int = 31  # px: side of the window in which that mean is taken
    # precision of a pixel divided by that of a matched pixel; a smaller ratio counts as 0
    min_precision: float = 0.01
    carried_variance: float = 0.2  # px²: assumed variance of a pixel's D given its neighbours
    # matched_planes
    max_plane_pixels: int = 2**19  # pixels of the finest searched level
    min_plane_pixels: int = 2**14  # pixels of the coarsest searched level
    # rounds on the coarsest level, on the next level, and on all finer levels
    plane_rounds: tuple[int, ...] = (3, 2, 1)
    plane_draws: int = 2  # planes drawn near a pixel's own plane, in each round
    # px of D: spread of drawn planes on the coarsest level and on finer levels
    plane_spread: tuple[float, float] = (4.0, 1.0)
    plane_tilt: float = 0.05  # px per px: spread of the slopes of drawn planes
    plane_shrinkage: float = 0.6  # factor of both spreads after every round
    max_plane_depth: float = 0.35  # longer sides: largest D of the search
    # px: smallest D. A pixel that matches best behind the camera is not reliable. Without negative
    # D, it would match at infinity.
    min_plane_depth: float = -5.0
    # grey levels: smallest noise, from rounding, compression and interpolation
    min_noise: float = 0.7
    min_noise_share: float = 1 / 150  # limit of `min_noise`, as a share of the range of grey levels
    max_noise: float = 15.0  # grey levels: a larger deviation is texture, not noise
    # percentiles that define a frame's range of grey levels
    grey_percentiles: tuple[float, float] = (0.1, 99.9)
    grey_margin: float = 0.05  # share of this range that is added on both sides
    min_coarse_noise: float = 0.7  # grey levels of 255: smallest noise on coarse levels
    # variance of a window with a useful correlation, divided by the variance of the noise
    min_window_variance: float = 1.8
    quiet_share: float = 0.2  # share of the blocks, those with least change, that give the noise
    noise_block: int = 16  # px: side of a block
    max_plane_cost: float = 0.35  # matching cost of a reliable pixel
    # px: difference at a reliable pixel between D from frame 0 to 1 and D from frame 1 to 0
    max_plane_disagreement: float = 0.6
    min_plane_region: int = 200  # connected pixels of a reliable region


@dataclass(frozen=True, kw_only=True)
class GlobalDepthSettings:
    """Depth of frames far apart, searched along whole epipolar lines."""

    range_pixels: int = 2**15  # pixels of the level on which the range of depths is searched
    max_parallax: float = 0.5  # longer sides: largest D of the search
    # longer sides: frames are far apart if their largest parallax is at least this. With 0.05, two
    # more pairs of TartanAir and six of HoloLens are searched: in one, 12 % more pixels are right;
    # in four, 0.4 to 1.6 % fewer
    min_parallax: float = 0.08
    range_percentile: float = 99.0  # percentile of matched D that bounds the fine search
    range_margin: float = 0.3  # share by which the fine search exceeds it
    min_matched_share: float = 0.1  # share of the pixels that match, on the coarse level
    cost_factor: float = 2.0  # factor of the share of differing bits
    step_cost: float = 0.3  # cost of a change between neighbours by one hypothesis
    jump_cost: float = 4.0  # cost of a larger change
    # |ΔI| between neighbours at which a jump costs half, divided by the mean |ΔI|
    edge_steps: float = 2.0
    max_disagreement: float = 1.0  # px between D of both directions
    min_region: int = 40  # connected pixels of a reliable region
    region_step: float = 1.5  # px: largest step of D within a region
    line_step: float = 1.0  # px of D: step that shows the direction of an epipolar line
    median_window: int = 5  # px: side of the window of the median of filled depth
    # better_regions
    # px/frame of D: depths that differ by more are different; 0.5 and 2 give the same errors
    region_difference: float = 1.0
    # mean gain of correlation from which a region gets the new depth: on TartanAir, 17 % of the
    # pixels are wrong with 0.005 and 0.01, 20 % with 0.02
    min_gain: float = 0.005
    # px/frame: a pixel is hidden if it moves behind one whose D is larger by more; set by hand
    min_hidden_distance: float = 1.5


@dataclass(frozen=True, kw_only=True)
class SparseSettings:
    """Motion from matched points, for frames too distant for a flow field."""

    # sparse_matches
    # contrast of the detector: low, since rooms have few, faint points; matching drops wrong points
    min_contrast: float = 0.01
    max_pixels: int = 2**20  # a larger frame is matched on a coarser level
    cells: int = 16  # cells along a side of a square frame of the same area
    points_per_cell: int = 30  # strongest points that a cell keeps
    # distance of the nearest descriptor divided by the distance of the second nearest
    max_descriptor_ratio: float = 0.8
    # percentiles of frame 0 that are mapped to 0 and 255
    grey_percentiles: tuple[float, float] = (0.5, 99.5)
    # sparse_motion
    # px: distances of inliers from the epipolar line or the homography's point, in random samples
    inlier_distances: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    # random samples for each of these distances: half of the matches may be wrong
    max_draws: int = 10_000
    # px: largest distance of a match in each round, for two refinements of a start. Near matches
    # alone do not lead from a poor start to the minimum; far matches lead away from a good start.
    round_distances: tuple[tuple[float, ...], ...] = ((16.0, 6.0, 3.0), (3.0, 3.0))
    min_step: float = 1e-5  # rad, and share of ‖t‖: a shorter step ends the last round
    min_early_step: float = 1e-3  # `min_step` in all earlier rounds
    max_duplicate_difference: float = 1e-3  # difference of an entry of R or t between equal motions
    max_inlier_distance: float = 3.0  # px: distance of an inlier from its epipolar line
    iterations: int = 30  # iterations of a round
    min_matches: int = 12  # inliers: five fit any motion, and wrong matches add a few by chance
    min_residual: float = 0.3  # px: smallest residual, the accuracy of a detected point
    # robust cost of a motion that may be right too, divided by the smallest robust cost
    max_cost_ratio: float = 1.3
    min_translation_angle: float = 0.2  # rad between the translations of different motions
    coverage_cells: int = 8  # cells along each side of the image
    # sparse_start
    max_motions: int = 3  # motions that the images compare
    depth_percentile: int = 99  # percentile of the D of the matches that bounds the sweep
    depth_margin: float = 1.5  # largest D of the sweep divided by that percentile
    min_hypotheses: int = 4  # smallest number of depths in the sweep
    # gain of mean correlation: with a smaller gain, two motions are equally good
    min_correlation_gain: float = 0.01
    # homographies
    plane_samples: int = 400  # approximate number of rays that a homography is fitted to
    plane_rounds: int = 4  # rounds of robust weights in this fit
    # distances from points of a homography divided by distances from epipolar lines, on a plane.
    # Noise alone gives 1.75, since points have two components; real frames give 2.6 or more.
    max_plane_ratio: float = 2.2
    # the same ratio of scenes that are nearly a plane, for a camera with another focal length
    max_near_plane_ratio: float = 4.0
    plane_iterations: int = 10  # iterations of the second motion of a plane
    # residual of this motion over that of the best one: with more, it is not as likely
    max_second_residual: float = 1.3
    min_plane_distance: float = 0.02  # px: smallest distance from epipolar lines in real frames
    # share of the rays that meet a visible plane in front of the camera
    min_front_share: float = 0.99


@dataclass(frozen=True, kw_only=True)
class ProposalSettings:
    """Large displacements of a flow field, proposed by matched windows."""

    # matched_windows
    min_search_pixels: int = 2**12  # pixels of the coarsest searched level
    # variance of a compared window divided by the variance of the noise
    min_window_variance: float = 1.8
    # rounds of improvement on the first, the second and all later levels
    rounds: tuple[int, ...] = (6, 3, 2)
    wide_rounds: int = 5  # rounds on the first level that draw wide displacements
    min_wide_draws: int = 5  # smallest number of draws of a pixel in a wide round
    max_wide_draws: int = 64  # largest number of draws of a pixel in a wide round
    wide_draws: int = 2**14  # draws of all pixels in a wide round, within these bounds
    near_draws: int = 3  # draws of a pixel in any other round, around its displacement
    neighbour_distance: int = 5  # px: distance of neighbours whose displacements are tried
    max_wide_span: float = 0.35  # longer sides: span of wide draws
    min_wide_span: float = 4.0  # px: smallest span of wide draws
    near_span: float = 4.0  # px: span of all other draws
    span_shrinkage: float = 0.6  # factor of this span after every round
    max_residual: float = 5.0  # standard deviations of the noise at which residuals are clipped
    # flow_proposals
    max_pixels: int = 2**18  # pixels of the level whose flow is corrected
    # pixels of the level on which the flow is evaluated (the judged level)
    min_judged_pixels: int = 2**14
    min_poor_cost: float = 0.5  # matching cost of a wrong flow, unless the pixel is occluded
    max_good_cost: float = 0.3  # matching cost of most correct flows
    # variance of an evaluated window divided by the variance of the noise
    min_judged_variance: float = 6.0
    # share of poor pixels from which the whole frame is searched: at most 0.06 if motion is right,
    # 0.11 and more if the flow misses much of it. With a smaller share, only fast objects are
    # searched.
    min_poor_share: float = 0.08
    target_window: int = 7  # px: side of the window that is searched around a target pixel
    max_cost: float = 0.5  # matching cost of an accepted displacement
    max_disagreement: float = 2.0  # px between the displacements of both directions
    min_region: int = 100  # px: connected pixels with displacements within 1 px of each other
    # share of the textured pixels whose displacement is accepted: 0.6 and more in frames of one
    # scene, below 0.05 otherwise
    min_accepted_share: float = 0.2
    min_change: float = 1.0  # px: difference of a new displacement from the earlier displacement
    min_cost_gain: float = 0.05  # decrease of the matching cost by a new displacement
    residual_window: int = 5  # px: side of the square whose residuals are compared
    # decrease of residuals by a fast object's displacement, in standard deviations of the noise
    object_gain: float = 0.6
    fill_gain: float = 0.3  # the same decrease by the displacement of a neighbour
    # matching cost of a displacement that the displacement of a neighbour may replace
    min_filled_cost: float = 0.3
    # px/frame per px: a flow that changes faster than by rotations and zooms is not continuous
    max_flow_slope: float = 0.5
    fill_passes: int = 6  # passes of filling from known pixels, along rows and columns
    # |ΔI| that counts as one pixel of distance in filling, divided by the mean |ΔI|
    edge_distance: float = 0.33
    # fast_objects; on the judged level, the size of the windows makes areas larger
    min_judged_area: int = 24  # px of the judged level: area of a fast object
    min_corrected_area: int = 50  # px of the corrected level: area of a fast object
    # motion of a fast object on the judged level, divided by the square root of its area
    min_judged_speed: float = 0.25
    min_corrected_speed: float = 0.5  # `min_judged_speed` on the corrected level
    min_support: int = 10  # pixels with a clear decrease of the residual, on the judged level
    min_consistent_share: float = 0.25  # share of an area that is matched in both directions
    # mean square of the grey slope of a fast object along any direction, divided by the variance of
    # the noise. Noise alone has ½; correct areas had 0.97 and more.
    min_slope: float = 0.8
    # longer sides: motion of a fast object. Correct areas moved by at most 0.35, the limit
    # of the search (`max_wide_span`), and wrong areas by 0.5.
    max_object_motion: float = 0.4
    object_draws: int = 2**15  # random displacements in each round, near a suspected object
    outside_margin: int = 5  # px outside an outline within which a new outline is searched
    inside_margin: int = 2  # px inside an outline within which a new outline is searched
    outline_window: int = 3  # px: side of the square whose residuals assign a pixel
    outline_rounds: int = 3  # searches of an outline, each from the previous one
    outline_fill_passes: int = 2  # passes along rows and columns that fill a flow from known pixels


@dataclass(frozen=True, kw_only=True)
class PreviousFrameSettings:
    """Data of the previous frame. The bend is the sum of the flows to both neighbours."""

    # a pixel of a coarser level is hidden if a larger share of its area is hidden
    min_hidden_share: float = 0.5
    min_arrivals: float = 0.5  # smallest number of pixels that move to a visible pixel
    grid_step: int = 4  # px between rows and columns that the bend is fitted to
    window_radius: int = 64  # px: half the side of the window in which the bend is fitted
    # px²: added to variances of the flow; smaller variances hardly determine the bend's slope
    added_variance: float = 0.05
    # px: deviation from the bend at which a pixel has half the weight: it may show another surface
    half_weight_deviation: float = 0.1
    # px: all pixels in a window of this side around a fitted pixel are visible in all frames
    visible_window: int = 3
    mean_radius: int = 2  # grid pixels: half the window that averages deviations from the bend
    half_trust_deviation: float = 0.3  # px: deviation from the bend that halves the trust in it
    # px: `half_trust_deviation` for a pixel that is hidden in the next frame
    half_trust_deviation_if_hidden: float = 1.0
    # length of the bend of a steady motion divided by the length of the backward flow
    max_bend_ratio: float = 0.5
    max_bend_at_rest: float = 1.0  # px: length that is added to the largest bend
    # residual of the predicted flow divided by the residual of a visible pixel's flow: with a
    # smaller ratio, the predicted flow replaces the pixel's flow
    max_residual_ratio: float = 0.8
    min_fitting_share: float = 0.5  # share of the pixels visible in three frames that fit the bend


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Checks of flow, pose and depth against the frames."""

    # frame_agreement
    # median correlation of frames that show the same scene: 0.97 and more on benchmarks, 0.65
    # under noise of 40 grey levels; below 0.4 between unrelated scenes and in noise
    min_correlation: float = 0.5
    # The images confirm a motion of half the image or more if the common part of the frames has at
    # least this median correlation and this median motion.
    min_large_motion_correlation: float = 0.9
    min_large_motion: float = 0.25  # longer sides
    # share of the trusted pixels at which a flow folds over: at most 0.08 between real frames,
    # where large parts of the flow were wrong; with "paper" 0.17 and more between unrelated frames
    max_folded_share: float = 0.12
    min_judged_pixels: int = 2**12  # pixels of the level on which a flow is evaluated
    # share of the textured windows in which two frames at rest differ. Noise, and an object that
    # moves in front of a camera at rest, give 0; a picture whose middle is replaced gives 0.21 for
    # 37 % of the area and 0.48 for 52 %.
    max_replaced_share: float = 0.15
    # share of the squares with differences that one displacement matches in the other frame. An
    # object that moves and fills a sixth to a third of the frame gives 0.52 and more; a picture
    # whose middle is replaced gives 0.28 at most.
    min_common_share: float = 0.4
    min_square_correlation: float = 0.8  # correlation of a square with its match in the other frame
    square_side: int = 15  # px: side of a square that is searched in the other frame
    square_step: int = 5  # px between neighbouring squares
    # variance of a textured window divided by the variance of the noise
    min_textured_variance: float = 16.0
    # percentile of the variances of differences that gives the variance of the noise
    noise_percentile: int = 10
    min_textured_share: float = 0.05  # share of textured windows in frames that are evaluated
    # A frame consists of stripes if at most the first share of its windows have more than the
    # second share of their variation along the stripes. Noise of 20 grey levels on stripes of 40
    # gives a second share of 0.17, real frames more than a half.
    max_stripe_exceptions: float = 0.01
    max_stripe_variation: float = 0.25
    faint_share: float = 0.01  # share of the mean variation: a smaller variation is ignored
    # longer sides: longest vector of a flow, 0.12 on benchmarks, 0.7 and more if the flow diverges
    max_flow: float = 0.5
    # share of the pixels that leave the image: at most 0.08 on benchmarks
    max_leaving_share: float = 0.5
    # Both limits if matched points, a pose or the images confirm the motion: near objects cross the
    # whole image, and after a rotation by 20° two thirds of the pixels had left it.
    max_confirmed_flow: float = 1.0
    max_confirmed_leaving_share: float = 0.8
    # depth_checks
    # distance of a flow from the epipolar lines of a given pose, divided by its distance for the
    # best motion: at most 5.7 for measured poses (7-Scenes), 17 and more if such a pose is inverted
    # or its translation is reversed
    max_pose_ratio: float = 8.0
    min_pose_distance: float = 0.02  # px: smallest distance for the best motion in real frames
    # share of the visible texture that the flow field aligns better than motion and depth: at
    # most 0.11 if depth is wrong by less than a tenth, 0.17 and more if wrong by more than half
    max_unexplained_share: float = 0.15
    # gain of correlation by which the flow field aligns the frames better
    min_correlation_gain: float = 0.1
    # share of the visible pixels behind the camera: at most 0.001 if depth is wrong by less
    # than a tenth, 0.039 and more if wrong by more than half
    max_behind_share: float = 0.03
    min_behind_deviations: float = 3.0  # standard deviations by which such a pixel lies behind
    # negative inverse depth of such a pixel, divided by the median |inverse depth|
    min_behind_depth: float = 0.1
    # share of the visible pixels with uncertain depth: at most 0.03 if depth is wrong by < 15 %
    max_uncertain_share: float = 0.05
    # standard deviation of uncertain inverse depth, divided by this inverse depth and by the median
    max_relative_deviation: float = 0.5
    # a pixel of a coarser level is visible if a smaller share of its area is hidden
    max_hidden_share: float = 0.3
    min_brightness_ratio: float = 1.15  # ratio of mean brightness, if the light may have changed


EGOMOTION = EgomotionSettings()
DEPTH = DepthSettings()
GLOBAL = GlobalDepthSettings()
SPARSE = SparseSettings()
PROPOSALS = ProposalSettings()
PREVIOUS = PreviousFrameSettings()
CHECKS = CheckSettings()
