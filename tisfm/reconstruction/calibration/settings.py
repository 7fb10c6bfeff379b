"""Tuned numbers of calibration; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Focal length and distortion of an unknown camera."""

    # self_calibration
    start_factors: tuple[float, ...] = (1.0, 0.42, 2.4)  # start values of an adjustment, in guesses
    min_shape_score: float = 0.5  # per match, 0 to 1, mean: of a model that is not bent
    window_views: int = 16  # of each of the two windows on which start values are compared
    final_steps: int = 150  # of the final adjustment
    final_tolerance: float = 1e-6  # relative change of squared residuals that ends these steps
    max_part_observations: int = 6000  # of all parts of a model, for the uncertainty
    part_start_factor: float = 1.2  # start value of a part over the estimate, or its inverse
    # of the start value of a part that shows the focal length, in distances to the estimate
    min_relative_change: float = 0.1
    spread_to_deviation: float = 0.7  # standard deviation per spread of the parts, logarithmic
    # of the logarithm of the focal length, if distortion is estimated too: with more than this and
    # than the spread of the parts, the lens seems to distort
    min_log_focal_change: float = 0.03
    # source_camera
    max_exif_deviation: float = 0.1  # standard deviation, relative: with more, EXIF is better


CALIBRATION = CalibrationSettings()
