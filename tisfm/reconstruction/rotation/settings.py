"""Tuned numbers of rotations; without another source, a number was set by hand."""

from dataclasses import dataclass

FRAME_SIDE = 640  # px: longer side of the frames for which distances are stated


@dataclass(frozen=True, kw_only=True)
class RotationSettings:
    """Orientations of a camera that only turns."""

    # frame_pairs
    # frames between the two frames of a pair that shares tracks
    steps: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    min_points: int = 20  # points of a pair
    max_points: int = 150  # points of a pair, evenly chosen from all
    # pair_rotation
    trials: int = 64  # rotations from two points each that are tried
    # px of frames with a longer side of 640 px: distance of a point that counts as an inlier
    inlier_pixels: float = 3.0
    min_length: float = 1e-12  # of the sum or the product of two unit rays: rounding of float64
    rounds: int = 10  # reweighted rounds of the fit of one rotation
    # adjustment
    outlier_pixels: float = 1.0  # px of 640: larger residuals have a decreasing weight
    max_steps: int = 50  # Levenberg–Marquardt steps
    min_decrease: float = 1e-6  # relative decrease of the cost that ends the steps
    start_damping: float = 1e-6  # damping of the first step
    max_focal_step: float = 0.3  # logarithm of the focal length in one step
    damping_factor: float = 10.0  # of the damping, from one step to the next
    max_damping: float = 1e6  # larger damping ends the steps: none lowers the cost
    min_damping: float = 1e-9
    min_diagonal: float = 1e-12  # of the normal equations: rounding of float64
    min_ray_z: float = 0.05  # of a ray that is projected: beyond 87° derivatives are of no use
    # rotation_search
    min_frames: int = 3  # frames of a piece
    min_inlier_share: float = 0.5  # inliers of a pair that one rotation explains
    max_sample_pairs: int = 12  # pairs from which the first focal length comes
    # Median residual of a pair divided by its median motion. It is 0.011 to 0.017 where a camera
    # turns, also in the hand, and 0.1 to 0.2 where it moves in a room.
    max_residual_share: float = 0.04
    # the same share before the adjustment: orientations and a focal length from single pairs
    max_first_residual_share: float = 0.08
    # the same share for a single frame, whose motion may be smaller, while noise is the same
    max_frame_residual_share: float = 0.08
    min_explained_share: float = 0.5  # frames of a piece that a rotation explains
    # longer sides: median motion of a pair that shows whether the camera only turns
    min_motion: float = 0.02
    max_frame_pairs: int = 3  # pairs with the largest motions by which a frame is checked
    # Residual of the rotation divided by that of a homography. A plane in front of a camera that
    # moves has 20 to 200, and a camera that turns 0.9 to 2.7.
    max_homography_ratio: float = 3.0
    min_homography_residual: float = 0.25  # px of 640: smaller residuals are equally good
    # longer sides: focal lengths that are searched. A camera that moves along a plane looks like a
    # camera that turns behind a very long lens.
    focal_range: tuple[float, float] = (0.4, 2.5)
    focal_candidates: int = 9  # focal lengths that are tried first, evenly in their logarithms
    # halves of the time and of the image that have points: fewer show no deviation
    min_halves: int = 2
    # start value of the focal length of a half divided by the estimate, or the inverse ratio
    half_start_factor: float = 1.2
    # Relative error of the focal length beyond the differences between halves. On seven rendered
    # pans, the estimates were off by 0 to 0.7 %.
    focal_deviation: float = 0.005
    # The same error, divided by the residual share beyond that of a homography. In a hand, the
    # camera moves on an arc: in one film this share was 0.011, and the focal length 6 % too large.
    arc_deviation: float = 4.0


ROTATION = RotationSettings()
