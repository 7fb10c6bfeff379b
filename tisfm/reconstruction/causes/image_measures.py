"""What the images of a sequence show apart from motion: noise, texture, light, fixed patterns."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.reconstruction.causes.settings import CAUSES

# Immerkær's operator: the difference of two Laplacians, which removes edges and gradients.
_NOISE_KERNEL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_NOISE_GAIN = 6.0  # standard deviation of its response to noise of deviation 1


@dataclass(frozen=True, kw_only=True)
class ImageMeasures:
    """Measures of frames; medians over the frames, or over pairs of them."""

    brightness: float  # mean grey level
    contrast: float  # standard deviation of grey levels
    noise: float  # standard deviation of noise, grey levels
    sharpness: float  # share of the contrast that a small blur removes
    texture: float  # share of the blocks of a frame that have texture above the noise
    # change of light between neighbouring frames: the logarithm of the ratio of brightness
    light_change: float
    # correlation of fine details at the same pixel in frames apart: 1 for a pattern that is fixed
    fixed_correlation: float
    coarse_correlation: float  # the same of coarse structure: 1 for a camera at rest
    # highest correlation of a frame with itself, moved by more than a few pixels
    repetition: float

    @property
    def structure(self) -> float:
        """The standard deviation of grey levels without the noise."""
        return float(np.sqrt(max(self.contrast**2 - self.noise**2, 0.0)))


def measure_images(
    pairs: Sequence[tuple[np.ndarray, np.ndarray]],  # frames and the next frames, (H, W) uint8
    # Of each pair, (N, 2) px in both frames: points that the frames share. Give none if few points
    # are tracked: those follow what hides the motion.
    points: Sequence[tuple[np.ndarray, np.ndarray]],
) -> ImageMeasures:
    """Return the measures of pairs of neighbouring frames, in order; at least one."""
    frames = [before for before, _ in pairs]
    half = max(1, len(frames) // 2)
    apart = list(zip(frames, frames[half:], strict=False)) or [pairs[0]]
    noise = [noise_level(frame) for frame in frames]
    return ImageMeasures(
        brightness=_median([float(frame.mean()) for frame in frames]),
        contrast=_median([float(frame.std()) for frame in frames]),
        noise=_median(noise),
        sharpness=_median([sharpness(frame) for frame in frames]),
        texture=_median(
            [textured_share(frame, level) for frame, level in zip(frames, noise, strict=True)]
        ),
        light_change=_median(
            [
                light_change_of_points(*pair, *of_pair)
                if len(of_pair[0]) >= CAUSES.min_compared_tracks
                else light_change_of_rows(*pair)
                for pair, of_pair in zip(pairs, points, strict=True)
            ]
        ),
        fixed_correlation=_median([detail_correlation(*pair) for pair in apart]),
        coarse_correlation=_median([coarse_correlation(*pair) for pair in apart]),
        repetition=_median([repetition(frame) for frame in frames]),
    )


def noise_level(grey: np.ndarray) -> float:
    """Return the standard deviation of the noise of a frame, (H, W) uint8, in grey levels.

    Of the blocks of the frame, those with the least response count: others have texture.

    References
    ----------
    Immerkær, "Fast noise variance estimation", CVIU 1996, doi 10.1006/cviu.1996.0060.
    """
    blocks = _blocks(_details(grey))
    if not blocks.size:
        return float(_details(grey).std()) / _NOISE_GAIN
    deviations = np.sqrt((blocks**2).mean(axis=(1, 3))) / _NOISE_GAIN
    return float(np.quantile(deviations, CAUSES.noise_quantile))


def textured_share(grey: np.ndarray, noise: float) -> float:
    """Return the share of the blocks of a frame, (H, W) uint8, with texture above the noise.

    `noise` is the standard deviation of the noise, grey levels.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), CAUSES.detail_blur)
    blocks = _blocks(smooth)
    limit = max(
        CAUSES.min_block_texture, CAUSES.min_texture_to_noise * CAUSES.blurred_noise * noise
    )
    return float((blocks.std(axis=(1, 3)) > limit).mean()) if blocks.size else 0.0


