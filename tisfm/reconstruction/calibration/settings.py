"""Tuned numbers of calibration; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Focal length and distortion of an unknown camera."""

    # self_calibration
    # focal lengths from which adjustments start, divided by the guess
    start_factors: tuple[float, ...] = (1.0, 0.42, 2.4)
    min_shape_score: float = 0.5  # mean score per match, from 0 to 1, of a model that is not bent
    window_views: int = 16  # views in each of the two windows on which start values are compared
    final_steps: int = 150  # steps of the final adjustment
    final_tolerance: float = 1e-6  # relative change of the squared residuals that ends these steps
    # observations of points in each part of a model; the parts show how uncertain an estimate is
    max_part_observations: int = 6000
    # start value of the focal length of a part divided by the estimate, or the inverse ratio
    part_start_factor: float = 1.2
    # change of the focal length in the adjustment of a part, divided by the distance between start
    # value and estimate (all as logarithms): with a smaller change, a part does not show the focal
    # length
    min_relative_change: float = 0.1
    # standard deviation of the estimate divided by the spread of the parts (as logarithms)
    spread_to_deviation: float = 0.7
    # relative deviation of a focal length by errors that all parts share, such as those of the
    # tracks: with it, 97 % of 31 estimates from real films lie within two deviations, without it
    # 81 %
    shared_deviation: float = 0.01
    # change of the logarithm of the focal length if distortion is estimated too: if it exceeds this
    # number and the standard deviation, the lens seems to distort
    min_log_focal_change: float = 0.03
    # camera_adjustment
    min_bundle_frames: int = 3  # frames that show a track that is adjusted
    # px: residuals beyond this number have a decreasing weight; the last one is that of the mapping
    bundle_scales: tuple[float, ...] = (3.0, 0.5)
    bundle_steps: int = 30  # largest number of steps of an adjustment
    bundle_tolerance: float = 1e-4  # relative change of the cost that ends the steps
    bundle_damping: float = 1e-3  # first damping of Levenberg and Marquardt
    bundle_damping_factor: float = 10.0  # of the damping, from one step to the next
    min_bundle_deviation: float = 0.02  # px: smallest standard deviation of a coordinate
    # smallest diagonal of the Cholesky factor of equations with a unit diagonal; equations with
    # less are singular but for rounding
    min_pivot: float = 1e-6
    # share of the trace that is added to the diagonal of the equations of a point
    min_point_stiffness: float = 1e-12
    # multiplications of a product of sparse matrices: with more, dense parts are multiplied
    min_dense_operations: int = 100_000_000
    dense_columns: int = 1000  # columns of such a part
    min_trace: float = 1e-30  # px²: added to that trace, so that a point without weight is regular
    min_bundle_depth: float = 1e-6  # unit of the poses: smallest depth that a projection divides by
    min_bundle_length: float = 1e-12  # unit of the poses: smallest distance that is divided by
    # observations of a track that share one error: they drift together
    correlated_observations: float = 4.0
    # logarithm per frame²: typical change of the zoom per frame; larger changes weigh less
    zoom_change: float = 0.001
    # source_camera
    # relative standard deviation of an estimate: with a larger deviation, the focal length in the
    # EXIF data is better
    max_exif_deviation: float = 0.1


CALIBRATION = CalibrationSettings()
