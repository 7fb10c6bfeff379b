"""Distortion of the lens, removed: frames as a pinhole camera would have taken them."""

import cv2
import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera, check_camera
from tisfm.errors import InputError
from tisfm.frames import check_frame
from tisfm.resampling import Resampling
from tisfm.solver.sampling import FAR

__all__ = ["undistort"]

LEAST_SEEN = 0.1  # of the pixels: coefficients that leave fewer with data belong to another camera
RADII = 4096  # at which the radial part of the model is looked at


class Undistortion(Resampling):
    """The map from frames with distortion or oblong pixels to the pinhole image.

    The pinhole image has the frame's size, and the focal length and centre of the camera.

    Parameters
    ----------
    camera : Camera
    height, width : int
        Size of the frames, px.

    Attributes
    ----------
    valid : (H, W) bool
        Where the pinhole image has data: what it shows there lies inside the frame.

    Raises
    ------
    ValueError
        If so little of the pinhole image has data that the camera cannot be that of the frames.

    References
    ----------
    Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32 (1966) 444–462, with
    the denominator, thin prism and tilt that OpenCV adds.
    """

    def __init__(self, camera: Camera, height: int, width: int) -> None:
        cx, cy = camera.center_for(height, width)
        taken, wanted = (
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            for fx, fy in (camera.focals, camera.pinhole().focals)
        )
        coefficients = np.array(camera.distortion or (0.0,) * 4)
        sources, _ = cv2.initUndistortRectifyMap(
            taken, coefficients, None, wanted, (width, height), cv2.CV_32FC2
        )
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        flow = np.stack([sources[..., 0] - x, sources[..., 1] - y])
        # Not left to the kernel: compiled for speed, it may take a comparison with NaN for true.
        flow = np.nan_to_num(flow, nan=FAR)
        radius = np.hypot((x - cx) / camera.focal, (y - cy) / camera.focal)
        folded = radius > _fold(coefficients, float(radius.max()))
        super().__init__(flow, ~folded)
        share = float(self.valid.mean())
        if share < LEAST_SEEN:
            raise InputError(
                f"distortion leaves data at {100 * share:.2g}% of the pixels of a frame of "
                f"{height} × {width} px: check its signs and order (k1, k2, p1, p2[, k3, …]), the "
                "focal length and the centre"
            )


def undistort(frame: npt.ArrayLike, camera: Camera) -> np.ndarray:
    """Return a frame as the pinhole camera would have taken it, ``camera.pinhole()``.

    `tisfm.interpret` does so itself: its result belongs to the frames without distortion.

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) array
        Grey or RGB; uint8, uint16 or float. Not modified.
    camera : Camera

    Returns
    -------
    (H, W) or (H, W, 3) array
        Of the same type. The frame itself, if the lens does not distort and pixels are square.
        Where the frame does not
        show what the pinhole image would, its border is repeated.

    Raises
    ------
    TypeError, ValueError
        If `frame` is not an image of those kinds, or `camera` not one that could have taken it.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.lens import undistort
    >>> from tisfm.scenes import two_blocks
    >>> frame = two_blocks(48, 64).frame0
    >>> camera = tisfm.Camera(focal=64.0, distortion=(-0.1, 0.01, 0, 0))
    >>> undistort(frame, camera).shape
    (48, 64)
    """
    camera, image = check_camera(camera), check_frame(frame, "frame")
    if camera.is_pinhole:
        return image
    return Undistortion(camera, *image.shape[:2]).apply(image)


def undistort_depth(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Return a depth map, (H, W) float, of the frame that `undistort` returns.

    Each pixel's is the nearest one, NaN where there are no data; the map itself, if the lens does
    not distort and pixels are square.
    """
    return depth if camera.is_pinhole else Undistortion(camera, *depth.shape).nearest(depth)


def _fold(coefficients: np.ndarray, reach: float) -> float:
    """Return the distance from the axis, focal lengths, from where the model turns back.

    It is a polynomial fitted to what the frame shows. Beyond, it may bring a part of the frame to
    the pinhole image a second time.
    """
    k1, k2, _, _, k3, k4, k5, k6 = np.pad(coefficients, (0, 14 - len(coefficients)))[:8]
    radius = np.linspace(0, reach, RADII)
    square = radius**2
    with np.errstate(all="ignore"):
        distorted = (
            radius * np.polyval((k3, k2, k1, 1), square) / np.polyval((k6, k5, k4, 1), square)
        )
        turning = np.flatnonzero(~(np.diff(distorted) > 0))
    return float(radius[turning[0]]) if len(turning) else np.inf
