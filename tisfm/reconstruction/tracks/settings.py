"""Tuned numbers of tracks and views; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TrackSettings:
    """Tracks, views, their matches, and triangulation."""

    # retrieval
    codebook_size: int = 32  # words of the codebook
    codebook_sample: int = 8192  # descriptors that the codebook is clustered from
    codebook_rounds: int = 8  # rounds of this clustering
    max_candidates: int = 3  # earlier views that a view is matched with
    min_candidate_distance: int = 3  # views between two of these candidates
    min_described_points: int = 30  # points with descriptors in a view that is matched
    # similarity of matched views over the median similarity of neighbouring views
    min_similarity: float = 0.4
    # sequence_tracks
    min_views: int = 3  # with fewer views, views with less motion between them are selected instead
    # longer sides: median motion of tracks between such closer views
    min_close_motion: float = 0.0125
    # tracker
    cells: int = 32  # cells along the longer side: a new track begins in every cell without a track
    # cells: of the tracks in a square with this side, the oldest one stays
    min_track_distance: float = 0.6
    structure_window: int = 5  # px: side of the window in which the structure tensor is averaged
    structure_quantile: float = 0.5  # a new point has more structure than this share of all pixels
    min_corner_strength: float = 1e-6  # smaller eigenvalue of the structure tensor of a new point
    border: int = 4  # px: smallest distance of points from the border of the frame
    max_return_error: float = 0.5  # px: distance from the start after tracking there and back,
    max_return_share: float = 0.5 / 640  # longer sides: the same bound, if it is larger
    patch_side: int = 7  # px: side of the patches that are compared along a track
    # grey levels: mean difference of two patches, each without its mean
    max_patch_difference: float = 12.0
    # px: side of the window of the search for a patch near the position from the flow
    search_window: int = 11
    search_rounds: int = 10  # rounds of this search
    search_tolerance: float = 0.01  # px: a smaller step ends this search
    # OpenCV's minEigThreshold: points with less structure count as lost
    min_search_structure: float = 1e-5
    # px from the position from the flow: a farther patch shows another point
    max_search_distance: float = 1.0
    # triangulation
    min_frames: int = 2  # frames that see a triangulated track
    min_angle: float = 0.5  # degrees between the rays of a track: a smaller angle shows no depth
    max_median_residual: float = 3.0  # px: median residual of a track
    # views
    # longer sides: median motion of tracks between a view and the next one
    min_motion: float = 0.025
    # share of a view's tracks: if fewer are visible, the frame is the next view
    min_visible_tracks: float = 0.35
    # detected points; fewer than for pairs, since a view has several partners
    points_per_cell: int = 4
    matched_views: int = 3  # previous views with which a view is matched by appearance
    min_matches: int = 15  # matches of two neighbouring views
    min_loop_matches: int = 25  # matches of two views at a loop that one motion explains,
    min_loop_share: float = 0.4  # and their share of all matches of these views
    min_ordered_views: int = 8  # frames are out of order if, of at least this number of views,
    max_next_share: float = 0.4  # at most this share matches the previous view,
    min_other_share: float = 0.7  # and at least this share matches other views
    # px in a frame with a longer side of 640 px: distance of a match from its epipolar line
    epipolar_tolerance: float = 2.0
    ransac_trials: int = 500  # largest number of RANSAC trials
    # probability, at which RANSAC ends, that a trial had no outlier
    ransac_confidence: float = 0.999
    # cells along the longer side: each cell of a view keeps its longest track; the first number
    # that gives enough tracks is used, since parts of frames may be bare
    cell_counts: tuple[int, int, int] = (10, 16, 24)
    min_tracks: int = 60  # tracks of a view, median of all views, that are enough


TRACKS = TrackSettings()