def sharpness(grey: np.ndarray) -> float:
    """Return the share of the contrast of a frame, (H, W) uint8, that a small blur removes."""
    values = grey.astype(np.float32)
    fine = values - cv2.GaussianBlur(values, (0, 0), CAUSES.sharp_blur)
    return float(fine.std() / max(float(values.std()), 1e-6))


def light_change_of_rows(before: np.ndarray, after: np.ndarray) -> float:
    """Return the change of light from a frame to the next one, both (H, W) uint8.

    The brightness of bands of rows is compared: a change of all light, or bands of light, change
    whole rows. Motion changes the brightness of rows less than that of small blocks.
    """
    rows, columns = CAUSES.light_blocks
    small = [
        cv2.resize(frame, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64) + 1
        for frame in (before, after)
    ]
    change = np.log(small[1] / small[0]).mean(axis=1)
    return float(np.sqrt((change**2).mean()))


def light_change_of_points(
    # before, after: (H, W) uint8
    before: np.ndarray,
    after: np.ndarray,
    # points0, points1: (N, 2) px: positions of the same points in the two frames
    points0: np.ndarray,
    points1: np.ndarray,
) -> float:
    """Return the change of light at points that both frames show."""
    side, brightness = CAUSES.patch_side, []
    for frame, points in ((before, points0), (after, points1)):
        x, y = np.ascontiguousarray(points.T, np.float32)
        means = cv2.blur(frame.astype(np.float32), (side, side))
        brightness.append(cv2.remap(means, x[:, None], y[:, None], cv2.INTER_LINEAR))
    return float(np.median(np.abs(np.log((brightness[1] + 1) / (brightness[0] + 1)))))


def detail_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Return the correlation of fine details at the same pixel of two frames, (H, W) uint8."""
    details = [_details(frame) for frame in (first, second)]
    deviations = [float(detail.std()) for detail in details]
    if min(deviations) == 0:
        return 0.0
    return float((details[0] * details[1]).mean() / (deviations[0] * deviations[1]))


def coarse_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Return the correlation of coarse structure at the same pixel of two frames."""
    smooth = [
        cv2.GaussianBlur(frame.astype(np.float32), (0, 0), CAUSES.coarse_blur)
        for frame in (first, second)
    ]
    centered = [frame - frame.mean() for frame in smooth]
    deviations = [float(frame.std()) for frame in centered]
    if min(deviations) == 0:
        return 1.0
    return float((centered[0] * centered[1]).mean() / (deviations[0] * deviations[1]))


def repetition(grey: np.ndarray) -> float:
    """Return the highest correlation of a frame, (H, W) uint8, with itself, moved.

    Moves of at least `min_repetition_distance` px, and of at most a third of the frame.
    """
    height, width = grey.shape
    values = grey.astype(np.float32)
    values -= cv2.GaussianBlur(values, (0, 0), CAUSES.repetition_blur)
    power = np.abs(np.fft.rfft2(values, (2 * height, 2 * width))) ** 2
    overlap = np.fft.irfft2(
        np.abs(np.fft.rfft2(np.ones_like(values), (2 * height, 2 * width))) ** 2
    )
    correlation = np.fft.irfft2(power) / np.maximum(overlap, 1)
    if correlation[0, 0] < 1:  # grey levels, squared
        return 0.0
    dy, dx = height // 3, width // 3
    window = np.roll(correlation, (dy, dx), (0, 1))[: 2 * dy + 1, : 2 * dx + 1]
    y, x = np.mgrid[-dy : dy + 1, -dx : dx + 1]
    is_far = np.hypot(y, x) >= CAUSES.min_repetition_distance
    return float(window[is_far].max() / correlation[0, 0]) if is_far.any() else 0.0


def _details(grey: np.ndarray) -> np.ndarray:
    response = cv2.filter2D(grey.astype(np.float32), -1, _NOISE_KERNEL)
    return np.asarray(response[1:-1, 1:-1])


def _blocks(values: np.ndarray) -> np.ndarray:
    """Return the square blocks of an image, (rows, side, columns, side)."""
    side = CAUSES.noise_block
    rows, columns = values.shape[0] // side, values.shape[1] // side
    return values[: rows * side, : columns * side].reshape(rows, side, columns, side)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else 0.0
