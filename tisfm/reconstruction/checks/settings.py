"""Tuned numbers of the checks of a path and its depth."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Pairs of frames that are checked, and the limits that contradict a path."""

    # dense_pair
    max_pairs: int = 5  # pairs of a piece
    # median motion between the frames of a pair, in longer sides; set by hand
    pair_motion: float = 0.02
    max_pair_steps: int = 8  # frames between the two frames of a pair
    # grey levels per px, squared: smaller eigenvalue of the structure tensor at textured pixels
    min_texture: float = 9.0
    texture_window: int = 7  # px: side of the window of the structure tensor
    border: int = 3  # px at the border of the frame that are left out
    min_pixels: int = 500  # textured pixels of a pair
    max_rays: int = 6000  # rays that motions are fitted to
    # px of the shrunk frames: smallest distance from an epipolar line that counts as off the line
    off_line_distance: float = 1.0
    off_line_deviations: float = 3.0  # and the same in deviations of the pair's own motion
    correlated_pixels: int = 50  # neighbouring pixels that share one error
    min_residual: float = 0.1  # px: smaller residuals are equally good
    # pair_zoom
    zoom_iterations: int = 25
    zoom_deviation: float = 0.03  # prior of the logarithm of the zoom of a pair
    max_zoom: float = 0.15  # logarithm of the zoom of a pair
    min_zoom_residual: float = 0.05  # px
    # fixed_pixels
    max_fixed_frames: int = 24  # frames that are compared
    fixed_window: int = 7  # px: side of the window that averages texture and its changes
    min_fixed_gradient: float = 3.0  # grey levels per px: texture that would show a motion
    max_fixed_shift: float = 0.25  # px: median shift of texture that counts as fixed
    min_fixed_texture: float = 0.8  # texture of the median frame over that of single frames
    min_fixed_frames: int = 5  # frames that show which pixels are fixed
    # share of the frame that has moving texture, if the camera moved
    min_moving_share: float = 0.03


CHECKS = CheckSettings()
