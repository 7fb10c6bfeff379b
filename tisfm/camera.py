"""The camera: focal length and principal point in pixels, distortion of its lens, its shutter."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from tisfm.errors import InputError, InputTypeError

COEFFICIENT_COUNTS = (4, 5, 8, 12, 14)  # numbers of distortion coefficients that OpenCV accepts
# Power of the radius that each coefficient multiplies; the two coefficients of the tilt have none.
RADIUS_POWERS = (2, 4, 1, 1, 6, 2, 4, 6, 1, 3, 1, 3)
# Focal lengths, px: outside this range, squares of x̂ and ŷ exceed the range of float32.
MIN_FOCAL = 1e-3
MAX_FOCAL = 1e6


@dataclass(frozen=True, init=False)
class Camera:
    """A pinhole camera with lens distortion and square or oblong pixels.

    Parameters
    ----------
    focal : float or (float, float), default 600.0
        Focal length, px; or (fx, fy), in columns and in rows, if pixels are not square. The
        default is the value that the paper uses for every sequence (section 6).
    center : (float, float), optional
        Principal point (cx, cy), px, in the coordinates of array indices: (0, 0) is the centre
        of the upper left pixel. By default the centre of the image, ((W-1)/2, (H-1)/2).
    distortion : sequence of 4, 5, 8, 12 or 14 floats, optional
        Coefficients of OpenCV's model in OpenCV's order: radial k1, k2, tangential p1, p2, radial
        k3, then k4, k5, k6 of the denominator, s1 to s4 of a thin prism and the tilt τx, τy of the
        sensor. An array of one row or column, as OpenCV's calibration returns it, is accepted.
        OpenCV's fish-eye model is not supported. None or zeros for a lens without distortion.
    aspect : float, default 1.0
        fy / fx, in place of a second focal length.
    readout : float, optional
        Readout time of a rolling shutter, from the first row to the last, as a share of the time
        between two frames of the source. In [−1, 1]; negative if the last row is read first; 0 if
        all rows are read at once (a global shutter). By default it is unknown:
        `tisfm.reconstruct` and `tisfm.reconstruct_stream` estimate it if the motion allows that,
        and for a pair it is assumed to be 0.
        The effect of the rolling shutter is removed for ``motion="camera"``, also for pairs; with
        other motion models it stays in the frames.

    Attributes
    ----------
    focal : float
        The smaller of fx and fy: the focal length of frames resampled to square pixels.

    Raises
    ------
    TypeError, ValueError
        If a value is not a finite number; if a focal length or the aspect is not positive; if the
        number of coefficients is not one of these; if both fy and an aspect other than 1 are given.

    Examples
    --------
    >>> import tisfm
    >>> camera = tisfm.Camera(focal=720.0, distortion=(-0.28, 0.07, 0, 0))
    >>> camera.is_pinhole
    False
    >>> camera.pinhole()
    Camera(focal=720.0, center=None, distortion=None, aspect=1.0, readout=None)
    >>> camera.center_for(480, 640)  # the centre of the image, the default
    (319.5, 239.5)
    >>> tisfm.Camera(focal=(720.0, 700.0)).focals  # pixels that are not square
    (720.0, 700.0)
    """

    focal: float
    center: tuple[float, float] | None
    distortion: tuple[float, ...] | None
    aspect: float
    readout: float | None

    def __init__(
        self,
        focal: float | tuple[float, float] = 600.0,
        center: tuple[float, float] | None = None,
        distortion: Iterable[float] | None = None,
        aspect: float = 1.0,
        readout: float | None = None,
    ) -> None:
        aspect = _check_positive(aspect, "aspect", "fy / fx", unit="")
        if isinstance(focal, (tuple, list, np.ndarray)):
            if aspect != 1:
                raise InputError(
                    f"focal is {focal!r} and aspect is {aspect:g}: give one of fy and aspect"
                )
            fx, fy = _check_focals(focal)
            focal, aspect = min(fx, fy), fy / fx
        coefficients = None if distortion is None else _check_coefficients(distortion)
        values = {
            "focal": _check_positive(focal, "focal", "the focal length"),
            "center": None if center is None else _check_center(center),
            "distortion": coefficients if coefficients and any(coefficients) else None,
            "aspect": aspect,
            "readout": None if readout is None else _check_readout(readout),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def focals(self) -> tuple[float, float]:
        """(fx, fy) of the frames as they were taken, px."""
        if self.aspect >= 1:
            return self.focal, self.focal * self.aspect
        return self.focal / self.aspect, self.focal

    @property
    def is_pinhole(self) -> bool:
        """Whether frames need no resampling: pixels are square and the lens does not distort."""
        return self.distortion is None and self.aspect == 1

    @property
    def is_tilted(self) -> bool:
        """Whether the distortion includes a tilted sensor."""
        return any((self.distortion or ())[len(RADIUS_POWERS) :])

    def center_for(self, height: int, width: int) -> tuple[float, float]:
        """Return the principal point (cx, cy), px, for an image of this size."""
        if self.center is not None:
            return self.center
        return (width - 1) / 2, (height - 1) / 2

    def pinhole(self) -> "Camera":
        """Return the camera of the resampled frames: no distortion, and square pixels."""
        return replace(self, distortion=None, aspect=1.0)

    def with_focal(self, focal: float) -> "Camera":
        """Return a camera with another focal length whose lens displaces pixels in the same way.

        The distortion coefficients multiply powers of the radius in units of the focal length, so
        they change with the focal length.

        Raises
        ------
        ValueError
            If the sensor is tilted: no other tilt displaces pixels in the same way.

        Examples
        --------
        >>> import tisfm
        >>> tisfm.Camera(center=(320.0, 240.0)).with_focal(720.0).focal
        720.0
        """
        lens = self.distortion
        if lens is not None:
            if self.is_tilted:
                raise InputError("the distortion of a tilted sensor fits no other focal length")
            ratio = focal / self.focal
            lens = tuple(
                k * ratio**power for k, power in zip(lens, (*RADIUS_POWERS, 0, 0), strict=False)
            )
        return replace(self, focal=focal, distortion=lens)

    def scaled(self, scale: float, height: int, width: int) -> "Camera":
        """Return the camera of the image resampled by `scale`; the distortion stays the same.

        Parameters
        ----------
        scale : float
            Ratio of the new to the old sampling density, 0.5 for half the resolution.
        height, width : int
            Size of the image before resampling, px.

        Examples
        --------
        >>> import tisfm
        >>> tisfm.Camera(focal=720.0).scaled(0.5, 480, 640).focal
        360.0
        """
        cx, cy = self.center_for(height, width)
        return Camera(
            focal=self.focal * scale,
            center=((cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5),
            distortion=self.distortion,
            aspect=self.aspect,
            readout=self.readout,
        )


def check_camera(camera: Camera | None) -> Camera:
    """Return the camera, or the paper's for None; raise if it is no camera or out of range."""
    if camera is None:
        return Camera()
    if not isinstance(camera, Camera):
        raise InputTypeError(f"camera is {camera!r}: expected a tisfm.Camera")
    if not MIN_FOCAL <= camera.focal <= MAX_FOCAL:
        raise InputError(
            f"focal is {camera.focal:g}: expected {MIN_FOCAL:g} to {MAX_FOCAL:g}, in px"
        )
    if camera.center is not None and max(map(abs, camera.center)) > MAX_FOCAL:
        raise InputError(f"center is {camera.center}: expected at most {MAX_FOCAL:g}, in px")
    return camera


