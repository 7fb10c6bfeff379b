"""Tuned numbers of motion models; without another source, a number was set by hand.

Each stage has one frozen class and one instance. `python -m bench.sensitivity` varies the fields.
A length "of the longer side" is a share of the image's longer side.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EgomotionSettings:
    """First motion of the camera, from a flow field."""

    # egomotion
    samples: int = 5000  # pixels of a flow that are fitted, about; neighbours are similar
    inlier_distances: tuple[float, ...] = (0.05, 0.2, 0.8)  # px from epipolar lines, in USAC
    max_draws: int = 2000  # random samples of five correspondences
    start_samples: int = 1000  # samples that select the best start
    start_iterations: int = 6  # for each start
    iterations: int = 30  # for the best start
    # confident samples: five give an essential matrix, and the others verify it
    min_confident_samples: int = 8
    # epipolar_fit
    min_confidence: float = 0.1  # of rays from which essential matrices are sampled
    min_step: float = 1e-6  # rad, and of ‖t‖ = 1: a shorter step ends the iterations
    min_scale: float = 0.01  # px: accuracy of the best flow
    # rad/frame: standard deviation of an object's rotation relative to the background
    rotation_deviation: float = 0.001
    correlated_pixels: int = 50  # neighbours that share an error, a patch of about 7 × 7
    # first_motion
    min_warps: int = 2  # linearisations on the level of the flow field
    # Parallax over the residual of the fit. Noise alone gives 2 if the camera only rotates. On
    # hand-held sequences, depth with a ratio below `good_parallax` was little better than a
    # constant: errors of lens and shutter exceed a parallax below a pixel, and the residual does
    # not contain them. From `fair_parallax` on, depth was better than a constant in most pairs.
    min_parallax: float = 2.5
    fair_parallax: float = 4.0
    good_parallax: float = 6.0
    good_subpixel_parallax: float = 9.0  # the same if the parallax is less than 1 px
    min_residual: float = 0.005  # px of the level: accuracy of a flow
    # px of the level: residual of a fit above which points are matched. At most 0.045 on rendered
    # scenes and in a textured studio; from 0.065 on in rooms with bare walls and between distant
    # frames, where directions were off by degrees.
    max_flow_residual: float = 0.06
    max_still_flow: float = 0.1  # px: median flow of a camera at rest
    max_still_flow_in_noise: float = 0.3  # px: the same in noisy frames
    # rolling_shutter
    shutter_rounds: int = 2  # estimates of the motion, each from the previous corrected frames
    shutter_iterations: int = 4  # that find the pixel of frame 0 for a pixel of frame 1


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """Dense depth of rigid motions."""

    # camera
    # of the longer side: difference of parallax between near and far from which depth is carried
    # across partly textureless frames. Below, coarse to fine follows weak texture better.
    min_carried_range: float = 0.019
    # textureless share of a frame above which the images show mostly noise, so a finer flow field
    # refines the motion
    max_textureless_in_refinement: float = 0.15
    min_first_pixels: int = 2**14  # pixels of the flow field that gives the first motion
    # plane_sweep
    neighbour_weight: float = 0.05  # of the window in triangulation, for equal parallax
    neighbour_window: int = 7  # px
    sweep_median_window: int = 5  # px
    # px: difference of parallax between near and far from which a plane sweep is needed. Coarse to
    # fine loses objects that are smaller than their displacement.
    min_sweep_range: float = 20.0
    max_range_pixels: int = 2**15  # pixels of the level on which the range of depths is searched
    max_range_parallax: float = 0.2  # of the longer side: largest parallax of that search
    range_percentiles: tuple[int, int] = (1, 99)  # of depth, that bound the range
    range_margin: float = 0.3  # share by which the hypotheses extend beyond that range
    # mean steps between neighbours in frame 0: largest difference of brightness that counts; for
    # derivatives of brightness a quarter
    max_brightness_difference: float = 2.4
    guess_distance: float = 4.0  # px/frame from the guess, beyond which depth costs more
    guess_cost: float = 0.05  # of such a depth, if the guess has no trust
    guess_cost_of_trust: float = 0.3  # extra cost for full trust; it decides without texture
    step_cost: float = 0.3  # of a change between neighbours by one hypothesis
    jump_cost: float = 5.0  # of a larger change
    edge_steps: float = 1.2  # mean steps: difference of neighbours at which a jump costs half
    hidden_cost_weight: float = 0.02  # of the cost of a pixel that is not visible in frame 1
    hidden_distance: float = 1.5  # px of D: a pixel so far behind another surface is hidden
    # rigid_depth
    warps_factor: int = 3  # linearisations on the last level for each of `Settings.warps`
    deviation_window: int = 15  # px: window that averages curvature and residual
    # With this factor, 68% of the visible pixels of rendered scenes, with noise of 0 to 5 grey
    # levels, lie within one deviation. Errors of the motion or the model are not included.
    deviation_factor: float = 0.75
    min_deviation: float = 0.001  # px
    # rigid_level
    min_refined_scale: float = 0.45  # sampling density of a level on which motions are refined
    # times α: weak smoothness in steps of the motion, so that a pixel's depth adapts
    weak_smoothness: float = 1e-4
    median_window: int = 5  # px: of the median of depth after each linearisation
    max_quiet_residual: float = 0.15  # px: smoothness grows with the median residual above it
    outlier_residual: float = 1.5  # median residuals: a pixel with more hardly counts
    # estimate
    # px: residual of flow fields of rendered scenes under a rigid motion, from noise alone. More is
    # an error of lens, shutter or pose.
    max_noise_residual: float = 0.016
    excess_residual_factor: float = 1.5  # error of D, px, for each px of more residual
    # textureless_depth
    min_matched_share: float = 0.02  # of the pixels: share of matches that is carried
    texture_window: int = 11  # px: its variance is compared with the noise
    min_textureless_share: float = 0.04  # of the windows, in a frame that is partly textureless
    min_texture_variance: float = 1.8  # variances of the noise, of a window with texture
    constraint_weight: float = 0.5  # relative to a matched pixel
    half_weight_variance: float = 100.0  # variances of the noise at which constraints weigh half
    carried_warps: int = 3  # linearisations
    carried_iterations: int = 2  # of each linearisation
    max_carried_ratio: float = 2.0  # of carried depth to the largest matched depth
    far_share: float = 0.01  # of the matched pixels, ignored in the largest matched depth
    # Standard deviations of D. The mean change of matched pixels nearby by the refinement is
    # added. Then 76% of the pixels of TartanAir lie within one deviation, and 52% of a HoloLens,
    # whose poses are not exact.
    match_deviation: float = 0.1  # px, of a matched pixel
    carried_deviation: float = 0.05  # px for every px that depth is carried
    refinement_window: int = 31  # px: window of that mean change
    min_precision: float = 0.01  # of the precision of a matched pixel; less counts as 0
    carried_variance: float = 0.2  # px²: for the share of the data in a pixel's depth
    # matched_planes
    max_plane_pixels: int = 2**19  # pixels of the finest searched level
    min_plane_pixels: int = 2**14  # pixels of the coarsest searched level
    plane_rounds: tuple[int, ...] = (3, 2, 1)  # on the coarsest level, the next, all others
    plane_draws: int = 2  # planes drawn near a pixel's own plane, in each round
    plane_spread: tuple[float, float] = (4.0, 1.0)  # px of D: on the coarsest and other levels
    plane_tilt: float = 0.05  # spread of the slopes
    plane_shrinkage: float = 0.6  # factor of both spreads after every round
    max_plane_depth: float = 0.35  # of the longer side: largest D of the search
    # px: smallest D. A pixel that matches best behind the camera is not reliable. Without negative
    # D, it would match at infinity.
    min_plane_depth: float = -5.0
    min_noise: float = 0.7  # grey levels: from rounding, compression and interpolation
    min_noise_share: float = 1 / 150  # of the range of grey levels, which limits `min_noise`
    max_noise: float = 15.0  # grey levels: a larger deviation is texture
    grey_percentiles: tuple[float, float] = (0.1, 99.9)  # that define a frame's range
    grey_margin: float = 0.05  # share of the range, on both sides
    min_coarse_noise: float = 0.7  # levels of 255
    min_window_variance: float = 1.8  # variances of the noise, for a useful correlation
    quiet_share: float = 0.2  # of the blocks, the quietest, in which noise is measured
    noise_block: int = 16  # px: side of a block
    max_plane_cost: float = 0.35  # of a reliable pixel
    max_plane_disagreement: float = 0.6  # px between both directions at a reliable pixel
    min_plane_region: int = 200  # connected pixels of a reliable region


@dataclass(frozen=True, kw_only=True)
class SparseSettings:
    """Motion from matched points, for frames too distant for a flow field."""

    # sparse_matches
    # contrast of the detector: low, since rooms have few, faint points; matching removes wrong ones
    min_contrast: float = 0.01
    max_pixels: int = 2**20  # a larger frame is matched on a coarser level
    cells: int = 16  # cells along a side of a square frame of the same area
    points_per_cell: int = 30  # the strongest
    max_descriptor_ratio: float = 0.8  # of distances of the nearest and second nearest descriptor
    grey_percentiles: tuple[float, float] = (0.5, 99.5)  # of frame 0, mapped to 0 and 255
    # sparse_motion
    # px from the epipolar line or the homography's point: inliers of random samples
    inlier_distances: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    max_draws: int = 10_000  # random samples for a distance: half of the matches may be wrong
    # px: largest distances of the matches in each round, for two refinements of a start. Near
    # matches alone miss the least cost from a poor start; far ones lead away from a good start.
    round_distances: tuple[tuple[float, ...], ...] = ((16.0, 6.0, 3.0), (3.0, 3.0))
    min_step: float = 1e-5  # rad, and of ‖t‖ = 1: a shorter step ends the last round
    min_early_step: float = 1e-3  # the same in the rounds before
    max_duplicate_difference: float = 1e-3  # of an entry of R or t between equal motions
    max_inlier_distance: float = 3.0  # px
    iterations: int = 30  # of a round
    min_matches: int = 12  # inliers: five fit any motion, and wrong matches add a few by chance
    min_residual: float = 0.3  # px: accuracy of a detected point
    max_cost_ratio: float = 1.3  # to the least robust cost, of motions that may be right as well
    min_translation_angle: float = 0.2  # rad between the translations of different motions
    coverage_cells: int = 8  # cells along each side of the image
    # sparse_start
    max_motions: int = 3  # that the images compare
    depth_percentile: int = 99  # of the matches' D
    depth_margin: float = 1.5  # largest D of the sweep relative to that percentile
    min_hypotheses: int = 4
    min_correlation_gain: float = 0.01  # of the mean: with less, two motions are equally good
    # homographies
    plane_samples: int = 400  # rays that a homography is fitted to, about
    plane_rounds: int = 4  # of robust weights
    # distances from a homography's points over those from epipolar lines, for a plane. The former
    # have two components, so noise alone makes it 1.75; in real frames it is 2.6 or more.
    max_plane_ratio: float = 2.2
    min_plane_distance: float = 0.02  # px, in real frames
    min_front_share: float = 0.99  # of the rays that meet a visible plane before the camera


@dataclass(frozen=True, kw_only=True)
class ProposalSettings:
    """Large displacements of a flow field, proposed by matched windows."""

    # matched_windows
    min_search_pixels: int = 2**12  # pixels of the coarsest level
    min_window_variance: float = 1.8  # variances of the noise, of a window that is compared
    rounds: tuple[int, ...] = (6, 3, 2)  # of improvement: first, second, all later levels
    wide_rounds: int = 5  # on the first level, that draw wide displacements
    min_wide_draws: int = 5  # of each pixel in a wide round
    max_wide_draws: int = 64  # of each pixel in a wide round
    wide_draws: int = 2**14  # of all pixels in a wide round, between these bounds
    near_draws: int = 3  # of each pixel in all other rounds, around its displacement
    neighbour_distance: int = 5  # px: of distant neighbours whose displacements are tried
    max_wide_span: float = 0.35  # of the longer side: span of wide draws
    min_wide_span: float = 4.0  # px
    near_span: float = 4.0  # px: span of the other draws
    span_shrinkage: float = 0.6  # factor of this span after every round
    max_residual: float = 5.0  # deviations of the noise, at which residuals are clipped
    # flow_proposals
    max_pixels: int = 2**18  # of the level whose flow is corrected
    min_judged_pixels: int = 2**14  # of the level on which the flow is evaluated
    min_poor_cost: float = 0.5  # matching cost of a wrong flow, unless the pixel is occluded
    max_good_cost: float = 0.3  # matching cost of most correct flows
    min_judged_variance: float = 6.0  # variances of the noise, of a window that is evaluated
    # share of poor pixels from which the whole frame is searched: at most 0.06 if motion is right,
    # 0.11 and more if much of it is missed. Below it, only fast objects are searched.
    min_poor_share: float = 0.08
    target_window: int = 7  # px: window searched around a target pixel
    max_cost: float = 0.5  # of a displacement that is accepted
    max_disagreement: float = 2.0  # px between the displacements of both directions
    min_region: int = 100  # pixels with displacements within 1 px of each other
    # accepted over textured pixels: 0.6 and more in frames of one scene, below 0.05 in others
    min_accepted_share: float = 0.2
    min_change: float = 1.0  # px by which a new displacement differs
    min_cost_gain: float = 0.05  # by which the matching cost of a new displacement is lower
    residual_window: int = 5  # px: side of the square whose residuals are compared
    object_gain: float = 0.6  # deviations of the noise by which residuals fall for a fast object
    fill_gain: float = 0.3  # the same for a neighbour's displacement
    min_filled_cost: float = 0.3  # of a displacement that a neighbour's may replace
    # px/frame per px: a flow that changes faster, beyond turns and zooms, is broken
    max_flow_slope: float = 0.5
    fill_passes: int = 6  # of filling from known pixels, along rows and columns
    edge_distance: float = 0.33  # mean grey steps that count as one pixel of distance in filling
    # fast_objects; areas are larger on the judged level by the size of the windows
    min_judged_area: int = 24  # px of the judged level
    min_corrected_area: int = 50  # px of the corrected level
    min_judged_speed: float = 0.25  # motion over the square root of the area
    min_corrected_speed: float = 0.5
    min_support: int = 10  # pixels of an area, on the judged level, whose residual falls clearly
    min_consistent_share: float = 0.25  # of an area that is matched in both directions
    # mean square of the slope along any direction, in variances of the noise, of a fast object.
    # Noise alone has ½; correct areas had 0.97 and more.
    min_slope: float = 0.8
    # of the longer side: motion of a fast object. Correct areas moved by at most 0.35, the limit
    # of the search (`max_wide_span`), and wrong ones by 0.5.
    max_object_motion: float = 0.4
    object_draws: int = 2**15  # random displacements in each round, near a suspected object
    outside_margin: int = 5  # px outside an outline within which a new one is searched
    inside_margin: int = 2  # px inside it
    outline_window: int = 3  # px: side of the square whose residuals assign a pixel
    outline_rounds: int = 3  # searches of an outline, each from the previous one
    outline_fill_passes: int = 2  # along rows and columns, that fill a flow from known pixels


@dataclass(frozen=True, kw_only=True)
class PreviousFrameSettings:
    """Data of the previous frame."""

    min_hidden_share: float = 0.5  # of a hidden pixel on a coarser level
    min_arrivals: float = 0.5  # pixels of the previous frame that move to a pixel visible in it
    grid_step: int = 4  # px between rows and columns that the bend is fitted to
    reach: int = 64  # px: half the side of the window that the bend is fitted in
    # px²: added to variances of the flow; smaller ones hardly determine the bend's slope
    added_variance: float = 0.05
    # px: deviation from the bend that halves a pixel's weight, as it shows another surface
    half_weight_deviation: float = 0.1
    visible_window: int = 3  # px: around a fitted pixel; it is visible in all frames
    mean_reach: int = 2  # grid pixels: half the window that averages deviations from the bend
    half_trust_deviation: float = 0.3  # px from the bend, that halves the trust in it
    half_trust_deviation_if_hidden: float = 1.0  # px
    max_bend_ratio: float = 0.5  # of a steady motion, to the backward flow
    max_bend_at_rest: float = 1.0  # px, in addition
    # residual of the predicted flow over that of a visible pixel's flow, if it replaces this flow
    max_residual_ratio: float = 0.8
    min_fitting_share: float = 0.5  # of the pixels visible in three frames, that fit the bend


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
    min_large_motion: float = 0.25  # of the longer side
    # share of the trusted pixels at which a flow folds over: at most 0.08 between real frames, and
    # then the flow misses much; with "paper" 0.17 and more between unrelated frames
    max_folded_share: float = 0.12
    min_judged_pixels: int = 2**12  # of the level on which a flow is evaluated
    # share of the textured windows in which two frames at rest differ. Noise, and an object that
    # moves before a camera at rest, give 0.00; a picture whose middle is replaced gives 0.21 for
    # 37 % of the area and 0.48 for 52 %.
    max_replaced_share: float = 0.15
    # share of the squares with differences that one displacement matches in the other frame. An
    # object that moves and fills a sixth to a third of the frame gives 0.52 and more; a picture
    # whose middle is replaced gives 0.28 at most.
    min_common_share: float = 0.4
    min_square_correlation: float = 0.8  # of a square that is found in the other frame
    square: int = 15  # px: side of a square that is searched in the other frame
    square_step: int = 5  # px between squares
    min_textured_variance: float = 16.0  # variances of the noise, of a textured window
    noise_percentile: int = 10  # of the variances of differences, which is taken for the noise
    min_textured_share: float = 0.05  # of the windows, in frames that are evaluated
    # A frame consists of stripes if at most the first share of its windows has more than the second
    # share of its variation along the stripes. Noise of 20 grey levels on stripes of 40 gives a
    # share along of 0.17; in real frames it is above a half.
    max_stripe_exceptions: float = 0.01
    max_stripe_variation: float = 0.25
    faint_share: float = 0.01  # of the mean variation: windows with less do not count
    max_flow: float = 0.5  # of the longer side: 0.12 on benchmarks, 0.7 and more if flow diverges
    max_leaving_share: float = 0.5  # of the pixels leave the image: at most 0.08 on benchmarks
    # The same if matched points, a pose or the images confirm the motion: near objects cross the
    # whole image, and after a rotation by 20° two thirds of the pixels had left it.
    max_confirmed_flow: float = 1.0
    max_confirmed_leaving_share: float = 0.8
    # depth_checks
    # distance of a flow from a given pose, over that from the best motion: at most 5.7 for measured
    # poses (7-Scenes), 17 and more if such a pose is inverted or its translation is reversed
    max_pose_ratio: float = 8.0
    min_pose_distance: float = 0.02  # px: distances from the best motion in real frames
    # share of the visible texture that the flow field aligns better than motion and depth do: at
    # most 0.11 if depth is off by less than a tenth, 0.17 and more if off by more than half
    max_unexplained_share: float = 0.15
    min_correlation_gain: float = 0.1  # by which the flow field aligns the frames better
    # share of the visible pixels behind the camera: at most 0.001 if depth is off by less than a
    # tenth, 0.039 and more if off by more than half
    max_behind_share: float = 0.03
    min_behind_deviations: float = 3.0  # standard deviations that such a pixel lies behind
    min_behind_depth: float = 0.1  # of the median |inverse depth|, that it lies behind as well
    # share of the visible pixels with uncertain depth: at most 0.03 if depth is off by < 0.15
    max_uncertain_share: float = 0.05
    # standard deviation of uncertain inverse depth, over itself and over the median
    max_relative_deviation: float = 0.5
    max_hidden_share: float = 0.3  # of a pixel of a coarser level that counts as visible
    min_brightness_ratio: float = 1.15  # of mean brightness, if the light may have changed


EGOMOTION = EgomotionSettings()
DEPTH = DepthSettings()
SPARSE = SparseSettings()
PROPOSALS = ProposalSettings()
PREVIOUS = PreviousFrameSettings()
CHECKS = CheckSettings()
