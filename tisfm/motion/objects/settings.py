"""Tuned numbers of ``motion="objects"``; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ObjectSettings:
    """Motions and depth of several objects."""

    # estimation
    # factor of depth smoothness: objects show less parallax than a static scene, so their depth
    # has more noise
    smoothness_factor: float = 4 / 3
    min_pixels: int = 2**16  # pixels of the level on which motions and their pixels are searched
    outside_window: int = 15  # px around a pixel outside frame 1, in which flow is unreliable
    # candidates
    candidate_pixels: int = 40_000  # pixels of the reduced flow; boundaries are refined later
    error_residuals: float = 3.0  # assumed error of a flow divided by the background's residual
    error_px: float = 0.02  # px: added to this error
    unexplained_errors: float = 3.0  # such errors: a pixel farther from a motion is unexplained
    min_object_share: float = 0.002  # share of the pixels that an object has
    min_explained_share: float = 0.3  # share of a candidate's pixels that its motion explains
    # median distance of a part from its own motion divided by its median distance from the common
    # motion: with a smaller ratio, the part gets its own motion
    max_split_ratio: float = 0.6
    max_rotation: float = 0.2  # rad/frame: rotation of an object relative to the background
    min_label_weight: float = 0.02  # data weight of a pixel while labels are assigned
    map_pixels: int = 40_000  # pixels of a depth map in which floating parts are searched
    map_median_window: int = 5  # px: side of the window of the median of this map
    gap_window: int = 3  # px: window across gaps below an object
    joining_window: int = 9  # px: side of the window that joins parts
    # standard deviations between inverse depth and its upper and lower limits
    depth_deviations: float = 2.0
    # inverse depth of a part divided by that around the part; hanging lamps and leaves have a
    # smaller ratio
    min_nearness_ratio: float = 1.3
    # inverse depth of the ground below a part divided by that around the part
    min_ground_ratio: float = 0.9
    ground_rows: int = 3  # rows at the lower border that count as ground
    # inverse depth around a part divided by the median inverse depth
    min_surrounding_depth: float = 0.05
    # label_optimisation
    message_rounds: int = 15  # rounds of belief propagation
    # layers; costs are in units, see `cost_unit`
    layer_window: int = 5  # px: window that averages residuals and erodes masks of layers
    # residual at which a pixel costs one unit, divided by the median residual
    cost_unit: float = 3.0
    max_layer_cost: float = 16.0  # units: largest cost of a pixel
    floating_margin: float = 0.02  # share of the longer side: margin around a floating part
    hidden_weight: float = 0.01  # weight of an occluded pixel
    visible_weight: float = 0.5  # weight of a visible pixel
    # share of a surface's pixels that may change without a new fit
    max_support_change: float = 0.03
    # units: gain of a new object for each pixel of the smallest object
    min_object_gain: float = 0.3
    # units: gain for each pixel of the layer; a wrong motion, spread over a background, gains less
    min_pixel_gain: float = 0.2
    # boundaries
    max_boundary_shift: int = 4  # px by which a boundary may move
    boundary_rounds: int = 2  # updates of the labels, each followed by an update of occlusions
    # The standard deviation of a visible pixel's grey level is the root of the sum of three
    # squares: of `min_noise`, of the residuals, and of the flow's error times the grey slope.
    min_noise: float = 3.0  # grey levels
    noise_residuals: float = 1.5  # factor of the median residual
    flow_error: float = 0.4  # px: error of the flow
    # costs, nats; a grey level that matches exactly costs 0
    max_grey_cost: float = 3.2  # largest cost of a grey level
    min_hidden_cost: float = 0.6  # cost of an occluded pixel in a uniform neighbourhood
    max_hidden_cost: float = 1.7  # cost of an occluded pixel in a varied neighbourhood
    boundary_cost: float = 4.0  # cost of each px of a boundary in uniform frames
    image_edges: float = 0.25  # κ: how much a contour of the image lowers `boundary_cost`
    variation_window: int = 5  # px: side of the window whose variance is the texture of frame 0
    order_window: int = 31  # px: side of the window in which two surfaces have one depth order
    global_order_pixels: float = 15.0  # pixels as which the mean of the image counts in a window
    brightness_window: int = 31  # px: side of the window with one change of brightness
    # depth
    # share of the longer side: median difference between a label's flow and its layer
    max_label_difference: float = 0.01
    # share of the longer side: difference between a pixel's flow and its layer
    max_pixel_difference: float = 0.05
    # share of the pixels that diverge: with more, the pair has diverged, and no pixel is restored
    max_diverged_share: float = 0.02
    # px: side of the window that erodes the background; at its rim, windows mix depths
    background_rim: int = 7
    contact_distance: int = 3  # px from the boundary at which depths are read, on both sides
    min_contact_columns: int = 8  # columns in which an object touches the floor
    # share of an object's rows: only its lower half touches the floor
    min_contact_height: float = 0.5

    @property
    def forbidden_layer_cost(self) -> float:
        """Cost of a layer at pixels that may not have its motion, units."""
        return 2 * self.max_layer_cost


OBJECTS = ObjectSettings()
