"""Inverse depth of matched planes; it is reliable where matches in both directions agree."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.rigid.patch_match import MAX_SLOPE, PlaneSearch, plane_disagreement
from tisfm.kernels.rigid.windows import MAX_GREY, UNTEXTURED
from tisfm.motion.epipolar_fit import MAD_TO_DEVIATION
from tisfm.motion.settings import DEPTH
from tisfm.solver.image_pyramid import ImagePyramid

MAX_UNSAMPLED_PIXELS = 2**16  # in a larger frame, every 16th pixel is sampled for percentiles
REGION_UNITS = 16  # units per px of displacements for cv2.filterSpeckles, which takes integers


@dataclass(frozen=True, kw_only=True)
class MatchedPlanes:
    """A plane at every pixel of a level, and the pixels whose planes are reliable."""

    level: int
    inverse_depth: np.ndarray  # (h, w) float32: D, px/frame of the level
    cost: np.ndarray  # (h, w) float32: one minus the correlation of the pixel's window
    is_reliable: np.ndarray  # (h, w) bool


def matched_planes(
    pyramid: ImagePyramid,
    # (3, 4) array: R and t, as from `tisfm.motion.rigid_depth.scaled_translations`
    motion: np.ndarray,
) -> MatchedPlanes:
    """Match planes of frame 0 in frame 1 and of frame 1 in frame 0, and compare the results."""
    levels = _search_levels(pyramid)
    finest = levels[-1]
    rotation, translation = motion[:, :3], motion[:, 3]
    inverse_motion = np.column_stack([rotation.T, -rotation.T @ translation])
    frames0, frames1 = (
        [frames[level] for level in levels] for frames in (pyramid.frames0, pyramid.frames1)
    )
    min_grey, gain = grey_scale(frames0[-1], frames1[-1])
    valid = pyramid.valid_on(finest)
    noise = gain * max(
        noise_deviation(frames[-1], valid=None if valid is None else valid[k])
        for k, frames in enumerate((frames0, frames1))
    )
    frames0, frames1 = (
        [np.clip(gain * (frame - min_grey), 0, MAX_GREY) for frame in frames]
        for frames in (frames0, frames1)
    )
    scales = [pyramid.scales[level] / pyramid.scales[finest] for level in levels]
    search = _Search(
        cameras=[pyramid.cameras[level] for level in levels], scales=scales, noise=noise
    )
    forward = search.run(frames0, frames1, motion, seed=0)
    backward = search.run(frames1, frames0, inverse_motion, seed=1)
    if valid is not None:
        for planes, mask in zip((forward, backward), valid, strict=True):
            planes[~mask, 3] = UNTEXTURED
    disagreements = np.empty(forward.shape[:2], np.float32)
    camera = pyramid.cameras[finest]
    center = camera.center_for(*pyramid.frames0[finest].shape)
    plane_disagreement(forward, backward, motion, disagreements, center=center, focal=camera.focal)
    depth, cost = np.ascontiguousarray(forward[..., 0]), np.ascontiguousarray(forward[..., 3])
    is_reliable = large_regions(
        depth,
        (cost < DEPTH.max_plane_cost)
        & (disagreements < DEPTH.max_plane_disagreement)
        & (depth > 0),
    )
    return MatchedPlanes(level=finest, inverse_depth=depth, cost=cost, is_reliable=is_reliable)


@dataclass(frozen=True, kw_only=True)
class _Search:
    """A search from coarse to fine; both directions use the same search."""

    cameras: list[Camera]  # camera of each level, the coarsest first
    scales: list[float]  # sampling density of each level divided by that of the last level
    noise: float  # standard deviation of the noise of the last level, grey levels of 255

    def run(
        self, frames0: list[np.ndarray], frames1: list[np.ndarray], motion: np.ndarray, *, seed: int
    ) -> np.ndarray:
        """Return the planes (h, w, 4) float32 of the last level of `frames0`."""
        planes = None
        max_depth = DEPTH.max_plane_depth * max(frames0[-1].shape)
        for k, (frame0, frame1) in enumerate(zip(frames0, frames1, strict=True)):
            camera, scale = self.cameras[k], self.scales[k]
            height, width = frame0.shape
            if planes is None:
                planes = _random_planes(frame0.shape, camera, scale * max_depth, seed)
            else:
                ratio = scale / self.scales[k - 1]
                planes = cv2.resize(planes, (width, height), interpolation=cv2.INTER_NEAREST)
                planes[..., 0] *= np.float32(ratio)
            search = PlaneSearch(
                frame0,
                frame1,
                motion,
                center=camera.center_for(height, width),
                focal=camera.focal,
                noise=max(self.noise * scale, DEPTH.min_coarse_noise),
                min_variance=DEPTH.min_window_variance,
                min_depth=scale * DEPTH.min_plane_depth,
                max_depth=scale * max_depth,
            )
            search.score(planes)
            rounds = DEPTH.plane_rounds[min(k, len(DEPTH.plane_rounds) - 1)]
            for round_number in range(rounds):
                shrinkage = DEPTH.plane_shrinkage**round_number
                search.improve(
                    planes,
                    draws=DEPTH.plane_draws,
                    spread=DEPTH.plane_spread[min(k, 1)] * shrinkage,
                    tilt=DEPTH.plane_tilt * shrinkage,
                    seed=(seed * len(self.scales) + k) * max(DEPTH.plane_rounds) + round_number,
                )
        assert planes is not None
        return planes


def _search_levels(pyramid: ImagePyramid) -> list[int]:
    """Return the searched levels, the coarsest first, each about half as dense as the next."""
    candidates = [
        k
        for k in range(pyramid.last, pyramid.levels)
        if pyramid.frames0[k].size <= DEPTH.max_plane_pixels
    ]
    finest = min(candidates, default=pyramid.levels - 1)
    step = max(1, round(np.log(0.5) / np.log(pyramid.factor)))
    levels = range(finest, pyramid.levels, step)
    result = [k for k in levels if pyramid.frames0[k].size >= DEPTH.min_plane_pixels] or [finest]
    return result[::-1]


def _random_planes(
    shape: tuple[int, ...], camera: Camera, max_depth: float, seed: int
) -> np.ndarray:
    """Return random planes (h, w, 4) float32."""
    planes = np.random.default_rng(seed).random((*shape, 4), np.float32)
    planes[..., 0] *= max_depth
    planes[..., 1:3] = (2 * planes[..., 1:3] - 1) * planes[..., :1] * (MAX_SLOPE / camera.focal)
    return planes


def large_regions(
    depth: np.ndarray,  # (H, W) float32: D, px/frame; positive
    mask: np.ndarray,  # (H, W) bool
) -> np.ndarray:
    """Return the pixels of a mask in large connected regions with steps of at most 1 px."""
    units = np.where(mask, REGION_UNITS * depth + 1, 0).clip(0, np.iinfo(np.int16).max)
    units = units.astype(np.int16)
    cv2.filterSpeckles(units, 0, DEPTH.min_plane_region, REGION_UNITS)
    return units > 0


def grey_scale(
    # frame0, frame1: (H, W) float32, grey levels
    frame0: np.ndarray,
    frame1: np.ndarray,
) -> tuple[np.float32, np.float32]:
    """Return (low, gain): gain · (frame − low) is in [0, 255] for all but 0.2% of the pixels."""
    low, high = np.percentile(
        np.concatenate([_sample_pixels(frame0), _sample_pixels(frame1)]), DEPTH.grey_percentiles
    )
    margin = DEPTH.grey_margin * (high - low)
    low, high = low - margin, high + margin
    return np.float32(low), np.float32(MAX_GREY / max(high - low, DEPTH.min_noise))


def noise_deviation(
    frame: np.ndarray, *, stride: int = 1, valid: np.ndarray | None = None
) -> float:
    """Return the standard deviation of the noise of a frame, (H, W) float32, in its grey levels.

    A filter mask removes smooth image content. The result is the deviation of the rest in the
    quietest blocks, within bounds. Every `stride`-th block in both directions is used. Blocks with
    pixels outside `valid`, (H, W) bool, are ignored unless all blocks have such pixels.

    References
    ----------
    Immerkær, "Fast noise variance estimation", CVIU 1996, doi 10.1006/cviu.1996.0060 (mask).
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    residual = np.abs(cv2.filter2D(frame, cv2.CV_32F, mask, borderType=cv2.BORDER_REFLECT))
    height, width = (side // DEPTH.noise_block for side in frame.shape)
    if height * width:
        block_residuals = np.median(
            _blocks(residual, height, width)[::stride, :, ::stride], axis=(1, 3)
        )
        if valid is not None:
            is_valid = _blocks(valid, height, width)[::stride, :, ::stride].all(axis=(1, 3))
            block_residuals = block_residuals[is_valid] if is_valid.any() else block_residuals
        quiet_residual = float(np.quantile(block_residuals, DEPTH.quiet_share))
    else:
        quiet_residual = float(np.median(residual))
    low, high = np.percentile(_sample_pixels(frame), DEPTH.grey_percentiles)
    min_noise = float(
        np.clip(DEPTH.min_noise_share * (high - low), DEPTH.min_noise / 100, DEPTH.min_noise)
    )
    return min(max(min_noise, MAD_TO_DEVIATION * quiet_residual), DEPTH.max_noise)


def _blocks(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return `height` × `width` blocks of an image, (height, side, width, side)."""
    return image[: height * DEPTH.noise_block, : width * DEPTH.noise_block].reshape(
        height, DEPTH.noise_block, width, DEPTH.noise_block
    )


def _sample_pixels(frame: np.ndarray) -> np.ndarray:
    """Return the grey levels of a frame, or of every 16th pixel of a large frame."""
    step = 4 if frame.size > MAX_UNSAMPLED_PIXELS else 1
    return frame[::step, ::step].ravel()
