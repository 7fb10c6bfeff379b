"""Tuned numbers of depth; without another source, a number was set by hand.

Three numbers are those of the efforts fast, balanced and accurate.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """Depth of frames with known poses."""

    # neighbour_frames
    parallax_grid: tuple[int, int] = (9, 12)  # rows and columns of image points
    full_parallax: float = 0.03  # image widths: beyond it, a frame gets no better
    max_parallax: float = 0.12  # image widths: beyond it, windows look less and less alike
    min_gain: float = 0.03  # mean over grid points of a further frame; a new point adds up to 1
    # window_planes
    window_smoothing: float = 0.6  # px: standard deviation of the Gaussian on images
    coarser_levels: int = 2  # that are searched before the level of the cells
    search_rounds: tuple[int, ...] = (3, 2, 1)  # on the coarsest level, the next, and finer ones
    max_cell_side: int = 2  # px of the finest level: larger ones have their own search first
    min_coarse_side: int = 8  # px: shorter side of the coarsest level
    random_draws: int = 2  # planes near a cell's own plane in each round
    draw_spread: tuple[float, float] = (4.0, 1.0)  # px of D, on the coarsest grid and on finer ones
    draw_tilt: float = 0.05  # px per px: spread of their slopes
    draw_shrinkage: float = 0.6  # factor of both spreads from round to round
    max_cost: float = 0.25  # of a reliable match
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
    min_matched_share: float = 0.01  # of the cells: with fewer reliable matches, there is no depth
    data_weight: float = 8.0  # of a full data term of a frame, in weights of a matched cell
    match_share_left: float = 0.1  # of a match's weight under a full data term: the same images
    # px per px: difference of slopes at which smoothness yields; less than for pairs, since matches
    # are more certain: otherwise the slope of a floor is smoothed into that of the walls
    slope_scale: float = 0.0009
    image_edges: float = 10.0  # weight of image edges in the smoothness
    data_texture: float = 1000.0  # grey variance, in noise variances, for half the weight of data
    warps: int = 3
    iterations: int = 1  # of each warp
    max_depth_factor: float = 2.0  # largest propagated depth over the largest matched depth
    far_share: float = 0.01  # of the matched cells, the farthest ones, that this limit ignores
    # The deviation of D, cells, is the root of the sum of the squares of four parts. With them, the
    # error is within one standard deviation at 60 to 76 % of the pixels of rendered rooms, at 57 %
    # of TartanAir, and at 28 % of a HoloLens recording, whose poses are inexact.
    min_deviation: float = 0.005  # cells
    residual_share: float = 0.07  # of the residuals of nearby data terms
    max_residual: float = 2.5  # cells: limit of such a residual
    deviation_per_pixel: float = 0.002  # of D for every px of propagation
    difference_share: float = 0.8  # of the difference between nearby matches and D
    scatter: float = 0.2  # cells: a difference near it counts less, as matches scatter
    averaging_window: tuple[int, int] = (15, 15)  # cells
    # segment_depth
    min_keyframe_motion: float = 0.1  # longer sides that tracks move between keyframes
    min_kept_tracks: float = 0.25  # of a keyframe's tracks; with fewer, a new keyframe begins
    compare_stride: int = 2  # px between the pixels on which keyframes are compared
    render_stride: tuple[int, int, int] = (2, 1, 1)  # px, in frames between keyframes
    max_window_frames: int = 24  # of a keyframe window: a resting camera would have no end
    max_frame_distance: int = 40  # frames between a keyframe and a frame that it is compared with
    max_neighbours: tuple[int, int, int] = (3, 4, 6)  # frames that give depth
    difference_to_deviation: float = 1.75  # deviation per difference from neighbour keyframes
    # view_fusion; differences are shares of the inverse depth
    max_difference: float = 0.1  # of two rendered surfaces that are one surface
    max_smooth_step: float = 0.05  # of neighbours on one surface
    difference_window: float = 0.05  # longer sides: window in which differences are averaged
    difference_limit: float = 0.5  # of a single pixel
    median_weight: float = 0.02  # of the median of all differences, relative to a full window
    filled_deviation: float = 0.5  # of a filled hole, relative
    max_fill_cells: int = 2**13  # of the grid on which holes are filled
    fill_median: float = 20.0  # cell sides: median of the inverse depth on this grid
    min_jump: float = 0.1  # of neighbours on two surfaces, for the alignment of edges
    grey_scale: float = 10.0  # grey levels that reduce a vote for a surface to 1/e
    # pose_adjustment
    max_adjust_pixels: int = 2**17  # of the pyramid level on which images are compared
    adjust_smoothing: float = 0.6  # px: standard deviation of the Gaussian on images
    adjust_texture: float = 50.0  # grey variance, in noise variances, for a pixel's half weight
    texture_window: int = 11  # px: side of the window of this variance
    outlier_scale: float = 3.0  # root-median-squares: a residual with a quarter of the weight
    half_weight_deviation: float = 0.05  # of depth, relative: such a pixel has half the weight
    depth_damping: float = 1e-3  # of a depth step, as a share of a pixel's mean data term
    pose_damping: float = 1e-3  # of a pose step, as a share of the diagonal of the system
    depth_window: int = 9  # px: side of the window whose depth moves together
    max_depth_step: float = 0.1  # as a share of the inverse depth of the pixel
    adjust_rounds: int = 2  # Gauss–Newton steps
    max_adjust_frames: int = 200  # that are adjusted at a time


DEPTH = DepthSettings()
