"""Homographies between frames of one plane, fitted to the grey levels of all pixels."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.epipolar_fit import MAD_TO_DEVIATION
from tisfm.reconstruction.depth.settings import DEPTH

MAX_GREY = 255.0
SAMPLE_ROW = 128  # samples of a row of an array that is interpolated


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredHomography:
    """The homography from one frame to another, and how certain it is."""

    first: int  # index of the frame
    second: int
    matrix: np.ndarray  # (3, 3) float64: on positions in focal lengths
    # (8, 8) float64: inverse covariance, up to a factor that all pairs share, of the first eight
    # entries of D − I, row by row; D, whose last entry is 1, is applied before the matrix
    information: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class _SmoothFrame:
    """A smoothed frame with its derivatives, and its samples on a grid."""

    images: tuple[np.ndarray, ...]  # three (H, W) float32: grey levels, derivatives by x and y
    used: np.ndarray  # (H, W) bool: pixels that are used, and whose neighbours are
    rays: np.ndarray  # (3, N) float64: directions to the samples
    grey: np.ndarray  # (N,) float64: grey levels of the samples

    def with_fewer_samples(self, factor: int) -> "_SmoothFrame":
        """Return the frame with every factor-th sample."""
        return replace(self, rays=self.rays[:, ::factor], grey=self.grey[::factor])


class HomographySearch:
    """Fits homographies to pairs of frames."""

    def __init__(
        self,
        # frame → (H, W) float32: grey levels; frame → (H, W) bool: pixels that are used
        grey: Callable[[int], np.ndarray],
        used_pixels: Callable[[int], np.ndarray],
        camera: Camera,  # a pinhole
    ) -> None:
        self._grey, self._used_pixels, self._camera = grey, used_pixels, camera
        self._cache: dict[int, _SmoothFrame] = {}

    def measure(
        self,
        pair: tuple[int, int],  # indices of the frames, as in the result
        frames: tuple[int, int],  # numbers of the frames
        start: np.ndarray,  # (3, 3): homography near the right one
    ) -> MeasuredHomography | None:
        """Return the homography of two frames; None if they hardly overlap or do not fit.

        Differences of brightness, a factor and an offset, are fitted as well. Steps with few
        samples come first; the last step has all of them.

        References
        ----------
        Baker and Matthews, "Lucas-Kanade 20 years on: a unifying framework", IJCV 2004,
        doi 10.1023/B:VISI.0000011205.11775.fd: the forwards compositional algorithm.
        """
        first, second = (self._prepare(frame) for frame in frames)
        few = first.with_fewer_samples(DEPTH.homography_sample_factor)
        matrix = start
        for samples in (*[few] * DEPTH.homography_steps, first):
            equations = self._linearise(samples, second, matrix)
            if equations is None:
                return None
            information, gradient = equations
            step = -np.linalg.solve(information, gradient)
            matrix = matrix @ (np.eye(3) + np.r_[step, 0.0].reshape(3, 3))
        moved = self._camera.focal * _displacement(start, matrix, few.rays)
        if not moved < DEPTH.max_homography_change:
            return None
        return MeasuredHomography(
            first=pair[0], second=pair[1], matrix=matrix, information=information
        )

    def _prepare(self, number: int) -> _SmoothFrame:
        """Return a smoothed frame, from the cache if it was used lately."""
        if number not in self._cache:
            while len(self._cache) > max(DEPTH.plane_gaps):
                self._cache.pop(next(iter(self._cache)))
            self._cache[number] = self._smooth(number)
        return self._cache[number]

    def _smooth(self, number: int) -> _SmoothFrame:
        image = cv2.GaussianBlur(self._grey(number), (0, 0), DEPTH.homography_smoothing)
        slopes = [
            cv2.Sobel(image, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1))
        ]
        stride = max(1, round(np.sqrt(image.size / DEPTH.homography_samples)))
        side = 2 * DEPTH.homography_border + 1  # smoothing mixes pixels with their neighbours
        used = cv2.erode(self._used_pixels(number).astype(np.uint8), np.ones((side, side))) > 0
        rows, columns = np.nonzero(used[::stride, ::stride])
        rows, columns = rows * stride, columns * stride
        cx, cy = self._camera.center_for(*image.shape)
        rays = np.stack([columns - cx, rows - cy, np.full(len(rows), self._camera.focal)])
        return _SmoothFrame(
            images=(image, *slopes),
            used=used,
            rays=rays / self._camera.focal,
            grey=image[rows, columns].astype(np.float64),
        )

    def _linearise(
        self, first: _SmoothFrame, second: _SmoothFrame, matrix: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the normal equations of a step, (8, 8) and (8,), or None: too few samples."""
        focal, (height, width) = self._camera.focal, second.images[0].shape
        center = self._camera.center_for(height, width)
        moved = matrix @ first.rays
        depth = np.where(moved[2] > 0, moved[2], np.inf)
        position = moved[:2] / depth
        pixel = focal * position + np.reshape(center, (2, 1))
        last = np.array([[width], [height]]) - 1 - DEPTH.homography_border
        is_inside = ((pixel >= DEPTH.homography_border) & (pixel <= last)).all(axis=0)
        is_inside &= np.isfinite(depth)
        columns, rows = np.rint(np.where(is_inside, pixel, 0)).astype(np.intp)
        is_inside &= second.used[rows, columns]
        if is_inside.sum() < max(DEPTH.min_homography_samples, DEPTH.min_overlap * len(is_inside)):
            return None
        rays, grey = first.rays[:, is_inside], first.grey[is_inside]
        x, y = position[:, is_inside]
        warped, slope_x, slope_y = _sample(second.images, pixel[:, is_inside])
        factor = focal / depth[is_inside]
        slope_x, slope_y = slope_x * factor, slope_y * factor
        along = slope_x * x + slope_y * y
        jacobian = np.empty((9, len(grey)))
        for k, (a, b, c) in enumerate(matrix.T):  # an entry of D moves a ray along a column
            jacobian[3 * k : 3 * k + 3] = (a * slope_x + b * slope_y - c * along) * rays
        return _make_equations(jacobian[:8], warped - grey, grey)


