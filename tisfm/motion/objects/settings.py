"""Tuned numbers of ``motion="objects"``; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ObjectSettings:
    """Motions and depth of several objects."""

    # estimation
    # factor of depth smoothness: objects show less parallax than a static scene, so their depth
    # has more noise
    smoothness_factor: float = 4 / 3
    min_pixels: int = 2**16  # of the level on which motions and their pixels are searched
    outside_window: int = 15  # px around a pixel outside frame 1, in which flow is unreliable
    # candidates
    candidate_pixels: int = 40_000  # of the reduced flow; boundaries are refined later
    error_residuals: float = 3.0  # residuals of the background that a flow may be off
    error_px: float = 0.02  # px that are added
    unexplained_errors: float = 3.0  # such errors: root of the cost of an unexplained pixel
    min_object_share: float = 0.002  # of the pixels
    min_explained_share: float = 0.3  # of a candidate's pixels that its motion explains
    # median distance of a part under its own motion over that under the common motion, for a part
    # that gets its own motion
    max_split_ratio: float = 0.6
    max_rotation: float = 0.2  # rad/frame, relative to the background
    min_label_weight: float = 0.02  # of a pixel while labels are assigned
    map_pixels: int = 40_000  # of a depth map in which floating parts are searched
    map_median_window: int = 5  # px
    gap_window: int = 3  # px: across gaps below an object
    joining_window: int = 9  # px: that joins parts
    depth_deviations: float = 2.0  # between inverse depth and its upper and lower limits
    # inverse depth of a part relative to that around it; hanging lamps and leaves have less
    min_nearness_ratio: float = 1.3
    min_ground_ratio: float = 0.9  # inverse depth at the border below a part over that around it
    ground_rows: int = 3  # at the lower border, that are taken for the ground
    min_surrounding_depth: float = 0.05  # of the median inverse depth
    # label_optimisation
    message_rounds: int = 15  # of belief propagation
    # layers; a unit is the unit of cost
    layer_window: int = 5  # px: window that averages residuals and erodes masks of layers
    cost_unit: float = 3.0  # median residuals in a unit
    max_layer_cost: float = 16.0  # units: largest cost of a pixel
    floating_margin: float = 0.02  # of the longer side, around a floating part
    hidden_weight: float = 0.01  # of an occluded pixel
    visible_weight: float = 0.5  # of a visible pixel
    max_support_change: float = 0.03  # of a surface's pixels, without a new fit
    min_object_gain: float = 0.3  # units for each pixel of the smallest object
    # units for each pixel of the layer: a motion spread over a background gains less
    min_pixel_gain: float = 0.2
    # boundaries
    boundary_reach: int = 4  # px that a boundary may move
    boundary_rounds: int = 2  # updates of the labels, each followed by one of the occlusions
    # The standard deviation of a visible pixel's grey level is the root of the sum of three
    # squares: of `min_noise`, of the residuals, and of the flow's error times the grey slope.
    min_noise: float = 3.0  # grey levels
    noise_residuals: float = 1.5  # median residuals
    flow_error: float = 0.4  # px
    # costs, nats; a grey level that matches exactly costs 0
    max_grey_cost: float = 3.2  # of a grey level
    min_hidden_cost: float = 0.6  # of an occluded pixel in a uniform neighbourhood
    max_hidden_cost: float = 1.7  # of an occluded pixel in a varied neighbourhood
    boundary_cost: float = 4.0  # per px of a boundary in uniform frames
    image_edges: float = 0.25  # κ, by which an edge of the image lowers that cost
    variation_window: int = 5  # px: its variance says how varied frame 0 is
    order_window: int = 31  # px: in which two surfaces have one depth order
    global_order_pixels: float = 15.0  # weight of the order in the whole image in each window
    brightness_window: int = 31  # px: with one change of brightness
    # depth
    max_label_difference: float = 0.01  # of the longer side: median of a label's flow to its layer
    max_pixel_difference: float = 0.05  # of the longer side: of a pixel's flow
    # of the pixels: if more diverge, the whole pair has diverged, and pixels stay
    max_diverged_share: float = 0.02
    background_rim: int = 7  # px: window that erodes the background; there, windows mix depths
    contact_distance: int = 3  # px from the boundary at which depths are read, on both sides
    min_contact_columns: int = 8
    min_contact_height: float = 0.5  # of an object's rows: only the lower half touches the floor

    @property
    def forbidden_layer_cost(self) -> float:
        """Cost of a layer at pixels that may not have its motion, units."""
        return 2 * self.max_layer_cost


OBJECTS = ObjectSettings()
