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
    min_described_points: int = 30  # points with descriptors of a view that is matched
    # similarity of two views that are matched, divided by the median similarity of neighbouring
    # views
    min_similarity: float = 0.4
    # sequence_tracks
    # selected views: with fewer views, views with less motion between them are selected
    min_views: int = 3
    # median motion of tracks between these closer views, as a share of the frame's longer side
    min_close_motion: float = 0.0125
    # tracker
    cells: int = 32  # cells along the longer side: a new track begins in every cell without a track
    # side of a square, in cells: of several tracks in one square, only the oldest track continues
    min_track_distance: float = 0.6
    structure_window: int = 5  # px: side of the window in which the structure tensor is averaged
    structure_quantile: float = 0.5  # a new point has more structure than this share of all pixels
    min_corner_strength: float = 1e-6  # smaller eigenvalue of the structure tensor of a new point
    border: int = 4  # px: smallest distance of points from the border of the frame
    # px: distance of a point from its start after tracking to the next frame and back
    max_return_error: float = 0.5
    # the same bound as a share of the frame's longer side; the larger bound is used
    max_return_share: float = 0.5 / 640
    patch_side: int = 7  # px: side of the patches that are compared along a track
    # grey levels: mean absolute difference of two patches, after the mean of each was subtracted
    max_patch_difference: float = 12.0
    # px: side of the window in which Lucas and Kanade's search compares frames
    search_window: int = 11
    search_rounds: int = 10  # iterations of this search
    search_tolerance: float = 0.01  # px: a smaller step ends this search
    # OpenCV's minEigThreshold: the search fails at points with less structure
    min_search_structure: float = 1e-5
    # px: distance of the search result from the position that the flow predicts; a farther patch
    # shows another point
    max_search_distance: float = 1.0
    # triangulation
    min_frames: int = 2  # frames that show a triangulated track
    min_angle: float = 0.5  # degrees between the rays of a track: a smaller angle shows no depth
    max_median_residual: float = 3.0  # px: median residual of a track
    # views
    # median motion of tracks from a view to the next view, as a share of the frame's longer side
    min_motion: float = 0.025
    # share of the last view's tracks: a frame that shows fewer of these tracks becomes a view
    min_visible_tracks: float = 0.35
    # detected points; fewer than for a single pair of frames, since a view is matched several times
    points_per_cell: int = 4
    # photographs: their points are matched at a larger size
    photograph_points_per_cell: int = 16
    # pixels of the frame whose points are matched: a frame with as many or more is halved
    photograph_pixels: int = 2**21
    # share of neighbouring frames that share hardly any track: with at least this share, frames are
    # photographs
    min_photograph_share: float = 0.5
    # longer sides: median motion between neighbouring photographs. Frames that move less have no
    # tracks for another reason, such as noise or changing light
    min_photograph_motion: float = 0.1
    min_matched_share: float = 0.5  # share of the photographs that match another one
    matched_views: int = 3  # previous views with which a view is matched by appearance
    min_matches: int = 15  # matches of two neighbouring views
    min_loop_matches: int = 25  # matches that one motion explains, of two views at a loop
    min_loop_share: float = 0.4  # share of these matches among all matches of the two views
    min_ordered_views: int = 8  # views: with fewer views, the order of frames is not checked
    # Frames are out of order if less than this share of views matches the previous view, and more
    # than `min_other_share` of the views match other views.
    max_next_share: float = 0.4
    min_other_share: float = 0.7  # share of views: see `max_next_share`
    # px in a frame with a longer side of 640 px: distance of a match from its epipolar line
    epipolar_tolerance: float = 2.0
    ransac_trials: int = 500  # largest number of RANSAC trials
    # RANSAC ends when, with this probability, at least one trial had no outlier.
    ransac_confidence: float = 0.999
    # cells along the longer side: each cell of a view keeps its longest track. The first number of
    # cells that gives enough tracks is used, since parts of frames may have no texture.
    cell_counts: tuple[int, int, int] = (10, 16, 24)
    min_tracks: int = 60  # enough tracks of a view, as the median over all views


TRACKS = TrackSettings()
