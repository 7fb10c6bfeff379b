"""Tuned numbers of depth; without another source, a number was set by hand.

Three numbers are for the efforts fast, balanced and accurate. A cell is a square of pixels with one
depth. D is the inverse depth, scaled to the unit px of an image or to the unit cell of a cell grid.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """Depth of frames with known poses."""

    # neighbour_frames
    parallax_grid: tuple[int, int] = (9, 12)  # rows and columns of image points
    full_parallax: float = 0.03  # image widths: more parallax does not improve a neighbour frame
    max_parallax: float = 0.12  # image widths: with more parallax, windows differ too much
    # mean gain of the grid points by one more frame; a point that becomes visible gains up to 1
    min_gain: float = 0.03
    # window_matching and neighbour_frames, of the part of a keyframe without matches. The three
    # numbers were chosen on 12 rendered drives, and on eight films of rooms, yards and streets.
    # share of the used cells with texture and without a match: fewer are not matched again
    min_unmatched_share: float = 0.1
    # ratio of a point's distances from both cameras: with a larger ratio, a frame counts less
    max_distance_ratio: float = 1.25
    # benefit of the new frames for this part, divided by the benefit of the first frames
    min_benefit_ratio: float = 1.2
    # window_planes
    window_smoothing: float = 0.6  # px: standard deviation of the Gaussian on images
    coarser_levels: int = 2  # levels that are searched before the level of the cells
    # rounds on the coarsest level, on the next level, and on each finer level
    search_rounds: tuple[int, ...] = (3, 2, 1)
    max_cell_side: int = 2  # px of the finest level: larger cells have an additional search
    min_coarse_side: int = 8  # px: shorter side of the coarsest level
    random_draws: int = 2  # planes near a cell's own plane in each round
    # px of D: spread of drawn planes, on the coarsest grid and on finer grids
    draw_spread: tuple[float, float] = (4.0, 1.0)
    draw_tilt: float = 0.05  # px per px: spread of the slopes of drawn planes
    draw_shrinkage: float = 0.6  # factor of both spreads from round to round
    max_cost: float = 0.25  # matching cost of a reliable match
    # px: smallest region of reliable matches; neighbours differ by at most 1 px in D
    min_region_area: int = 200
    # match_deviation
    # cells: side of the square that gives a cell's certainty; matched windows have 11
    certainty_window: int = 5
    # Cells: standard deviation of D at which a match has half the weight. Chosen on rendered
    # scenes: such matches have an error of 0.3 cells, and a tenth of them an error of 1 cell. More
    # certain matches have an error of 0.1 cells, and a fiftieth of them an error of 1 cell.
    half_weight_match_deviation: float = 0.5
    # fattened_matches: distances in px of the level of the windows, which have 11 px, and
    # differences as shares of the inverse depth of a match. Chosen on every second keyframe of
    # TartanAir.
    contour_distance: int = 10  # of the contour behind a fattened match
    surface_distance: int = 24  # at which the depth of both surfaces is taken
    contour_contrast: float = 2.0  # contrast of the contour over that of the edges ahead
    contour_noise: float = 3.0  # standard deviations of the noise that this difference exceeds
    min_surface_step: float = 0.07  # from the match to the farther surface
    max_contour_difference: float = 0.04  # from the match to the nearer surface
    # cells of the grid on which depth is propagated from all matches. On TartanAir, 4800 cells give
    # keyframes the same errors as all cells.
    max_surface_cells: int = 2**13
    # window_depth
    # largest number of cells of a keyframe; frames of 4:3 get 160×120, 320×240 and 640×480
    max_cells: tuple[int, int, int] = (2**15, 2**17, 2**19)
    # share of the cells: with fewer reliable matches, there is no depth
    min_matched_share: float = 0.01
    # full weight of the data term of a frame, divided by the weight of a matched cell
    data_weight: float = 8.0
    # smallest share of a match's weight, where the data term has its full weight; the match loses
    # weight there, since both use the same images
    min_match_share: float = 0.1
    # px per px: difference of slopes that smoothness tolerates at a crease. It is smaller than for
    # pairs, since matches are more certain. A larger number smooths a floor into the walls.
    slope_scale: float = 0.0009
    image_edges: float = 10.0  # weight of image edges in the smoothness
    # grey variance divided by the variance of the noise, where the data term has half the weight
    data_texture: float = 1000.0
    # half-quadratic iterations that propagate matches. With fewer, depth is smooth across outlines;
    # more of them sharpen little. Chosen on every second keyframe of TartanAir and HoloLens.
    propagation_iterations: tuple[int, int, int] = (4, 8, 8)
    warps: int = 3
    iterations: int = 1  # iterations of each warp
    max_depth_factor: float = 2.0  # largest propagated depth divided by the largest matched depth
    # share of the matched cells, with the largest depth, that this limit ignores
    ignored_far_share: float = 0.01
    # The deviation of D, cells, is the root of the sum of the squares of four parts. Their numbers
    # minimise the pinball loss of the logarithm of the error at 68 %, rounded, on half of 35 sets
    # of keyframes: films of bench.trust, and TartanAir.
    min_deviation: float = 0.01  # cells: smallest part of the deviation
    residual_share: float = 0.03  # part from images: share of the residuals of nearby data terms
    max_residual: float = 2.5  # cells: limit of these residuals
    # Part from propagation: share of D, per bend in the same unit. Bare walls of rooms mostly bend
    # by less than 0.001 of D, and are off by 2 %; half of a hall without texture behind a few boxes
    # bends by 0.01 to 0.1, and is off by 15 to 40 %.
    deviation_per_bend: float = 60.0
    usual_bend: float = 0.003  # smaller bends count little
    max_bend_share: float = 1.0
    # Deviation of every cell of a keyframe that bends everywhere, share of D; it decreases with the
    # cube of the share of cells that bend more than usual. In halls with a few boxes, this share is
    # 0.5 to 0.8, and even matches are off by 15 to 34 %. Elsewhere it is 0 to 0.2, rarely 0.45.
    deviation_of_bent_frame: float = 0.6
    bend_smoothing: float = 2.0  # cells: standard deviation of the Gaussian before derivatives
    # cells: side of the window that takes the least bend: a jump counts in half as wide a strip
    bend_window: int = 9
    # part from matches: share of the difference between nearby matches and D
    difference_share: float = 1.3
    match_scatter: float = 0.2  # cells: usual noise of matches; smaller differences count little
    # cells: sides of the window that averages residuals and differences
    averaging_window: tuple[int, int] = (15, 15)
    # segment_depth
    min_keyframe_motion: float = 0.1  # longer sides: motion of tracks between keyframes
    # share of a keyframe's tracks in a frame: with fewer tracks, there is a new keyframe
    min_common_tracks: float = 0.25
    comparison_stride: int = 2  # px between the pixels on which keyframes are compared
    # px between rendered pixels, in frames between keyframes
    render_stride: tuple[int, int, int] = (2, 1, 1)
    # frames of a keyframe window: without this limit, a camera at rest would add frames forever
    max_window_frames: int = 24
    max_frame_distance: int = 40  # frames between a keyframe and its neighbour frames
    max_neighbours: tuple[int, int, int] = (3, 4, 6)  # neighbour frames of a keyframe
    # Standard deviation of depth divided by its difference from neighbour keyframes. 1.2 fits the
    # errors best; 1.75 shows wrong paths, whose keyframes differ, with a margin.
    deviation_per_difference: float = 1.75
    # view_fusion: differences and steps are shares of the inverse depth
    max_difference: float = 0.1  # difference of two rendered surfaces that are one surface
    # grey levels by which a keyframe differs from the frame, that reduce its vote to 1/e; chosen on
    # half of the frames of TartanAir and HoloLens
    vote_grey_scale: float = 40.0
    # longer sides: border of a keyframe in which its weight in the mean of keyframes decreases
    view_border: float = 0.01
    max_smooth_step: float = 0.05  # step between neighbour pixels on one surface
    difference_window: float = 0.05  # longer sides: window in which differences are averaged
    difference_limit: float = 0.5  # limit of the difference at a single pixel
    # weight of the median of all differences, divided by the weight of a full window
    median_weight: float = 0.02
    # standard deviation in a filled hole, as a share of the inverse depth
    filled_deviation: float = 0.5
    max_fill_cells: int = 2**13  # cells of the grid on which holes are filled
    fill_median: float = 20.0  # cell sides: median inverse depth on this grid
    # step between neighbour pixels on two surfaces, for the alignment of edges
    min_edge_step: float = 0.1
    grey_scale: float = 10.0  # grey levels that reduce a vote for a surface to 1/e
    # pose_adjustment
    max_adjustment_pixels: int = 2**17  # pixels of the pyramid level on which images are compared
    adjustment_smoothing: float = 0.6  # px: standard deviation of the Gaussian on images
    # grey variance divided by the variance of the noise, at which a pixel has half the weight
    adjustment_texture: float = 50.0
    texture_window: int = 11  # px: side of the window of this variance
    # residual with a quarter of the weight, divided by the root of the median square
    outlier_scale: float = 3.0
    # relative standard deviation of depth at which a pixel has half the weight
    half_weight_deviation: float = 0.05
    depth_damping: float = 1e-3  # damping of a depth step, as a share of a pixel's mean data term
    pose_damping: float = 1e-3  # damping of a pose step, as a share of the diagonal of the system
    depth_window: int = 9  # px: side of the window that averages the steps of depth
    # largest step of a pixel's inverse depth, as a share of this inverse depth
    max_depth_step: float = 0.1
    adjustment_rounds: int = 2  # Gauss–Newton steps
    max_adjustment_frames: int = 200  # frames in one system of equations
    # plane_homographies
    homography_smoothing: float = 0.8  # px: standard deviation of the Gaussian on images
    homography_samples: int = 2**14  # approximate number of pixels that are compared
    homography_border: int = 4  # px: pixels near the border of a frame are not compared
    homography_steps: int = 2  # Gauss–Newton steps with fewer samples, before one with all
    homography_sample_factor: int = 8  # samples of the last step over samples of these steps
    # px: median change of a homography by these steps; a larger change is a wrong match
    max_homography_change: float = 2.0
    min_overlap: float = 0.3  # share of the pixels of a frame that the other frame shows
    min_homography_samples: int = 100  # pixels that are compared: fewer give no homography
    min_grey_deviation: float = 0.1  # grey levels: smallest assumed deviation of noise
    # smallest eigenvalue of the equations of a homography, divided by the largest: with less, the
    # frames have too little texture
    min_homography_strength: float = 1e-9
    # plane_alignment
    # distances, in frames, between two frames that are compared
    plane_gaps: tuple[int, ...] = (1, 2, 4, 8)
    plane_rounds: int = 10  # Gauss–Newton steps of all poses
    min_plane_step: float = 1e-7  # rad, and share of the plane's distance: a smaller step ends them
    plane_damping: float = 1e-9  # damping, as a share of the diagonal of the system
    # largest distance, in frames, between two frames whose tracks are compared with a plane
    relief_gap: int = 8
    # Tracks that two such frames share: the least number, and as a share of the tracks that
    # neighbours share. With fewer, nearer frames are compared.
    min_relief_tracks: int = 20
    min_relief_track_share: float = 0.3
    min_relief_frames: float = 0.9  # share of the frames whose tracks are compared
    # px: smallest assumed deviation of tracks across epipolar lines
    min_track_deviation: float = 0.05
    # deviations: tracks farther than this from their position on the plane count
    relief_deviations: float = 6.0
    # Share of tracks that are farther along epipolar lines, less the share that are farther across:
    # a larger excess is relief. Rendered planes had at most 0.01, boxes of 2 to 10 % of the
    # distance on a plane 0.11 to 0.15.
    max_relief_share: float = 0.03
    # median distance of tracks from their position on the plane, with aligned poses over that
    # before: a larger ratio shows that the images do not fit the plane
    max_track_growth: float = 1.2


DEPTH = DepthSettings()


@dataclass(frozen=True, kw_only=True)
class OutlineSettings:
    """Depth of keyframes beside outlines; costs are shares of the bits of a transform.

    Costs and ranges were compared on 14 keyframes of TartanAir, in two halves, and the steps also
    on six rendered keyframes with less parallax; the rest was set by hand.
    """

    # Distance of a jump of depth, in cells: a matched window reaches 5 cells. Farther jumps, up to
    # the limit in px, improved TartanAir no further.
    jump_cells: int = 5
    max_jump_distance: int = 16
    # range of the inverse depth within this distance, share of the inverse depth
    min_jump: float = 0.15
    max_pixels: int = 2**20  # pixels that are searched: a larger frame is halved
    # lowest and highest inverse depth of a block, over the lowest and highest before the search
    range_factors: tuple[float, float] = (0.6, 1.4)
    # least step between hypotheses: px of the frame with the longest baseline, if it moves sideways
    step: float = 0.25
    max_hypotheses: int = 96  # hypotheses of a block
    block_side: int = 96  # px: side of the blocks that are searched one by one
    block_margin: int = 8  # px around a block: paths begin there
    # cost of another depth than before, and the distance at which it is reached, share of the range
    # of a block
    guess_cost: float = 0.1
    guess_range: float = 0.25
    # the same cost away from jumps, where depth stays as it is, and its distance in steps
    fixed_cost: float = 0.5
    fixed_steps: float = 2.0
    # semi-global aggregation: cost of a change by one step, and of a jump
    step_cost: float = 0.2
    jump_cost: float = 1.2
    edge: float = 10.0  # difference of grey levels at which a jump has half its cost
    # Least change of the inverse depth by the search, as a share: on the same surface, the depth
    # before is more exact.
    min_change: float = 0.05
    median_window: int = 5  # px: side of the median that removes single wrong pixels
    # weighted median that moves outlines to edges of the image: half the side of its window, px
    # of the searched frame, and the difference of grey levels at which a neighbour has half its
    # weight
    sharpening_radius: int = 3
    sharpening_scale: float = 5.0
    # share of the weight in the window: a pixel with more of it on its own surface stays there, so
    # that thin things stay
    max_own_weight: float = 0.4
    # least change of the inverse depth by this median, as a share: it moves pixels from surface to
    # surface
    min_surface_step: float = 0.02
    # Part of the deviation, over the change by the search. On the same keyframes under `fast`, 76 %
    # of the changed pixels are right within one deviation, and 92 % within two. A larger number
    # takes weight from the changed pixels where keyframes are joined.
    deviation_per_change: float = 0.3


OUTLINES = OutlineSettings()
"""Settings of the search beside outlines."""
