"""What the images of a sequence show apart from motion: noise, texture, light, fixed patterns."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

from tisfm.reconstruction.causes.settings import CAUSES

# Immerkær's operator: the difference of two Laplacians, which removes edges and gradients.
_NOISE_KERNEL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_NOISE_GAIN = 6.0  # standard deviation of its response to noise of deviation 1


@dataclass(frozen=True, kw_only=True)
class ImageMeasures:
    """Measures of frames; medians over the frames, or over pairs of them.

    Each is measured when it is needed first.
    """

    # Frames and the next frames, (h, w) float32, as `shrink_for_flow` returns them: what hides
    # motion from the tracks is seen in them. At least one, in order.
    pairs: Sequence[tuple[np.ndarray, np.ndarray]]
    # Of each pair, (N, 2) px in both frames: points that the frames share. Give none if few points
    # are tracked: those follow what hides the motion. None for a pair at a cut, whose light is not
    # compared.
    points: Sequence[tuple[np.ndarray, np.ndarray] | None]

    @cached_property
    def brightness(self) -> float:
        """The mean grey level."""
        return _take_median([float(frame.mean()) for frame in self._frames])

    @cached_property
    def contrast(self) -> float:
        """The standard deviation of grey levels."""
        return _take_median([float(frame.std()) for frame in self._frames])

    @cached_property
    def noise(self) -> float:
        """The standard deviation of noise, grey levels."""
        return _take_median(self._noise_levels)

    @cached_property
    def sharpness(self) -> float:
        """The share of the contrast that a small blur removes."""
        return _take_median([measure_sharpness(frame) for frame in self._frames])

    @cached_property
    def texture(self) -> float:
        """The share of the blocks of a frame that have texture above the noise."""
        return _take_median(list(map(measure_textured_share, self._frames, self._noise_levels)))

    @cached_property
    def light_change(self) -> float:
        """The change of light between neighbouring frames: the logarithm of the ratio."""
        return _take_median(
            [
                compare_light_of_points(*pair, *points)
                if len(points[0]) >= CAUSES.min_compared_tracks
                else compare_light_of_rows(*pair)
                for pair, points in zip(self.pairs, self.points, strict=True)
                if points is not None
            ]
        )

    @cached_property
    def fixed_correlation(self) -> float:
        """The correlation of fine details at the same pixel in frames apart.

        It is 1 for a pattern that is fixed on the sensor.
        """
        return _take_median([correlate_details(*pair) for pair in self._frames_apart])

    @cached_property
    def coarse_correlation(self) -> float:
        """The same of coarse structure: 1 for a camera at rest."""
        return _take_median([correlate_coarse(*pair) for pair in self._frames_apart])

    @cached_property
    def repetition(self) -> float:
        """The highest correlation of a frame with itself, moved by more than a few pixels."""
        return _take_median([measure_repetition(frame) for frame in self._frames])

    @property
    def structure(self) -> float:
        """The standard deviation of grey levels without the noise."""
        return float(np.sqrt(max(self.contrast**2 - self.noise**2, 0.0)))

    @property
    def _frames(self) -> list[np.ndarray]:
        return [before for before, _ in self.pairs]

    @property
    def _frames_apart(self) -> Sequence[tuple[np.ndarray, np.ndarray]]:
        frames = self._frames
        return list(zip(frames, frames[max(1, len(frames) // 2) :], strict=False)) or self.pairs[:1]

    @cached_property
    def _noise_levels(self) -> list[float]:
        return [measure_noise(frame) for frame in self._frames]


def measure_noise(grey: np.ndarray) -> float:
    """Return the standard deviation of the noise of a frame, (H, W), in grey levels.

    Of the blocks of the frame, those with the least response count: others have texture.

    References
    ----------
    Immerkær, "Fast noise variance estimation", CVIU 1996, doi 10.1006/cviu.1996.0060.
    """
    blocks = _split_blocks(_extract_details(grey))
    if not blocks.size:
        return float(_extract_details(grey).std()) / _NOISE_GAIN
    deviations = np.sqrt((blocks**2).mean(axis=(1, 3))) / _NOISE_GAIN
    return float(np.quantile(deviations, CAUSES.noise_quantile))


def measure_textured_share(grey: np.ndarray, noise: float) -> float:
    """Return the share of the blocks of a frame, (H, W), with texture above the noise.

    `noise` is the standard deviation of the noise, grey levels.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), CAUSES.detail_blur)
    blocks = _split_blocks(smooth)
    limit = max(
        CAUSES.min_block_texture, CAUSES.min_texture_to_noise * CAUSES.blurred_noise * noise
    )
    return float((blocks.std(axis=(1, 3)) > limit).mean()) if blocks.size else 0.0


def measure_sharpness(grey: np.ndarray) -> float:
    """Return the share of the contrast of a frame, (H, W), that a small blur removes."""
    values = grey.astype(np.float32)
    fine = values - cv2.GaussianBlur(values, (0, 0), CAUSES.sharp_blur)
    return float(fine.std() / max(float(values.std()), CAUSES.min_deviation))


def compare_light_of_rows(before: np.ndarray, after: np.ndarray) -> float:
    """Return the change of light from a frame to the next one, both (H, W).

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


def compare_light_of_points(
    # before, after: (H, W)
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


def correlate_details(first: np.ndarray, second: np.ndarray) -> float:
    """Return the correlation of fine details at the same pixel of two frames, (H, W)."""
    details = [_extract_details(frame) for frame in (first, second)]
    deviations = [float(detail.std()) for detail in details]
    if min(deviations) == 0:
        return 0.0
    return float((details[0] * details[1]).mean() / (deviations[0] * deviations[1]))


def correlate_coarse(first: np.ndarray, second: np.ndarray) -> float:
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


def measure_repetition(grey: np.ndarray) -> float:
    """Return the highest correlation of a frame, (H, W), with itself, moved.

    Moves of at least `min_repetition_distance` px, and of at most `max_repetition_move` of the
    frame.
    """
    height, width = grey.shape
    values = grey.astype(np.float32)
    values -= cv2.GaussianBlur(values, (0, 0), CAUSES.repetition_blur)
    dy, dx = (int(CAUSES.max_repetition_move * side) for side in (height, width))
    size = next_fast_len(height + dy, real=True), next_fast_len(width + dx, real=True)
    correlation = irfft2(np.abs(rfft2(values, size)) ** 2, size)
    window = np.roll(correlation, (dy, dx), (0, 1))[: 2 * dy + 1, : 2 * dx + 1]
    y, x = np.mgrid[-dy : dy + 1, -dx : dx + 1]
    window = window / ((height - np.abs(y)) * (width - np.abs(x)))  # the mean over the overlap
    variance = float(window[dy, dx])
    is_far = np.hypot(y, x) >= CAUSES.min_repetition_distance
    if variance < CAUSES.min_repetition_variance or not is_far.any():
        return 0.0
    return float(window[is_far].max() / variance)


def _extract_details(grey: np.ndarray) -> np.ndarray:
    response = cv2.filter2D(grey.astype(np.float32), -1, _NOISE_KERNEL)
    return np.asarray(response[1:-1, 1:-1])


def _split_blocks(values: np.ndarray) -> np.ndarray:
    """Return the square blocks of an image, (rows, side, columns, side)."""
    side = CAUSES.noise_block
    rows, columns = values.shape[0] // side, values.shape[1] // side
    return values[: rows * side, : columns * side].reshape(rows, side, columns, side)


def _take_median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else 0.0