def check_pinhole(camera: Camera, advice: str) -> None:
    """Raise InputError with the advice if the camera has distortion or oblong pixels."""
    if not camera.is_pinhole:
        defect = "oblong pixels" if camera.distortion is None else "distortion"
        raise InputError(f"camera has {defect}, which is not allowed here: {advice}")


def _check_center(value: tuple[float, float]) -> tuple[float, float]:
    try:
        cx, cy = value
    except (TypeError, ValueError):
        raise InputError(
            f"center is {value!r}: give the principal point as (cx, cy), in px"
        ) from None
    return _check_number(cx, "center[0]"), _check_number(cy, "center[1]")


def _check_focals(value: Any) -> tuple[float, float]:
    try:
        fx, fy = value
    except (TypeError, ValueError):
        raise InputTypeError(
            f"focal is {value!r}: expected a number, or two as (fx, fy), in px"
        ) from None
    quantity = "the focal length"
    return _check_positive(fx, "focal[0]", quantity), _check_positive(fy, "focal[1]", quantity)


def _check_positive(value: object, name: str, quantity: str, *, unit: str = ", in px") -> float:
    number = _check_number(value, name, unit=unit)
    if number <= 0:
        raise InputError(f"{name} is {number:g}: {quantity} must be positive{unit}")
    return number


def _check_readout(value: object) -> float:
    number = _check_number(value, "readout", unit=", a share of the time between frames")
    if not -1 <= number <= 1:
        raise InputError(
            f"readout is {number:g}: expected -1 to 1, a share of the time from a frame to the next"
        )
    return number


def _check_coefficients(value: Iterable[float]) -> tuple[float, ...]:
    if isinstance(value, np.ndarray) and value.ndim == 2 and 1 in value.shape:
        value = value.ravel()  # OpenCV returns one row or one column
    try:
        coefficients = tuple(value)
    except TypeError:
        raise InputTypeError(
            f"distortion is {value!r}: give OpenCV's coefficients as (k1, k2, p1, p2[, k3, …])"
        ) from None
    if len(coefficients) not in COEFFICIENT_COUNTS:
        raise InputError(
            f"distortion has {len(coefficients)} coefficient{'s' * (len(coefficients) != 1)}: "
            "expected 4, 5, 8, 12 or 14, in OpenCV's order (k1, k2, p1, p2[, k3, …])"
        )
    return tuple(
        _check_number(coefficient, f"distortion[{k}]", unit="")
        for k, coefficient in enumerate(coefficients)
    )


def _check_number(value: object, name: str, *, unit: str = ", in px") -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputTypeError(f"{name} is {value!r}: expected a number{unit}")
    try:
        number = float(value)
    except OverflowError:  # an integer beyond the range of floats
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{name} is {number}: expected a finite number{unit}")
    return number
