"""Tuned numbers of depth; without another source, a number was set by hand.

Three numbers are for the efforts fast, balanced and accurate.
A cell is a square of pixels with one depth. D is inverse depth, in cells or px of its grid.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """Depth of frames with known poses."""

    # neighbour_frames
    parallax_grid: tuple[int, int] = (9, 12)  # rows and columns of image points
    full_parallax: float = 0.03  # image widths: more parallax makes a neighbour frame no better
    max_parallax: float = 0.12  # image widths: with more parallax, windows look less and less alike
    # mean gain over grid points by a further frame; a new point adds up to 1
    min_gain: float = 0.03
    # window_planes
    window_smoothing: float = 0.6  # px: standard deviation of the Gaussian on images
    coarser_levels: int = 2  # levels that are searched before the level of the cells
    # rounds on the coarsest level, the next, and finer ones
    search_rounds: tuple[int, ...] = (3, 2, 1)
    max_cell_side: int = 2  # px of the finest level: larger ones have their own search first
    min_coarse_side: int = 8  # px: shorter side of the coarsest level
    random_draws: int = 2  # planes near a cell's own plane in each round
    # px of D: spread of drawn planes on the coarsest grid and on finer ones
    draw_spread: tuple[float, float] = (4.0, 1.0)
    draw_tilt: float = 0.05  # px per px: spread of the slopes of drawn planes
    draw_shrinkage: float = 0.6  # factor of both spreads from round to round
    max_cost: float = 0.25  # matching cost of a reliable match
    min_region: int = 200  # px of reliable matches, whose neighbours differ by at most 1 px in D
    # match_deviation
    inner_side: int = 5  # cells: square that gives a cell's certainty; matched windows have 11
    # Cells: standard deviation of D at which a match has half the weight. Chosen on rendered
    # scenes: such matches are off by 0.3 cells, a tenth of them by 1 cell; more certain matches by
    # 0.1 cells, a fiftieth of them by 1 cell.
    half_weight_cells: float = 0.5
    # window_depth
    # largest number of cells of a keyframe; frames of 4:3 get 160×120, 320×240 and 640×480
    cells: tuple[int, int, int] = (2**15, 2**17, 2**19)
    min_matched_share: float = (
        0.01  # share of the cells: with fewer reliable matches, there is no depth
    )
    # full weight of the data of a frame, over the weight of a matched cell
    data_weight: float = 8.0
    # share of a match's weight that stays under full data, as both use the same images
    match_share_left: float = 0.1
    # px per px: difference of slopes at which smoothness yields; less than for pairs, since matches
    # are more certain: otherwise the slope of a floor is smoothed into that of the walls
    slope_scale: float = 0.0009
    image_edges: float = 10.0  # weight of image edges in the smoothness
    data_texture: float = 1000.0  # grey variance, in noise variances, for half the weight of data
    warps: int = 3
    iterations: int = 1  # iterations of each warp
    max_depth_factor: float = 2.0  # largest propagated depth over the largest matched depth
    # share of the matched cells, the farthest ones, that this limit ignores
    far_share: float = 0.01
    # The deviation of D, cells, is the root of the sum of the squares of four parts. With them, the
    # error is within one standard deviation at 60 to 76 % of the pixels of rendered rooms, at 57 %
    # of TartanAir, and at 28 % of a HoloLens recording, whose poses are inexact.
    min_deviation: float = 0.005  # cells: smallest part of the deviation
    residual_share: float = 0.07  # part by images: this share of the residuals of nearby data terms
    max_residual: float = 2.5  # cells: limit of such a residual
    deviation_per_pixel: float = 0.002  # part by propagation: cells for every px of propagation
    # part by matches: this share of the difference between nearby matches and D
    difference_share: float = 0.8
    scatter: float = 0.2  # cells: usual scatter of matches; differences near it count less
    # cells: sides of the window that averages residuals and differences
    averaging_window: tuple[int, int] = (15, 15)
    # segment_depth
    min_keyframe_motion: float = 0.1  # longer sides: motion of tracks between keyframes
    min_kept_tracks: float = 0.25  # share of a keyframe's tracks: with fewer, a new keyframe begins
    compare_stride: int = 2  # px between the pixels on which keyframes are compared
    # px between rendered pixels, in frames between keyframes
    render_stride: tuple[int, int, int] = (2, 1, 1)
    max_window_frames: int = 24  # frames of a keyframe window: a camera at rest would never end it
    max_frame_distance: int = 40  # frames between a keyframe and a frame that it is compared with
    max_neighbours: tuple[int, int, int] = (3, 4, 6)  # neighbour frames that give depth
    # standard deviation over the difference from neighbour keyframes
    difference_to_deviation: float = 1.75
    # view_fusion; differences are shares of the inverse depth
    max_difference: float = 0.1  # difference of two rendered surfaces that are one surface
    max_smooth_step: float = 0.05  # step between neighbour pixels on one surface
    difference_window: float = 0.05  # longer sides: window in which differences are averaged
    difference_limit: float = 0.5  # limit of the difference of a single pixel
    # weight of the median of all differences, over that of a full window
    median_weight: float = 0.02
    filled_deviation: float = 0.5  # standard deviation of a filled hole
    max_fill_cells: int = 2**13  # cells of the grid on which holes are filled
    fill_median: float = 20.0  # cell sides: median inverse depth on this grid
    # step between neighbour pixels on two surfaces, for the alignment of edges
    min_jump: float = 0.1
    grey_scale: float = 10.0  # grey levels that reduce a vote for a surface to 1/e
    # pose_adjustment
    max_adjust_pixels: int = 2**17  # pixels of the pyramid level on which images are compared
    adjust_smoothing: float = 0.6  # px: standard deviation of the Gaussian on images
    # grey variance over the variance of the noise, at which a pixel has half the weight
    adjust_texture: float = 50.0
    texture_window: int = 11  # px: side of the window of this variance
    outlier_scale: float = 3.0  # residual over the root-median-square, with a quarter of the weight
    # relative standard deviation of depth at which a pixel has half the weight
    half_weight_deviation: float = 0.05
    depth_damping: float = 1e-3  # damping of a depth step, as a share of a pixel's mean data term
    pose_damping: float = 1e-3  # damping of a pose step, as a share of the diagonal of the system
    depth_window: int = 9  # px: side of the window whose depth moves together
    max_depth_step: float = 0.1  # largest step of the inverse depth of a pixel, as a share of it
    adjust_rounds: int = 2  # Gauss–Newton steps
    max_adjust_frames: int = 200  # frames that are adjusted at a time


DEPTH = DepthSettings()
