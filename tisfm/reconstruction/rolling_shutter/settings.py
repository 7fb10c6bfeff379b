"""Tuned numbers of rolling shutters; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RollingShutterSettings:
    """The readout time of a rolling shutter."""

    # correction; readout times are in intervals between frames
    depth_neighbours: int = 3  # tracks around a detected point, which gets their median depth
    min_significance: float = 4.0  # standard deviations: a readout time nearer to 0 is dropped
    max_rounds: int = 4  # rounds that estimate the readout time, then the path
    known_rounds: int = 2  # rounds if the readout time is known
    min_change: float = 0.02  # change of the readout time: with less, the rounds end
    # change of the readout time over the previous change. A path found with too small a readout
    # time hides a part of the remaining readout, so the next round finds a further change.
    max_hidden_share: float = 0.6
    # readout
    min_views: int = 3  # views that show a point
    max_views: int = 60  # views in use: consecutive ones, in which the camera rotates most
    max_observations: int = 8000  # observations in use: points that most views show are taken first
    # px: larger residuals have a decreasing weight; in the first and the last steps
    outlier_scales: tuple[float, float] = (3.0, 1.0)
    steps_per_scale: int = 4  # Gauss–Newton steps with each of these values
    damping: float = 1e-4  # damping of the steps, as a share of the diagonal
    # standard deviation over its value for independent residuals: errors of films with a global
    # shutter are this much larger
    deviation_factor: float = 5.5
    max_residual: float = 100.0  # px: observations with a larger residual are ignored


ROLLING_SHUTTER = RollingShutterSettings()
