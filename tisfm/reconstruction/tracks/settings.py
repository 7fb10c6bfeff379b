"""Tuned numbers of tracks and views; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TrackSettings:
    """Tracks, views, their matches, and triangulation."""

    # retrieval
    codebook_size: int = 32  # words
    codebook_sample: int = 8192  # descriptors that the codebook is clustered from
    codebook_rounds: int = 8  # of this clustering
    max_candidates: int = 3  # earlier views that a view is matched with
    min_candidate_distance: int = 3  # views between two of these candidates
    min_described_points: int = 30  # of a view that is matched
    min_similarity: float = 0.4  # of matched views, in median similarities of neighbouring views
    # sequence_tracks
    min_views: int = 3  # with fewer, views with less motion between them are selected instead
    min_close_motion: float = 0.0125  # longer sides: median motion of tracks between these views
    # tracker
    cells: int = 32  # along the longer side: a new track begins in every cell without a track
    min_track_distance: float = 0.6  # cells: in a square of this side, the oldest track stays
    structure_window: int = 5  # px: side of the window for the average of the structure tensor
    structure_quantile: float = 0.5  # of all pixels: a new point has more structure
    min_corner_strength: float = 1e-6  # smaller eigenvalue of the structure tensor of a new point
    border: int = 4  # px: smallest distance of points from the border
    max_return_error: float = 0.5  # px from the start after tracking there and back,
    max_return_share: float = 0.5 / 640  # longer sides: the same, if that is more
    patch_side: int = 7  # px: side of the patches that are compared along a track
    max_patch_difference: float = 12.0  # grey levels: mean, without the difference of the means
    search_window: int = 11  # px: side of the window of the search for a patch
    search_rounds: int = 10  # of this search
    search_tolerance: float = 0.01  # px: a smaller step ends this search
    min_search_structure: float = 1e-5  # OpenCV's minEigThreshold of this search
    max_search_distance: float = 1.0  # px from the flow: a farther patch belongs to another point
    # triangulation
    min_frames: int = 2  # that see a track
    min_angle: float = 0.5  # degrees between the rays of a track: a smaller angle shows no depth
    max_median_residual: float = 3.0  # px, of a track
    # views
    min_motion: float = 0.025  # longer sides: median motion of tracks from a view to the next one,
    min_visible_tracks: float = 0.35  # share of a view's tracks; with less, the next view follows
    points_per_cell: int = 4  # fewer than for pairs, since a view is matched with several views
    matched_views: int = 3  # previous views with which a view is matched by appearance
    min_matches: int = 15  # of two neighbouring views
    min_loop_matches: int = 25  # of two views at a loop that one motion explains,
    min_loop_share: float = 0.4  # and their share of all matches
    min_ordered_views: int = 8  # frames are out of order if, of at least this number of views,
    max_next_share: float = 0.4  # at most this share matches the previous view,
    min_other_share: float = 0.7  # and at least this share matches other views
    # px, if the longer side has 640: of a match from its epipolar line
    epipolar_tolerance: float = 2.0
    ransac_trials: int = 500  # largest number
    # probability of a trial without outliers, which ends the trials
    ransac_confidence: float = 0.999
    # along the longer side: each cell of a view keeps its longest track; the first number with
    # enough tracks is used, since parts of frames may be bare
    cell_counts: tuple[int, int, int] = (10, 16, 24)
    min_tracks: int = 60  # of a view, median: enough tracks


TRACKS = TrackSettings()
