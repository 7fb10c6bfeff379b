"""Tuned numbers of rolling shutters; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RollingShutterSettings:
    """The readout time of a rolling shutter."""

    # correction; readout times are in intervals between frames
    depth_neighbours: int = 3  # tracks whose median depth a detected point gets
    min_significance: float = 4.0  # standard deviations: a readout time nearer to 0 is dropped
    max_rounds: int = 4  # rounds that estimate the readout time, then the path
    known_rounds: int = 2  # rounds if the readout time is known
    min_change: float = 0.02  # a smaller change of the readout time ends the rounds
    # change of the readout time divided by its previous change. A path that was estimated with too
    # short a readout time explains a part of the readout, so the next round finds a further change.
    max_hidden_share: float = 0.6
    # readout
    min_views: int = 3  # views that show a point
    max_views: int = 60  # consecutive views in use: those where the camera rotates most
    max_observations: int = 8000  # observations in use: points that most views show come first
    # px: larger residuals have a decreasing weight; for the first and for the last steps
    outlier_scales: tuple[float, float] = (3.0, 1.0)
    steps_per_scale: int = 4  # Gauss–Newton steps with each of these values
    damping: float = 1e-4  # damping of the steps, as a share of the diagonal
    # standard deviation divided by its value for independent residuals: the errors in films with a
    # global shutter were larger by this factor
    deviation_factor: float = 5.5
    max_residual: float = 100.0  # px: observations with a larger residual are ignored


ROLLING_SHUTTER = RollingShutterSettings()
