"""Rendering: the frames of a scene, with depth, motion, flow and visibility."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.camera import Camera, check_pinhole
from tisfm.checks import Floats, check_finite, check_whole_numbers
from tisfm.errors import InputError, InputTypeError
from tisfm.rigid import rigid_motion, rigid_twist

from .geometry import Box, ObjectView, Plane

CHUNK = 1 << 15
"""Number of rays that are cast at once: the temporary arrays fit into the cache."""

# Rays (x̂, ŷ, 1), (3, n), and the depth and the label of the nearest object along each ray, (n,).
Band = tuple[Floats, Floats, NDArray[np.int32]]


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticPair:
    """Two frames of a scene and the truth at the pixel centres of frame 0.

    Attributes
    ----------
    frame0, frame1 : ndarray, shape (H, W), uint8 or float32
        Grey levels on the 8-bit scale; float32 grey levels are not rounded.
    camera : Camera
        The camera of both frames.
    depth : ndarray, shape (H, W), float64
        Z in frame 0.
    flow : ndarray, shape (H, W, 2), float64
        Displacement (u, v), px: projection of P1 = R P0 + t minus the pixel position; NaN if P1 is
        not in front of the camera.
    tau, omega : ndarray, shape (3, H, W), float64
        T/Z, 1/frame, and ω, rad/frame: the twist of the object at each pixel.
    labels : ndarray, shape (H, W), int32
        Index of the object at each pixel.
    motions : ndarray, shape (K, 6), float64
        Twist (T, ω) of each object, by label.
    visible : ndarray, shape (H, W), bool
        Whether the same point is visible in frame 1: it projects between the centres of the border
        pixels, and no other surface hides it.
    textured : ndarray, shape (H, W), bool
        Whether the surface at the pixel has a texture, rather than a single grey level.

    Examples
    --------
    >>> from tisfm.scenes import two_blocks
    >>> pair = two_blocks(48, 64)
    >>> pair.frame1.shape, pair.tau.shape, pair.omega.shape, pair.visible.dtype
    ((48, 64), (3, 48, 64), (3, 48, 64), dtype('bool'))
    >>> bool((pair.inverse_depth * pair.depth).round(6).all())
    True
    """

    frame0: NDArray
    frame1: NDArray
    camera: Camera
    depth: Floats
    flow: Floats
    tau: Floats
    omega: Floats
    labels: NDArray[np.int32]
    motions: Floats
    visible: NDArray[np.bool_]
    textured: NDArray[np.bool_]

    @property
    def inverse_depth(self) -> Floats:
        """1/Z of frame 0, shape (H, W), float64."""
        return 1 / self.depth


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Objects in front of a camera, at two instants one frame apart.

    Parameters
    ----------
    objects : sequence of Plane or Box
        The objects; the index of an object is its label. Together they must cover the image, for
        instance by a background plane.
    camera : Camera
        Focal length and principal point, px.
    height, width : int
        Size of the frames, px.

    Raises
    ------
    TypeError
        If an object is neither a Plane nor a Box.
    ValueError
        If there is no object, the size is not positive, or the camera has distortion.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import Plane, Scene, Texture
    >>> wall = Plane(texture=Texture(wavelength=0.5), point=(0, 0, 5), motion=(-0.1, 0, 0, 0, 0, 0))
    >>> scene = Scene(objects=[wall], camera=tisfm.Camera(focal=64.0), height=48, width=64)
    >>> pair = scene.render()
    >>> [round(float(number), 3) for number in pair.flow[24, 32]]  # f T / Z, px
    [-1.28, 0.0]
    """

    objects: Sequence[Plane | Box]
    camera: Camera
    height: int
    width: int

    def __post_init__(self) -> None:
        check_whole_numbers(1, height=self.height, width=self.width)
        check_pinhole(self.camera, "scenes are rendered by a pinhole")
        object.__setattr__(self, "objects", tuple(self.objects))
        if not self.objects:
            raise InputError("objects is empty: expected at least a background Plane")
        for index, item in enumerate(self.objects):
            if not isinstance(item, Plane | Box):
                type_name = type(item).__name__
                raise InputTypeError(
                    f"objects[{index}] is a {type_name}: expected a Plane or a Box"
                )

    def render(self, *, samples: int = 3, dtype: str = "uint8") -> SyntheticPair:
        """Cast the rays of both frames and compute the ground truth.

        Parameters
        ----------
        samples : int, default 3
            Rays per pixel side: a pixel is the mean of samples² rays. The time of rendering is
            proportional to samples².
        dtype : {"uint8", "float32"}
            Type of the frames; float32 keeps the fractions of a grey level.

        Returns
        -------
        SyntheticPair
            The frames and the truth. The same scene gives the same pair every time.

        Raises
        ------
        ValueError
            If an option is not valid, or some ray misses all objects.
        """
        check_whole_numbers(1, samples=samples)
        check_dtype(dtype)
        views0 = [ObjectView(item, np.eye(3), np.zeros(3)) for item in self.objects]
        views1 = [ObjectView(item, *rigid_motion(item.motion)) for item in self.objects]
        frames = [self._cast_frame(views, samples) for views in (views0, views1)]
        if dtype == "uint8":
            frames = [np.rint(frame).astype(np.uint8) for frame in frames]
        bands = [
            self._truth_of_band(views0, views1, band)
            for band in self._cast_bands(views0, np.zeros((1, 2)))
        ]
        depth, labels, u, v, visible, textured = (
            np.concatenate(rows).reshape(self.height, self.width)
            for rows in zip(*bands, strict=True)
        )
        motions = np.array([item.motion for item in self.objects])
        twist = np.moveaxis(motions[labels], -1, 0)
        return SyntheticPair(
            frame0=frames[0],
            frame1=frames[1],
            camera=self.camera,
            depth=depth,
            flow=np.stack([u, v], axis=-1),
            tau=twist[:3] / depth,
            omega=twist[3:].copy(),
            labels=labels,
            motions=motions,
            visible=visible,
            textured=textured,
        )

    def render_view(self, pose: ArrayLike, *, samples: int = 3) -> tuple[NDArray, Floats]:
        """Render one view of the scene at the first instant.

        Parameters
        ----------
        pose : array_like, shape (4, 4)
            Camera to world; the axes of the world are the camera axes of frame 0.
        samples : int, default 3
            As in `render`.

        Returns
        -------
        frame : (H, W) float32
        depth : (H, W) float64
            Z in the axes of the view.

        Raises
        ------
        ValueError
            If the pose is not a rigid motion, or some ray misses all objects.
        """
        frame, depth, _ = self.render_view_with_labels(pose, samples=samples)
        return frame, depth

    def render_view_with_labels(
        self, pose: ArrayLike, *, samples: int = 3
    ) -> tuple[NDArray, Floats, NDArray[np.int32]]:
        """Return frame and depth of a view as `render_view` does, and the labels, (H, W)."""
        depth, labels = self.depth_and_labels(pose)
        return self.render_frame(pose, samples=samples), depth, labels

    def render_frame(self, pose: ArrayLike, *, samples: int = 3) -> NDArray:
        """Return only the frame of a view, (H, W) float32, as `render_view` does."""
        check_whole_numbers(1, samples=samples)
        return self._cast_frame(self._views_from(pose), samples)

    def depth_and_labels(self, pose: ArrayLike) -> tuple[Floats, NDArray[np.int32]]:
        """Return only the depth and the labels of a view, (H, W)."""
        views = self._views_from(pose)
        bands = [(depth, labels) for _, depth, labels in self._cast_bands(views, np.zeros((1, 2)))]
        depth, labels = (
            np.concatenate(rows).reshape(self.height, self.width)
            for rows in zip(*bands, strict=True)
        )
        return depth, labels

    def _views_from(self, pose: ArrayLike) -> list[ObjectView]:
        matrix = check_finite(pose, (4, 4), "pose")
        to_camera = matrix[:3, :3].T
        if (
            not np.allclose(to_camera @ to_camera.T, np.eye(3), atol=1e-6)
            or np.linalg.det(to_camera) < 0
        ):
            raise InputError(f"pose is {matrix.tolist()}: expected a rotation and a translation")
        rotation, translation = rigid_motion(rigid_twist(to_camera, -to_camera @ matrix[:3, 3]))
        return [ObjectView(item, rotation, translation) for item in self.objects]

    def _cast_bands(self, views: list[ObjectView], offsets: Floats) -> Iterator[Band]:
        """Cast rays at offsets, (k, 2), px, from each pixel centre; yield bands of rows."""
        cx, cy = self.camera.center_for(self.height, self.width)
        x = np.arange(self.width) - cx
        rows = max(1, CHUNK // (self.width * len(offsets)))
        for top in range(0, self.height, rows):
            y = np.arange(top, min(top + rows, self.height)) - cy
            grid = np.ones((3, len(offsets), y.size, x.size))
            grid[0] = (x + offsets[:, 0, None, None]) / self.camera.focal
            grid[1] = (y[:, None] + offsets[:, 1, None, None]) / self.camera.focal
            rays = grid.reshape(3, -1)
            depth, labels = _nearest_object(views, rays)
            if not np.isfinite(depth).all():
                raise InputError(
                    f"objects leave {np.mean(~np.isfinite(depth)):.0%} of a band of rays without "
                    "a surface: expected a background Plane to cover the image"
                )
            yield rays, depth, labels

    def _cast_frame(self, views: list[ObjectView], samples: int) -> NDArray:
        """Render one frame, (H, W) float32."""
        bands = []
        for rays, depth, labels in self._cast_bands(views, _sample_offsets(samples)):
            grey = np.empty(depth.size, np.float32)
            for label in np.unique(labels):
                indices = np.flatnonzero(labels == label)
                grey[indices] = views[label].grey(
                    rays[:, indices], depth[indices], self.camera.focal
                )
            bands.append(grey.reshape(samples**2, -1, self.width).mean(axis=0))
        return np.concatenate(bands)

    def _truth_of_band(
        self, views0: list[ObjectView], views1: list[ObjectView], band: Band
    ) -> tuple[NDArray, ...]:
        """Return the truth of the pixels of frame 0: depth, labels, u, v, visible, textured."""
        rays, depth, labels = band
        points1 = np.empty_like(rays)
        textured = np.empty(labels.shape, bool)
        for label, view in enumerate(views1):
            mask = labels == label
            textured[mask] = ~views0[label].is_plain(rays[:, mask], depth[mask])
            points1[:, mask] = (
                view.rotation @ (rays[:, mask] * depth[mask]) + view.translation[:, None]
            )
        is_in_front = points1[2] > 0
        rays1 = points1 / np.where(is_in_front, points1[2], np.nan)
        u, v, _ = self.camera.focal * (rays1 - rays)
        cx, cy = self.camera.center_for(self.height, self.width)
        x, y = self.camera.focal * rays1[0] + cx, self.camera.focal * rays1[1] + cy
        is_inside = (
            is_in_front & (x >= 0) & (x <= self.width - 1) & (y >= 0) & (y <= self.height - 1)
        )
        nearest_depth, _ = _nearest_object(views1, np.where(is_inside, rays1, rays))
        # The ray also hits the point itself, at its depth up to rounding.
        visible = is_inside & (nearest_depth > points1[2] * (1 - 1e-6))
        return depth, labels, u, v, visible, textured


def check_dtype(dtype: str) -> None:
    """Raise ValueError unless the name of a frame type is known."""
    if dtype not in ("uint8", "float32"):
        raise InputError(f"dtype is {dtype!r}: expected 'uint8' or 'float32'")


def _nearest_object(views: list[ObjectView], rays: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Return the depth and the label of the nearest object along rays."""
    nearest_depth = np.full(rays.shape[1], np.inf)
    labels = np.zeros(rays.shape[1], np.int32)
    first, last = rays[:2].min(axis=1), rays[:2].max(axis=1)
    for label, view in enumerate(views):
        if not view.misses_all(first, last):
            depth = view.hit_depth(rays)
            is_closer = depth < nearest_depth
            np.copyto(nearest_depth, depth, where=is_closer)
            labels[is_closer] = label
    return nearest_depth, labels


def _sample_offsets(samples: int) -> Floats:
    """Return the sample positions of a pixel, px from its centre, (samples², 2).

    The square grid is rotated slightly: all samples differ in column and in row, so that an edge
    along a pixel axis gets samples² + 1 grey levels.
    """
    column, row = (index.ravel() for index in np.mgrid[:samples, :samples])
    x = (column + (row + 0.5) / samples) / samples
    y = (row + (samples - column - 0.5) / samples) / samples
    return np.stack([x, y], axis=-1) - 0.5
