"""Planes of a keyframe, matched in several frames under known motions, and their reliability."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.rigid.patch_match import MAX_SLOPE
from tisfm.kernels.rigid.view_search import MAX_FRAMES, ViewSearch
from tisfm.kernels.rigid.windows import MAX_GREY, UNTEXTURED
from tisfm.motion.matched_planes import grey_scale, noise_deviation
from tisfm.motion.settings import DEPTH as PAIR_DEPTH
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.geometry.rays import pinhole_rays
from tisfm.solver.image_pyramid import gaussian_pyramid, smooth

# Steps per px in which values of D are compared.
REGION_UNITS = 16
# Seed of the noise that replaces masked pixels of other frames, so that no window matches them.
MASKED_SEED = 7


@dataclass(frozen=True, kw_only=True)
class WindowPlanes:
    """A plane for every cell of a keyframe, and the mask of reliable planes.

    Cells are the pixels of pyramid level `level`, 2^`level` px a side. D is in px of this level:
    the inverse depth times the focal length of the level and the unit length of the window.
    """

    level: int
    inverse_depth: np.ndarray  # (h, w) float32: D, px
    slopes: np.ndarray  # (2, h, w) float32: ∂D/∂x and ∂D/∂y, px per cell
    is_reliable: np.ndarray  # (h, w) bool
    has_texture: np.ndarray  # (h, w) bool: cells whose windows show more than noise


class Window:
    """Image pyramids of a keyframe and other frames, and their motions."""

    def __init__(
        self,
        key: np.ndarray,  # (H, W) float32: grey levels of the keyframe
        others: Sequence[np.ndarray],  # sequence of (H, W) float32: M other frames
        motions: np.ndarray,  # (M, 3, 4) array: R, t from the keyframe to each other frame
        camera: Camera,  # a pinhole
        *,
        cells: int,  # largest number of cells
        key_mask: np.ndarray | None = None,  # (H, W) bool: used pixels; by default all
        # sequence of (H, W) bool or None: used pixels of each other frame
        masks: Sequence[np.ndarray | None] | None = None,
        # H and W of the uncropped frames, if the frames are crops. The density of cells and the
        # search range depend on this size.
        uncropped_shape: tuple[int, int] | None = None,
    ) -> None:
        self.camera, self.size = camera, key.shape
        height, width = uncropped_shape or key.shape
        # A length in the unit of the poses. In the frame with the median parallax, an inverse depth
        # d moves pixels by d · unit · focal length on average, px.
        lengths = sorted(mean_parallax(motion, camera, key.shape) for motion in motions)
        self.unit = lengths[len(lengths) // 2]
        # (M, 3, 4) float64: the given motions, with translations divided by `unit`
        self.motions = np.array(motions, np.float64)
        self.motions[:, :, 3] /= self.unit
        axes_depth = float(np.median([_axes_meeting_depth(motion) for motion in self.motions]))
        # largest D of the search, px of level 0
        self.max_depth = PAIR_DEPTH.max_plane_depth * max(height, width) + camera.focal * axes_depth
        # the finest level on which windows are compared, and the level of the cells
        self.finest_level = self.level = 0
        while height * width >> 2 * self.finest_level > PAIR_DEPTH.max_plane_pixels:
            self.finest_level += 1
        while height * width >> 2 * self.level > cells or self.level < self.finest_level:
            self.level += 1
        max_level = int(np.log2(max(1, min(key.shape))))
        levels = min(self.level + DEPTH.coarser_levels + 1, max_level + 1)
        self.finest_level, self.level = (
            min(self.finest_level, levels - 1),
            min(self.level, levels - 1),
        )
        # list of list of (h, w) float32: by frame, the keyframe first: all levels, the finest first
        self.frames = [
            gaussian_pyramid(smooth(frame, DEPTH.window_smoothing), 0.5, levels)
            for frame in (key, *others)
        ]
        height, width = self.shape
        self.used_cells = np.ones((height, width), bool)  # used cells of the keyframe
        if key_mask is not None:
            self.used_cells = _cell_coverage(key_mask, 2**self.level) > 0.5
            self.used_cells = self.used_cells[:height, :width]
        self._masks = masks or [None] * len(others)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        height, width = self.frames[0][self.finest_level].shape
        stride = 2 ** (self.level - self.finest_level)
        return height // stride, width // stride

    @property
    def best_count(self) -> int:
        """Number of best frames whose mean is the cost: half of all, at most `MAX_FRAMES`."""
        return min((len(self.motions) + 1) // 2, MAX_FRAMES)

    def camera_of(self, level: int) -> Camera:
        """Return the camera of a level."""
        return self.camera.scaled(0.5**level, *self.size) if level else self.camera

    def at_cell_level(self, frame: int) -> np.ndarray:
        """Return a frame, by its number (0 is the keyframe), at the level of the cells."""
        height, width = self.shape
        return np.ascontiguousarray(self.frames[frame][self.level][:height, :width])

    def searches(self) -> list[tuple[int, ViewSearch, int]]:
        """Return (level, search, side of a cell in px of the level) of all searches, in order.

        The side of a cell halves from search to search. If cells are much larger than pixels of the
        finest level, the last two searches have the same cells.
        """
        side = 2 ** (self.level - self.finest_level)
        last = self.level + 1 if side <= DEPTH.max_cell_side else self.level
        coarser = [
            (level, self._search(level, 1), 1)
            for level in range(self.level + DEPTH.coarser_levels, last - 1, -1)
            if min(self.frames[0][level].shape) >= DEPTH.min_coarse_side
        ]
        return [*coarser, (self.finest_level, self.finest_search, side)]

    @cached_property
    def finest_search(self) -> ViewSearch:
        """The search of the cells with windows of the finest level."""
        return self._search(self.finest_level, 2 ** (self.level - self.finest_level))

    def _search(self, level: int, stride: int) -> ViewSearch:
        offset, gain, noise = self._grey_scaling
        noise_factor = 0.5 ** (level - self.finest_level)
        scaled_frames = [gain * (frame[level] - offset) for frame in self.frames]
        frames = [np.clip(frame, 0, MAX_GREY).astype(np.float32) for frame in scaled_frames]
        for levels, mask in zip(frames[1:], self._masks, strict=True):
            if mask is not None:
                _replace_masked(levels, mask)
        camera = self.camera_of(level)
        scale = 0.5**level
        return ViewSearch(
            frames[0],
            frames[1:],
            self.motions,
            frame_count=self.best_count,
            stride=stride,
            center=camera.center_for(*frames[0].shape),
            focal=camera.focal,
            noise=max(noise_factor * noise, PAIR_DEPTH.min_coarse_noise),
            min_variance=PAIR_DEPTH.min_window_variance,
            min_depth=scale * PAIR_DEPTH.min_plane_depth,
            max_depth=scale * self.max_depth,
        )

    @cached_property
    def _grey_scaling(self) -> tuple[np.float32, np.float32, float]:
        """Scaling of grey levels before comparison: an offset, a factor, and the scaled noise."""
        finest_frames = [frame[self.finest_level] for frame in self.frames]
        offset, gain = grey_scale(finest_frames[0], finest_frames[1])
        return offset, gain, float(gain) * max(noise_deviation(frame) for frame in finest_frames)


def mean_parallax(motion: np.ndarray, camera: Camera, shape: tuple[int, ...]) -> float:
    """Return the root mean square of |(t₁ − x̂ t₃, t₂ − ŷ t₃)| over the pixels of an image."""
    columns, rows = (np.linspace(0, length - 1, 32) for length in (shape[1], shape[0]))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = pinhole_rays(points, camera, (shape[0], shape[1]))
    shifts = motion[:2, 3] - rays[:, :2] * motion[2, 3]
    return float(np.sqrt(np.mean((shifts**2).sum(axis=1))))


def _axes_meeting_depth(motion: np.ndarray) -> float:
    """Return the inverse depth at which two optical axes have their smallest distance, or 0."""
    axis, translation = motion[:2, 2], motion[:2, 3]
    square = float(translation @ translation)
    return max(0.0, -float(axis @ translation) / square) if square > 0 else 0.0


def window_planes(window: Window) -> WindowPlanes:
    """Match planes of a keyframe in several frames at once, from coarse cells to fine ones."""
    searches = window.searches()
    level, search, _ = searches[0]
    planes = _random_planes(window, search, level)
    side = 0
    for index, (next_level, search, stride) in enumerate(searches):
        if index:
            if side > stride * 2**next_level:
                planes = _halve_cells(planes)
            planes = _resize_planes(planes, search.shape)
            planes[..., :3] *= np.float32(2.0 ** (level - next_level))
        level, side = next_level, stride * 2**next_level
        search.score(planes)
        for search_round in range(DEPTH.search_rounds[min(index, len(DEPTH.search_rounds) - 1)]):
            shrinkage = DEPTH.draw_shrinkage**search_round
            search.improve(
                planes,
                draws=DEPTH.random_draws,
                spread=(DEPTH.draw_spread[1] if index else DEPTH.draw_spread[0]) * shrinkage,
                tilt=stride * DEPTH.draw_tilt * shrinkage,
                seed=index * max(DEPTH.search_rounds) + search_round,
            )
    planes[..., :3] *= np.float32(0.5 ** (window.level - level))
    depth = np.ascontiguousarray(planes[..., 0])
    is_reliable = (planes[..., 3] < DEPTH.max_cost) & (depth > 0) & window.used_cells
    min_cells = max(1, DEPTH.min_region_area >> 2 * window.level)
    return WindowPlanes(
        level=window.level,
        inverse_depth=depth,
        slopes=np.ascontiguousarray(np.moveaxis(planes[..., 1:3], -1, 0)),
        is_reliable=_remove_small_regions(depth, is_reliable, min_cells),
        has_texture=planes[..., 3] < UNTEXTURED,
    )


def plane_costs(
    window: Window,
    inverse_depth: np.ndarray,  # (h, w) float32: D, px of the cells
    slopes: np.ndarray,  # (2, h, w) float32
) -> np.ndarray:
    """Return the costs of the planes of all cells in every frame, (M, h, w) float32."""
    search = window.finest_search
    planes = np.zeros((*search.shape, 4), np.float32)
    planes[..., 0] = inverse_depth
    planes[..., 1], planes[..., 2] = slopes
    planes *= np.float32(2 ** (window.level - window.finest_level))
    out = np.empty((search.count, *search.shape), np.float32)
    search.write_costs(planes, out)
    return out


def _random_planes(window: Window, search: ViewSearch, level: int) -> np.ndarray:
    """Return random planes, (h, w, 4) float32."""
    planes = np.random.default_rng(0).random((*search.shape, 4), np.float32)
    focal = window.camera_of(level).focal
    planes[..., 0] *= 0.5**level * window.max_depth
    planes[..., 1:3] = (2 * planes[..., 1:3] - 1) * planes[..., :1] * (MAX_SLOPE / focal)
    return planes


def _halve_cells(planes: np.ndarray) -> np.ndarray:
    """Return the planes of cells with half the side."""
    cell_planes = planes.repeat(2, axis=0).repeat(2, axis=1)
    for k, axis in ((1, 1), (2, 0)):
        cell_planes[..., k] *= 0.5
        position = np.where(np.arange(cell_planes.shape[axis]) % 2, 0.5, -0.5).astype(np.float32)
        cell_planes[..., 0] += cell_planes[..., k] * (position if axis else position[:, None])
    return cell_planes


def _resize_planes(planes: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return planes in a size: cropped, or with their last row and column repeated."""
    height, width = shape
    below, right = max(0, height - planes.shape[0]), max(0, width - planes.shape[1])
    if below or right:
        planes = cv2.copyMakeBorder(planes, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(planes[:height, :width])


def _replace_masked(levels: np.ndarray, mask: np.ndarray) -> None:
    """Replace masked-out pixels by noise, in place."""
    size = levels.shape[::-1]
    is_used = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    noise = np.random.default_rng(MASKED_SEED).random(levels.shape, np.float32)
    levels[~is_used] = (MAX_GREY * noise)[~is_used]


def _cell_coverage(mask: np.ndarray, side: int) -> np.ndarray:
    """Return the share of every cell, `side` px wide, that a mask covers, (h, w) float32."""
    height, width = (-(-length // side) for length in mask.shape)
    below, right = side * height - mask.shape[0], side * width - mask.shape[1]
    padded = np.pad(mask.astype(np.float32), ((0, below), (0, right)))
    return cv2.resize(padded, (width, height), interpolation=cv2.INTER_AREA)


def _remove_small_regions(depth: np.ndarray, is_reliable: np.ndarray, min_cells: int) -> np.ndarray:
    """Return the reliable cells in regions of at least `min_cells` cells, (h, w) bool."""
    levels = np.where(is_reliable, REGION_UNITS * depth + 1, 0).clip(0, np.iinfo(np.int16).max)
    levels = levels.astype(np.int16)
    cv2.filterSpeckles(levels, 0, min_cells, REGION_UNITS)
    return levels > 0