def _make_equations(
    jacobian: np.ndarray,  # (8, N)
    residual: np.ndarray,  # (N,): grey levels
    grey: np.ndarray,  # (N,): grey levels of the first frame
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the robust normal equations, after a change of brightness was eliminated.

    None is returned if the image does not determine a homography.
    """
    brightness = np.stack([grey / MAX_GREY, np.ones(len(grey))])
    # An image of one grey level shows no factor: the pseudo-inverse leaves it at 1.
    light = np.linalg.pinv(brightness @ brightness.T) @ (brightness @ residual)
    residual = residual - light @ brightness
    deviation = max(MAD_TO_DEVIATION * float(np.median(np.abs(residual))), DEPTH.min_grey_deviation)
    weight = 1 / (1 + (residual / (DEPTH.outlier_scale * deviation)) ** 2) / deviation**2
    weighted, weighted_brightness = jacobian * weight, brightness * weight
    information, gradient = weighted @ jacobian.T, weighted @ residual
    coupling = weighted @ brightness.T
    change = np.linalg.pinv(weighted_brightness @ brightness.T) @ np.column_stack(
        [coupling.T, weighted_brightness @ residual]
    )
    information -= coupling @ change[:, :8]
    gradient -= coupling @ change[:, 8]
    strengths = np.linalg.eigvalsh(information)
    if not strengths[0] > DEPTH.min_homography_strength * strengths[-1]:
        return None
    return information, gradient


def _sample(images: tuple[np.ndarray, ...], pixels: np.ndarray) -> list[np.ndarray]:
    """Return images at positions, (2, N) px, by cubic interpolation."""
    count = pixels.shape[1]
    # OpenCV's remap does not accept long rows.
    padded = np.zeros((2, -(-count // SAMPLE_ROW) * SAMPLE_ROW), np.float32)
    padded[:, :count] = pixels
    x, y = padded.reshape(2, -1, SAMPLE_ROW)
    return [
        cv2.remap(image, x, y, cv2.INTER_CUBIC).ravel()[:count].astype(np.float64)
        for image in images
    ]


def _displacement(first: np.ndarray, second: np.ndarray, rays: np.ndarray) -> float:
    """Return the median distance of points moved by two homographies, in focal lengths."""
    positions = [(moved := matrix @ rays)[:2] / moved[2] for matrix in (first, second)]
    return float(np.median(np.hypot(*(positions[1] - positions[0]))))
