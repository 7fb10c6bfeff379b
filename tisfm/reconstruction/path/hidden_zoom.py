"""A zoom that the depth of a forward motion hides nearly.

If a camera moves along its axis and zooms, all points move away from the centre of the picture, as
they do with another depth and a constant focal length. Only the curvature of their paths over many
frames differs, by less than the adjustment of a zoom for each frame shows. So zooms at a constant
rate are compared.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.reconstruction.calibration.camera_adjustment import AdjustedCamera, adjust_camera
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.path.settings import REVISION


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraComparison:
    """Two adjustments of the same tracks."""

    base: AdjustedCamera  # with one pinhole for all frames
    rich: AdjustedCamera  # with a lens, and a focal length for each frame

    @property
    def hides_zoom(self) -> bool:
        """Whether a richer camera fits better, though the zoom of the frames is uncertain."""
        return (
            float(self.rich.zoom_deviation.max()) > REVISION.max_zoom_deviation
            and measure_gain(self.base, self.rich) > REVISION.min_rich_gain
        )


def measure_gain(base: AdjustedCamera, other: AdjustedCamera) -> float:
    """Return how much better another camera fits the same tracks, in standard deviations."""
    gain = max(base.cost - other.cost, 0.0)
    return float(np.sqrt(gain / CALIBRATION.correlated_observations) / max(base.residual, 1e-12))


def find_hidden_zoom(
    windows: Iterable[CameraComparison],
    free: Sequence[str],  # unknowns of the camera that the path was solved with
) -> float:
    """Return the logarithm of the zoom per frame that fits clearly better than none, or 0.

    The rates follow one another: each adjustment starts from the poses and points of the last one.
    """
    best_rate, best_gain = 0.0, REVISION.min_hidden_gain
    for window in windows:
        if not window.hides_zoom:
            continue
        times = np.array(window.base.bundle.frames, np.float64)
        for sign in (-1, 1):
            zoomed = window.base
            for rate in REVISION.hidden_zoom_rates:
                zoomed = adjust_camera(
                    zoomed.bundle,
                    zoomed.focal,
                    free,
                    zoom=sign * rate * (times - times[0]),
                    scales=(MAPPING.outlier_pixels,),
                    steps=REVISION.hidden_zoom_steps,
                )
                gain = measure_gain(window.base, zoomed)
                if gain > best_gain:
                    best_rate, best_gain = sign * rate, gain
    return best_rate


def object_to_hidden_zoom(rate: float) -> str:
    """Return what a zoom per frame, a logarithm, contradicts, and advice; "" without a zoom."""
    if not rate:
        return ""
    return (
        f"the tracks fit a zoom, of about {100 * rate:+.1f} % per frame, better than a constant "
        "focal length: depth is probably wrong. Give frames without a zoom; if the camera does not "
        "zoom, check the focal length and the lens"
    )
