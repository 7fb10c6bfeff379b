"""Removal of lens distortion: frames are resampled to frames of a pinhole camera."""

import cv2
import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera, check_camera
from tisfm.errors import InputError
from tisfm.frames import check_frame
from tisfm.resampling import Resampling
from tisfm.solver.sampling import FAR_FLOW

__all__ = ["undistort"]

# Smallest share of pixels with data: with fewer, the coefficients belong to another camera.
MIN_VALID_SHARE = 0.1
RADIUS_SAMPLES = 4096  # number of radii at which the radial part of the model is evaluated


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
        Where the pinhole image has data: the source of the pixel lies inside the frame.

    Raises
    ------
    ValueError
        If the pinhole image has data at so few pixels that the camera cannot fit the frames.

    References
    ----------
    Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32 (1966) 444–462, with
    the denominator, thin prism and tilt that OpenCV adds.
    """

    def __init__(self, camera: Camera, height: int, width: int) -> None:
        cx, cy = camera.center_for(height, width)
        camera_matrix, pinhole_matrix = (
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            for fx, fy in (camera.focals, camera.pinhole().focals)
        )
        coefficients = np.array(camera.distortion or (0.0,) * 4)
        sources, _ = cv2.initUndistortRectifyMap(
            camera_matrix, coefficients, None, pinhole_matrix, (width, height), cv2.CV_32FC2
        )
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        flow = np.stack([sources[..., 0] - x, sources[..., 1] - y])
        # NaN is replaced before the kernel runs: with fast math, comparisons with NaN may be true.
        flow = np.nan_to_num(flow, nan=FAR_FLOW)
        radius = np.hypot((x - cx) / camera.focal, (y - cy) / camera.focal)
        is_folded = radius > _fold_radius(coefficients, float(radius.max()))
        super().__init__(flow, ~is_folded)
        valid_share = float(self.valid.mean())
        if valid_share < MIN_VALID_SHARE:
            raise InputError(
                f"distortion leaves data at {100 * valid_share:.2g}% of the pixels of a frame of "
                f"{height} × {width} px: check its signs and order (k1, k2, p1, p2[, k3, …]), the "
                "focal length and the centre"
            )


def undistort(frame: npt.ArrayLike, camera: Camera) -> np.ndarray:
    """Return a frame as the pinhole camera ``camera.pinhole()`` would have taken it.

    `tisfm.interpret` does this itself: its result belongs to the frames without distortion.

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) array
        Grey or RGB; uint8, uint16 or float. Not modified.
    camera : Camera

    Returns
    -------
    (H, W) or (H, W, 3) array
        Of the same type. The frame itself, if the lens does not distort and pixels are square.
        Pixels of the pinhole image outside the frame repeat the border of the frame.

    Raises
    ------
    TypeError, ValueError
        If `frame` is not an image of these types, or `camera` cannot have taken it.

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
    """Return a depth map, (H, W) float, resampled like the frame that `undistort` returns.

    Each pixel takes the depth of the nearest source pixel; NaN where there are no data. If the lens
    does not distort and pixels are square, the map itself is returned.
    """
    return depth if camera.is_pinhole else Undistortion(camera, *depth.shape).apply_nearest(depth)


def _fold_radius(coefficients: np.ndarray, max_radius: float) -> float:
    """Return the radius, in focal lengths, at which the distorted radius stops increasing.

    The model is a rational function fitted inside the frame. Beyond this radius it may map a part
    of the frame into the pinhole image a second time.
    """
    k1, k2, _, _, k3, k4, k5, k6 = np.pad(coefficients, (0, 14 - len(coefficients)))[:8]
    radius = np.linspace(0, max_radius, RADIUS_SAMPLES)
    square = radius**2
    with np.errstate(all="ignore"):
        distorted = (
            radius * np.polyval((k3, k2, k1, 1), square) / np.polyval((k6, k5, k4, 1), square)
        )
        fold_indices = np.flatnonzero(~(np.diff(distorted) > 0))
    return float(radius[fold_indices[0]]) if len(fold_indices) else np.inf
