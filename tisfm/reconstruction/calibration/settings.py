"""Tuned numbers of calibration; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Focal length and distortion of an unknown camera."""

    # self_calibration
    # focal lengths that an adjustment starts from, over the guess
    start_factors: tuple[float, ...] = (1.0, 0.42, 2.4)
    min_shape_score: float = 0.5  # mean score per match, 0 to 1, of a model that is not bent
    window_views: int = 16  # views in each of the two windows on which start values are compared
    final_steps: int = 150  # steps of the final adjustment
    final_tolerance: float = 1e-6  # relative change of the squared residuals that ends these steps
    # observations that the uncertainty uses, in all parts of a model together
    max_part_observations: int = 6000
    # start value of the focal length of a part over the estimate, or the inverse
    part_start_factor: float = 1.2
    # change of this start value over its distance from the estimate (logarithms): a part that
    # changes less does not show the focal length
    min_relative_change: float = 0.1
    # standard deviation of the estimate per spread of the parts (logarithms)
    spread_to_deviation: float = 0.7
    # change of the logarithm of the focal length if distortion is estimated too: with more than
    # this and than the spread of the parts, the lens seems to distort
    min_log_focal_change: float = 0.03
    # source_camera
    # relative standard deviation of an estimate: with more, the focal length in the EXIF data is
    # better
    max_exif_deviation: float = 0.1


CALIBRATION = CalibrationSettings()
