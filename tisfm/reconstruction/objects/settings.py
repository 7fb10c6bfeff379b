"""Tuned numbers of moving objects; without another source, a number was set by hand.

Evidence of a pixel is −1 (static) to 3 (moving). The weight of the evidence is a number of frames;
each frame adds 0 to 1. A data weight, 0 to 1, weighs a pixel's label cost against
differences between neighbouring labels. The size of an object is the square root of its area in px.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ObjectSettings:
    """Labels, paths and depth of moving objects."""

    # motion_evidence
    pair_steps: tuple[int, ...] = (1, 3)  # frames before and after that a frame is compared with
    # standard deviation of the image motion, as a share of the longer side of the frame; the
    # residual of the fitted camera motion is added
    flow_deviation: float = 1.5e-4
    # standard deviations: distance from the camera's motion with evidence 0
    neutral_deviations: float = 3.0
    static_evidence: float = -1.0  # evidence of one frame for a clearly static pixel
    moving_evidence: float = 3.0  # largest evidence of one frame, for a moving pixel
    static_prior: float = 0.3  # frames: weight of the prior that a pixel is static
    # share of a frame's evidence that is passed on to the next frame
    passed_evidence_share: float = 0.8
    comparison_window: int = 5  # px: side of the window in which images are compared
    # grey levels: evidence of motion has its full weight if a pixel matches exactly at its moved
    # position, and differs by this number at every static position
    full_evidence_difference: float = 4.0
    min_support: float = 0.05  # factor of evidence of motion that grey levels do not support
    # largest inverse depth of a static position that is tried, divided by the largest inverse depth
    # of clearly static pixels
    max_inverse_depth_factor: float = 3.0
    static_position_step: float = 2.0  # px between two static positions that are tried
    # smallest and largest number of static positions that are tried
    static_position_range: tuple[int, int] = (8, 32)
    # depth of a point in another frame divided by its depth in this frame
    min_depth_ratio: float = 0.05
    # path_evidence
    # frames before and after in which one depth has to fit
    path_steps: tuple[int, ...] = (1, 2, 3, 5, 8)
    depth_rounds: int = 3  # reweighted rounds of the robust fit of depth
    # px: error with half the weight, divided by the root of the distance in frames
    outlier_error: float = 3.0
    # standard deviation of static points from a usable camera path, as a share of the longer side
    max_path_error: float = 1.5e-3
    # sequence_labels
    # largest change of the focal length, logarithm, with which the evidence of frame pairs is kept
    max_focal_change: float = 0.02
    min_static_weight: float = 0.3  # frames: weight of the evidence of a static pixel
    min_ground_share: float = 0.03  # share of the pixels that show the ground
    max_roll_slope: float = 0.15  # tangent of the roll of an upright camera above the ground
    max_pitch_slope: float = 0.4  # tangent of the pitch of an upright camera above the ground
    # largest difference of a ground pixel from the plane, as a share of its inverse depth
    ground_tolerance: float = 0.07
    ground_trials: int = 300  # random planes in the robust fit of the ground
    ground_sample: int = 4000  # pixels on which these planes are compared
    ground_rounds: int = 3  # least-squares rounds after the trials
    # range of the camera's height above the ground in nearby frames, divided by the height: a
    # camera on a vehicle keeps its height
    max_height_change: float = 0.3
    height_frames: int = 10  # frames before and after with which this height is compared
    min_ground_frame_share: float = 0.5  # share of these frames that need a ground plane
    # depth of a pixel below the ground divided by the depth of the ground
    min_below_ground_ratio: float = 1.3
    # inverse depth of the ground that is searched for objects, divided by the largest inverse depth
    # in the frame
    min_ground_inverse_depth: float = 0.2
    hidden_steps: tuple[int, ...] = (3, 5, 8)  # frames before and after whose points may be hidden
    min_hidden_difference: float = 12.0  # grey levels, mean, at the position of a hidden point
    min_hidden_points: float = 1.0  # static points that an object hides, divided by its size
    # largest share of the pixels, mean over the frames, that may be ignored as moving under
    # `camera`, or labelled with a path of all pixels; it was 0.45 in a jam between lorries
    max_masked_share: float = 0.6
    # static_path
    label_rounds: int = 2  # how often labels are found with a path of all pixels, and a longer one
    # moving_regions
    region_evidence: float = -0.3  # mean evidence at the boundary of a moving region
    core_evidence: float = 0.3  # mean evidence in the core of a region, which a new object needs
    min_core_weight: float = 1.5  # frames: weight of the evidence of a pixel in the core
    min_core_ratio: float = 0.25  # pixels of a core divided by the pixels of the smallest object
    min_core_share: float = 0.15  # pixels of a core divided by the pixels of its region
    known_object_bonus: float = 0.4  # mean evidence that is added where a known object is expected
    # Evidence that is added where a pixel near a known object shares its motion. It was chosen on
    # two clips of DAVIS, with an earlier form of the rule: IoU of car-shadow was 0.70 with 1, 0.77
    # with 1.5, 0.84 with 3; camel hardly changed. The other limits of shared motion were set by
    # hand.
    shared_motion_bonus: float = 2.0
    # distance of such pixels from the object, divided by the square root of its area
    shared_motion_range: float = 0.25
    surroundings_width: int = 20  # px: width of the ring that shows the motion of the surroundings
    max_shared_deviations: float = 2.5  # standard deviations of a pixel from the object's motion
    # residual from the object's motion, divided by the residual from the surroundings' motion
    max_shared_ratio: float = 0.5
    min_shared_motion: float = 0.3  # px: residual from the motion of the surroundings
    # largest area of an object that takes such pixels, over the largest at which it moved clearly
    max_growth: float = 2.0
    full_weight_frames: float = 4.0  # frames: weight of the evidence with the full data weight
    max_data_weight: float = 0.5  # full data weight
    min_data_share: float = 0.02  # data weight without evidence, divided by the full data weight
    min_motion_pixels: int = 30  # pixels that the fit of a smooth motion needs
    min_quadratic_pixels: int = 400  # pixels that the fit of a quadratic motion needs
    # px/frame: difference of a pixel with a quarter of the weight, in the first round, from the
    # expected velocity
    velocity_tolerance: float = 1.0
    min_motion_deviation: float = 0.2  # px: standard deviation from a smooth motion
    # identities
    # share of a region's pixels with the propagated label of an object, which the region may show
    min_propagated_share: float = 0.1
    min_reappeared_share: float = 0.2  # visible share of an occluded object that is recognised
    histogram_bins: int = 16  # bins of a histogram of grey levels
    search_margin: float = 0.1  # margin around an object's predicted mask, divided by its size
    min_quadratic_visible_share: float = 0.5  # visible share of an object, for a quadratic motion
    # visible share of an object, for an affine motion; with a smaller share, a velocity is fitted
    min_affine_visible_share: float = 0.15
    max_motion_deviations: float = 4.0  # standard deviations of an object's pixel from its motion
    # median error of a new object's pixels under the motion fitted to them, divided by their median
    # error under the nearest known motion
    max_new_error_ratio: float = 0.5
    max_motion_error: float = 1e3  # px: limit of the errors of a motion
    # share of a pixel's smallest error: a smaller difference between the errors of two motions
    # hardly counts where no motion fits
    relative_error_tolerance: float = 0.5
    # largest cost of a motion: its squared error divided by the squared usual error
    max_motion_cost: float = 16.0
    # cost of a label other than the propagated label, in the same unit
    identity_change_cost: float = 2.0
    known_motion_weight: float = 0.5  # data weight of pixels of a region with known motion
    unknown_motion_weight: float = 0.02  # data weight of all other pixels
    # tracked_objects
    max_occlusion: int = 15  # frames for which an occluded object keeps its id
    min_histogram_overlap: float = 0.6  # overlap of two histograms of the same object, 0 to 1
    # distance of a reappeared object from its predicted position, divided by its size
    max_reappearance_distance: float = 1.5
    distance_growth: float = 0.1  # relative growth of this limit with each occluded frame
    min_object_frames: int = 4  # frames that show an object
    # Two touching objects are parts of one object if their motions differ by at most
    # `max_same_motion_difference`, a share of the faster motion, and if they touch in
    # `min_touching` of the frames with the smaller object. They are also parts of one object
    # if their motions differ by at most `max_similar_motion_difference`, and if they touch in
    # `min_similar_touching` of the frames with the smaller object and in
    # `min_common_touching` of the frames with both objects.
    max_same_motion_difference: float = 0.3
    min_touching: float = 0.7
    max_similar_motion_difference: float = 0.9
    min_similar_touching: float = 0.3
    min_common_touching: float = 0.6
    # Two objects that touch in `min_common_touching` of the frames with both are also parts of one
    # object if they stay together in at least `min_common_frames`: their relative motions add up to
    # at most `max_drift`, a share of the larger of their sizes, and their mean motions differ by at
    # most `max_same_motion_difference`. Set by hand, for the motorcycle of DAVIS.
    min_common_frames: int = 5
    max_drift: float = 0.35
    # Mean evidence of an object's pixels in frames in which it moves clearly. An object without a
    # tenth of its frames with `min_kept_evidence` has no label: cars in clips of DAVIS and boxes in
    # rendered films have 1.3 to 3. Pixels that share its motion join an object that has
    # `min_clear_evidence` in its first frames.
    min_clear_share: float = 0.1
    min_kept_evidence: float = 1.2
    min_clear_evidence: float = 2.0
    # label_propagation
    max_boundary_shift: int = 10  # px by which a refined boundary moves
    rim_width: int = 5  # px: side of the square that erodes a mask; its rim has unreliable motion
    min_core_pixels: int = 30  # pixels of an eroded mask; if it has fewer, the whole mask is used
    difference_offset: float = 2.0  # grey levels that are added to the median difference
    boundary_change_cost: float = 2.0  # cost of a changed label, in squared usual differences
    max_boundary_cost: float = 16.0  # largest cost of a label, in squared usual differences
    boundary_weight: float = 0.5  # data weight of pixels near a boundary
    propagation_cost: float = 6.0  # cost of a label other than the propagated label
    consistent_weight: float = 0.5  # data weight of pixels where forward and backward motion agree
    inconsistent_weight: float = 0.02  # data weight of all other pixels
    # object_path
    min_path_frames: int = 3  # frames that show an object with a path
    min_object_pixels: int = 400  # pixels of the object in each of these frames
    track_rim: int = 5  # px: side of the square that erodes a mask; its rim gets no tracks
    min_track_distance: int = 6  # px between two tracks
    box_margin: int = 24  # px: margin around an object in which depth is computed too
    # object_depth
    # share of the points, at each end of an axis, that the extent leaves out
    trimmed_share: float = 0.03
    # px: width of the ring around an object whose static depth may give the distance of the object
    ring_width: int = 15
    nearest_quantile: float = 0.9  # quantile of inverse depth that counts as the nearest
    box_trials: int = 2000  # random orientations that are tried for the smallest box
    max_box_points: int = 1000  # points that a box is fitted to

    @property
    def max_static_mean(self) -> float:
        """Largest mean evidence of a static depth."""
        return self.static_evidence / 2


@dataclass(frozen=True, kw_only=True)
class StandingSettings:
    """How far away an object stands whose motion shows no depth; set by hand.

    `short_weight` was chosen on a rendered film of two walkers, with found and with exact labels.
    """

    # The ground is sought in the surroundings of the feet: over `ground_reach` of the height of the
    # object below them and to both sides, and over `ground_above` above them.
    ground_reach: float = 0.5
    ground_above: float = 0.1
    min_ground_pixels: int = 30
    max_ground_pixels: int = 600  # pixels that are used; for speed
    trials: int = 100  # planes through three pixels that are compared
    min_determinant: float = 1.0  # px²: twice the area of a triangle of pixels
    ground_tolerance: float = 0.03  # relative distance of a pixel of the ground from its plane
    min_ground_share: float = 0.4  # share of the pixels that are near the plane
    min_slope: float = 0.05  # relative change of the ground's inverse depth over the height
    cut_distance: int = 2  # px from the border of the frame: a label that is nearer may be cut
    # Feet are hidden if less than `min_seen_share` of the pixels below them are in the plane of the
    # ground: `hidden_rows` from `hidden_distance` px below the lowest pixel of the object, in the
    # columns in which it has pixels in the lowest `foot_share` of its height.
    hidden_distance: int = 2
    hidden_rows: int = 3
    foot_share: float = 0.15
    hidden_tolerance: float = 0.1  # relative distance from the plane
    min_seen_share: float = 0.5
    min_contacts: int = 2  # frames with a contact
    # standard deviations of logarithms of inverse depth: of one contact; of the nearest
    # surroundings; of the known size of an object; of its height in the frame
    contact_std: float = 0.1
    around_std: float = 0.4
    size_std: float = 0.1
    height_std: float = 0.07
    # and of changes: from frame to frame, and of this change
    change_std: float = 0.3
    bend_std: float = 0.01
    # deviation of the lower end of a label that was found, and of one that the user gave, over the
    # height of the object
    end_std: float = 0.1
    exact_end_std: float = 0.02
    # weight of a contact that is farther away than the object, and of a height that is too small
    short_weight: float = 0.25
    thickness: float = 0.25  # deviation of depth within an object, over its narrower side
    iterations: int = 12  # of the robust fit
    min_precision: float = 1e-9  # prior of a logarithm, for unknowns without data: 1/variance
    max_variances: int = 200  # frames whose deviation is computed; that of others is between them


OBJECTS = ObjectSettings()
STANDING = StandingSettings()
