"""Tuned numbers of moving objects; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ObjectSettings:
    """Labels, paths and depth of moving objects."""

    # motion_evidence
    pair_steps: tuple[int, ...] = (1, 3)  # frames before and after that a frame is compared with
    flow_deviation: float = 1.5e-4  # of the image motion, in longer sides; added to that of the fit
    neutral_deviations: float = 3.0  # standard deviations from the camera's motion: evidence 0
    static_evidence: float = -1.0  # of one frame, for a clearly static pixel
    moving_evidence: float = 3.0  # of one frame, at most, for a moving pixel
    static_prior: float = 0.3  # frames: weight of the prior that a pixel is static
    passed_evidence: float = 0.8  # share of a frame's evidence that is passed on to the next frame
    compare_window: int = 5  # px: side of the window in which images are compared
    refuting_difference: float = 4.0  # grey levels of additional difference, for a refuted position
    min_support: float = 0.05  # weight, of 1, of evidence without support from grey levels
    max_depth_factor: float = 3.0  # largest inverse depth that is tried, in usual ones
    static_step: float = 2.0  # px between two static positions that are tried
    static_counts: tuple[int, int] = (8, 32)  # smallest and largest number of static positions
    min_depth_ratio: float = 0.05  # depth of a point in another frame over its depth in this frame
    # path_evidence
    path_steps: tuple[int, ...] = (1, 2, 3, 5, 8)  # frames that one depth has to explain
    depth_rounds: int = 3  # reweighted rounds of the robust fit of depth
    outlier_error: float = 3.0  # px per root of the frame distance: an error with half the weight
    max_path_error: float = 1.5e-3  # longer sides: usual error of a path that fits static points
    # sequence_labels
    min_static_frames: float = 0.3  # frames with evidence that a static depth needs
    min_ground_share: float = 0.03  # of the frame that shows the ground
    max_sideways_slope: float = 0.15  # of an upright camera's ground, in slopes downwards
    max_central_depth: float = 0.4  # inverse depth of the ground at the centre, in slopes downwards
    ground_tolerance: float = 0.07  # share of the inverse depth that a pixel may be off the ground
    ground_trials: int = 300  # of the robust fit
    ground_sample: int = 4000  # pixels on which the trials are compared
    ground_rounds: int = 3  # least-squares rounds after the trials
    max_height_change: float = 0.3  # relative, of the camera above the ground: a vehicle keeps it
    height_frames: int = 10  # frames before and after with which this height is compared
    min_ground_frames: float = 0.5  # share of these frames that need a ground plane
    min_below_ground: float = 1.3  # depth of a pixel below the ground over the depth of the ground
    min_judged_depth: float = 0.2  # of the ground's largest inverse depth: farther ones are skipped
    hidden_steps: tuple[int, ...] = (3, 5, 8)  # frames whose static points may be hidden
    min_hidden_difference: float = 12.0  # grey levels, mean, at the position of a hidden point
    min_hidden_points: float = 1.0  # that an object hides, per square root of its area in px
    # moving_regions; evidence is -1 (static) to 3 (moving)
    region_evidence: float = -0.3  # mean evidence at the boundary of a moving region
    core_evidence: float = 0.3  # mean evidence of the core of a region, which a new object needs
    min_core_frames: float = 1.5  # frames with evidence that a pixel of the core needs
    min_core_of_smallest: float = 0.25  # pixels of the core, as a share of the smallest object
    min_core_share: float = 0.15  # pixels of the core, as a share of the region
    known_object_bonus: float = 0.4  # mean evidence that is added where a known object is expected
    full_weight_frames: float = 4.0  # frames with evidence that give a pixel its full data weight
    max_data_weight: float = 0.5  # this full weight, against the smoothness of labels
    min_data_share: float = 0.02  # share of the full weight without any evidence
    min_motion_pixels: int = 30  # for the fit of a smooth motion
    min_quadratic_pixels: int = 400  # for the fit of a quadratic motion
    start_tolerance: float = 1.0  # px from the expected velocity with a large weight at first
    min_motion_deviation: float = 0.2  # px: standard deviation from a smooth motion
    # identities
    min_propagated: float = 0.1  # share of a region with a propagated label, to show this object
    min_reappeared: float = 0.2  # share of an occluded object that reappears, to be recognised
    histogram_bins: int = 16  # of grey levels
    reach: float = 0.1  # of an object beyond its predicted mask, in sizes of the object
    min_quadratic_visible: float = 0.5  # visible share of an object, for a quadratic motion
    min_affine_visible: float = 0.15  # for an affine motion; with less, one velocity is fitted
    max_motion_deviations: float = 4.0  # standard deviations of an object's pixel from its motion
    max_own_error: float = 0.5  # of other pixels that move alike, in errors of known motions
    max_motion_error: float = 1e3  # px: limit of the errors of a motion
    error_tolerance: float = 0.5  # between motions where none fits, in smallest errors of the pixel
    max_motion_cost: float = 16.0  # of a motion, in squared ratios of its error to the usual error
    identity_change_cost: float = 2.0  # of a label that differs from the propagated one, the same
    known_motion_weight: float = 0.5  # data weight, of 1, of pixels of a region with known motion
    unknown_motion_weight: float = 0.02  # data weight of all other pixels
    # tracked_objects
    max_occlusion: int = 15  # frames for which an occluded object keeps its id
    min_histogram_overlap: float = 0.6  # of two histograms of the same object, 0 to 1
    max_distance: float = 1.5  # from the predicted position after occlusion, in sizes of the object
    distance_growth: float = 0.1  # of this distance with each occluded frame, relative
    min_frames: int = 4  # in which an object has to be seen
    max_same_motion: float = 0.3  # difference of motions of two parts, in the faster motion
    min_touching: float = 0.7  # share of the smaller part's frames in which these parts touch
    max_similar_motion: float = 0.9  # for parts that touch more seldom, in these shares:
    min_touching_similar: float = 0.3  # of the smaller part's frames
    min_touching_common: float = 0.6  # of the frames with both parts
    # label_propagation
    max_boundary_shift: int = 10  # px
    rim_width: int = 5  # px: rim of an object, where its motion is unreliable
    min_core_pixels: int = 30  # inside this rim; with fewer, the whole object is used
    difference_offset: float = 2.0  # grey levels that are added to the median difference
    boundary_change_cost: float = 2.0  # of a changed label, in squared ratios of differences
    max_boundary_cost: float = 16.0  # of a label, in the same unit
    boundary_weight: float = 0.5  # data weight, of 1, of pixels near a boundary
    propagation_cost: float = 6.0  # of a label that differs from the propagated one
    consistent_weight: float = 0.5  # data weight of pixels where forward and backward motion agree
    inconsistent_weight: float = 0.02  # data weight of all other pixels
    # object_path
    min_path_frames: int = 3  # in which an object has to be seen
    min_object_pixels: int = 400  # in each of these frames
    track_rim: int = 5  # px: rim of an object without tracks
    min_track_distance: int = 6  # px
    box_margin: int = 24  # px: margin around an object in which depth is found too
    # object_depth
    trimmed_points: float = 0.03  # share at both ends of an axis that an extent leaves out
    surroundings: int = 15  # px: width of the ring whose depth may give the distance of the object
    box_trials: int = 2000  # random orientations that are tried for the smallest box
    max_box_points: int = 1000  # that boxes are fitted to

    @property
    def max_static_mean(self) -> float:
        """Largest mean evidence of a static depth."""
        return self.static_evidence / 2


OBJECTS = ObjectSettings()
