"""The pinhole camera: focal length and principal point, in pixels."""

import math
from dataclasses import dataclass
from numbers import Real


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with square pixels and no distortion.

    Parameters
    ----------
    focal : float, default 600.0
        Focal length, px. The default is the value the paper uses for every sequence
        (section 6).
    center : (float, float), optional
        Principal point (cx, cy), px, in the coordinates of array indices: (0, 0) is the centre
        of the upper left pixel. By default the centre of the image, ((W-1)/2, (H-1)/2).

    Raises
    ------
    TypeError, ValueError
        If a value is not a number, not finite, or the focal length is not positive.
    """

    focal: float = 600.0
    center: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "focal", _number(self.focal, "focal"))
        if self.focal <= 0:
            raise ValueError(f"focal is {self.focal:g}: the focal length must be positive, in px")
        if self.center is not None:
            try:
                cx, cy = self.center
            except (TypeError, ValueError):
                raise ValueError(
                    f"center is {self.center!r}: give the principal point as (cx, cy), in px"
                ) from None
            center = (_number(cx, "center[0]"), _number(cy, "center[1]"))
            object.__setattr__(self, "center", center)

    def center_for(self, height: int, width: int) -> tuple[float, float]:
        """Return the principal point (cx, cy), px, for an image of this size."""
        if self.center is not None:
            return self.center
        return (width - 1) / 2, (height - 1) / 2

    def scaled(self, scale: float, height: int, width: int) -> "Camera":
        """Return the camera of the image resampled by `scale`.

        Parameters
        ----------
        scale : float
            Ratio of the new to the old sampling density, 0.5 for half the resolution.
        height, width : int
            Size of the image before resampling, px.
        """
        cx, cy = self.center_for(height, width)
        return Camera(
            focal=self.focal * scale,
            center=((cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5),
        )


def check_camera(camera: Camera | None) -> Camera:
    """Return the camera, by default the paper's; refuse anything else."""
    if camera is None:
        return Camera()
    if not isinstance(camera, Camera):
        raise TypeError(f"camera is {camera!r}: expected a tisfm.Camera")
    return camera


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name} is {value!r}: expected a number, in px")
    try:
        number = float(value)
    except OverflowError:  # of an integer beyond the range of floats
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} is {number}: expected a finite number, in px")
    return number
