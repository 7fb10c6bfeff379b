"""Small patches of a frame whose points are known, and how another frame shows them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.joints.settings import JOINTS


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """A frame at one level of a pyramid; pixel (x, y) is pixel (x, y) · `factor` of the frame."""

    image: np.ndarray  # (h, w) float32: grey levels
    gradient: tuple[np.ndarray, np.ndarray]  # along x and along y, grey levels per pixel
    factor: float


def build_pyramid(grey: np.ndarray) -> list[Level]:
    """Return the levels of a frame, (H, W) uint8; the finest level first."""
    levels, image, factor = [], grey.astype(np.float32), 1.0
    while True:
        gradient = tuple(cv2.Scharr(image, cv2.CV_32F, dx, 1 - dx, scale=1 / 32) for dx in (1, 0))
        levels.append(Level(image=image, gradient=(gradient[0], gradient[1]), factor=factor))
        if max(image.shape) < 2 * JOINTS.min_level_side:
            return levels
        image, factor = np.asarray(cv2.pyrDown(image), np.float32), 2 * factor


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """Patches of a frame at one level; every pixel of a patch has the depth of its point."""

    grey: np.ndarray  # (N, K) float64: grey levels, less the mean of the patch
    points: np.ndarray  # (N, K, 3) float64: points of the pixels, in the world
    sources: np.ndarray  # (N,) int: numbers of the frames that the patches were cut from

    @classmethod
    def cut(
        cls,
        level: Level,
        camera: Camera,  # pinhole camera of the frame
        shape: tuple[int, int],  # height and width of the frame, px
        pose: np.ndarray,  # (4, 4): camera to world
        places: np.ndarray,  # (N, 2): positions of points in the frame, px
        depths: np.ndarray,  # (N,): their depths
        source: int,  # number of the frame
    ) -> "Patches":
        """Return the patches around points.

        Patches beyond the border or without contrast are left out.
        """
        sides = np.arange(-JOINTS.patch_radius, JOINTS.patch_radius + 1)
        offsets = np.stack(np.meshgrid(sides, sides), axis=-1).reshape(-1, 2)
        pixels = places[:, None] / level.factor + offsets
        grey, is_inside = sample(level.image, pixels)
        grey = grey - grey.mean(axis=1, keepdims=True)
        is_used = is_inside & (grey.std(axis=1) > JOINTS.min_contrast)
        rays = (pixels * level.factor - camera.center_for(*shape)) / camera.focal
        local = np.dstack([rays, np.ones(rays.shape[:2])]) * depths[:, None, None]
        points = local @ pose[:3, :3].T + pose[:3, 3]
        sources = np.full(np.count_nonzero(is_used), source)
        return cls(grey=grey[is_used], points=points[is_used], sources=sources)

    @classmethod
    def join(cls, parts: Sequence["Patches"]) -> "Patches":
        """Return the patches of all parts."""
        return cls(
            grey=np.concatenate([part.grey for part in parts]),
            points=np.concatenate([part.points for part in parts]),
            sources=np.concatenate([part.sources for part in parts]),
        )

    def select(self, is_selected: np.ndarray) -> "Patches":
        """Return some of the patches."""
        return Patches(
            grey=self.grey[is_selected],
            points=self.points[is_selected],
            sources=self.sources[is_selected],
        )

    def __len__(self) -> int:
        return len(self.grey)

    def transformed(self, similarity: np.ndarray) -> "Patches":
        """Return the patches with transformed points."""
        points = self.points @ similarity[:3, :3].T + similarity[:3, 3]
        return replace(self, points=points)


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Patches as another frame shows them; N of them are visible in it."""

    visible: np.ndarray  # (N,) int: numbers of the patches
    shown: np.ndarray  # (N, K): grey levels of the frame, less the mean, in the patches' contrast
    reference: np.ndarray  # (N, K): grey levels of the patches
    # (N, K, 3): derivatives of `shown` by the points; None if they were not asked for
    derivative: np.ndarray | None

    @property
    def correlation(self) -> np.ndarray:
        """Normalised cross-correlation of each visible patch, (N,)."""
        product = (self.shown * self.reference).sum(axis=1)
        norms = np.linalg.norm(self.shown, axis=1) * np.linalg.norm(self.reference, axis=1)
        return np.asarray(product / np.maximum(norms, 1e-9))


def compare(
    patches: Patches,
    level: Level,  # of the other frame
    camera: Camera,
    shape: tuple[int, int],
    to_camera: np.ndarray,  # (3, 4): from the world of the patches to the camera, up to a scale
    *,
    with_derivative: bool = False,
) -> Comparison:
    """Return how a frame shows patches."""
    matrix = to_camera[:, :3]
    local = patches.points @ matrix.T + to_camera[:, 3]
    depth = local[..., 2]
    in_front = (depth > 1e-9).all(axis=1)
    safe = np.where(depth > 1e-9, depth, 1.0)
    slopes = local[..., :2] / safe[..., None]
    pixels = (slopes * camera.focal + camera.center_for(*shape)) / level.factor
    shown, is_inside = sample(level.image, pixels)
    visible = np.flatnonzero(is_inside & in_front)
    shown = shown[visible]
    shown = shown - shown.mean(axis=1, keepdims=True)
    reference = patches.grey[visible]
    gain = _find_gain(shown, reference)
    derivative = None
    if with_derivative:
        per_pixel = camera.focal / level.factor / safe[visible]
        along_x, along_y = (sample(part, pixels[visible])[0] * per_pixel for part in level.gradient)
        along_z = -(along_x * slopes[visible, :, 0] + along_y * slopes[visible, :, 1])
        derivative = gain * np.stack([along_x, along_y, along_z], axis=-1) @ matrix
    return Comparison(
        visible=visible, shown=gain * shown, reference=reference, derivative=derivative
    )


def _find_gain(shown: np.ndarray, reference: np.ndarray) -> float:
    """Return the factor that gives the grey levels of a frame the contrast of patches."""
    ratios = np.linalg.norm(reference, axis=1) / np.maximum(np.linalg.norm(shown, axis=1), 1e-6)
    return float(np.clip(np.median(ratios), 0.5, 2.0)) if len(ratios) else 1.0


def sample(image: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values of an image at positions (N, K, 2), and whether all K are inside, (N,)."""
    if not pixels.size:
        return np.zeros(pixels.shape[:-1]), np.zeros(len(pixels), bool)
    x, y = pixels[..., 0].astype(np.float32), pixels[..., 1].astype(np.float32)
    height, width = image.shape
    is_inside = ((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)).all(axis=1)
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return values.astype(np.float64), is_inside
