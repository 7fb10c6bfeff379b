"""Tuned numbers of the checks of a path and its depth, set by hand without another source."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PathCheckSettings:
    """Pairs of frames that are checked, and the limits that contradict a path."""

    # pieces
    min_pairs: int = 3  # pairs of a short piece
    max_pairs: int = 5  # pairs of a long piece
    frames_per_pair: int = 6  # frames of a piece for which there is one pair, between these numbers
    max_stream_pairs: int = 2  # pairs of the new frames of a stream, each time the path is solved
    min_keyframes: int = 3  # with fewer keyframes, pairs begin at other frames too
    # median motion of tracks between the frames of a pair, share of the longer side
    pair_motion: float = 0.02
    min_pair_motion: float = 1e-5  # smaller motions are equally small, share of the longer side
    max_pair_steps: int = 8  # frames between the two frames of a pair
    min_pair_tracks: int = 20  # tracks that both frames of a pair have
    # the same number over that of the nearest frame; near points leave the picture first, and the
    # tracks of far points hide that the frames are far apart
    min_kept_tracks: float = 0.5
    # a pair that goes back in time has to be nearer to the wanted motion by this, logarithm
    backward_cost: float = 0.5
    max_starts: int = 3  # dense motions of two views that a contradicted path begins with again
    # dense_pairs
    # grey levels per px, squared: smaller eigenvalue of the structure tensor at textured pixels
    min_texture: float = 9.0
    texture_window: int = 7  # px: side of the window of the structure tensor
    border: int = 3  # px at the border of the frame that are left out
    min_pixels: int = 500  # textured pixels of a pair
    max_rays: int = 6000  # rays of a pair, or up to twice as many
    match_window: int = 7  # px: side of the neighbourhood that is compared
    texture_floor: float = 1.0  # grey levels per px that are added to the texture
    # difference between neighbourhoods over the usual difference: hidden pixels, or a wrong flow
    max_relative_shift: float = 3.0
    min_usual_shift: float = 0.1  # px: smaller usual differences are equally good
    # px of the shrunk frames: smallest distance from an epipolar line that counts as off the line
    off_line_distance: float = 1.0
    off_line_deviations: float = 3.0  # and the same in deviations of the pair's own motion
    correlated_pixels: int = 50  # neighbouring pixels that share one error
    min_residual: float = 0.1  # px: smaller residuals are equally good
    min_scale: float = 0.02  # px: smallest deviation of distances in a robust fit
    # evidence: fit of a zoom
    zoom_iterations: int = 25
    max_zoom: float = 0.15  # logarithm of the zoom of a pair
    min_zoom_residual: float = 0.05  # px: smaller residuals are equally good
    min_zoom_step: float = 1e-7  # length of a step that ends the iterations
    # fixed_texture
    max_fixed_frames: int = 12  # frames that are compared
    fixed_window: int = 7  # px: side of the window that averages texture and its changes
    min_fixed_gradient: float = 3.0  # grey levels per px: texture that would show a motion
    max_fixed_shift: float = 0.25  # px: median shift of texture that counts as fixed
    min_median_gradient: float = 1e-3  # grey levels per px: smallest texture that is divided by
    min_fixed_texture: float = 0.8  # texture of the median frame over that of single frames
    min_fixed_frames: int = 5  # frames that show which pixels are fixed
    # share of the frame that has moving texture, if the camera moved
    min_moving_share: float = 0.03


PATH_CHECKS = PathCheckSettings()
