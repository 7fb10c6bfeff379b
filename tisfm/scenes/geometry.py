"""The objects of a scene, planes and boxes: intersections with rays, and grey levels."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats, Vector, check_finite
from tisfm.errors import InputError

from .texture import Texture

# Largest depth of a plane, in scene units: a ray that hits the plane farther away, almost parallel
# to it, counts as a miss.
MAX_PLANE_DEPTH = 1e9
# Margin of the bounds of a box, as a share of its largest coordinate: much larger than rounding
# errors.
BOUNDS_MARGIN = 1e-6
# Factors of the grey level of a box's faces -X +X -Y +Y -Z +Z: the top, -Y, is the lightest face.
FACE_SHADES = (0.66, 0.76, 1.16, 0.6, 0.98, 0.86)
_CORNER_SIGNS = 2.0 * np.indices((2, 2, 2)).reshape(3, 8) - 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Plane:
    """An infinite textured plane, opaque from both sides.

    Parameters
    ----------
    texture : Texture
        Grey levels of the plane.
    point : array_like, shape (3,)
        Any point of the plane in frame 0.
    normal : array_like, shape (3,)
        Normal of the plane, of any length and sign. By default the plane is fronto-parallel.
    motion : array_like, shape (6,)
        Twist (T, ω), length/frame and rad/frame; at rest by default.

    Raises
    ------
    ValueError
        If an array has the wrong shape or is not finite, or the normal is zero.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import Plane, Scene, Texture
    >>> floor = Plane(texture=Texture(wavelength=0.5), point=(0, 1.5, 0), normal=(0, -1, 0))
    >>> wall = Plane(texture=Texture(wavelength=0.5, seed=1), point=(0, 0, 8))
    >>> camera = tisfm.Camera(focal=64.0)
    >>> pair = Scene(objects=[floor, wall], camera=camera, height=48, width=64).render()
    >>> sorted(set(pair.labels.ravel().tolist()))
    [0, 1]
    """

    texture: Texture
    point: Vector = (0.0, 0.0, 10.0)
    normal: Vector = (0.0, 0.0, -1.0)
    motion: Vector = (0.0,) * 6

    def __post_init__(self) -> None:
        normal = check_finite(self.normal, (3,), "normal")
        if not normal.any():
            raise InputError("normal is (0, 0, 0): expected a direction")
        object.__setattr__(self, "normal", normal / np.linalg.norm(normal))
        _freeze(self, point=(3,), normal=(3,), motion=(6,))

    # Arguments of the methods below are in object coordinates, with the origin at the point `point`
    # and the third axis along the normal: points and rays, (3, n); the camera position, (3,).
    # Footprints, (n,), are the size of a pixel at the points, length.
    def _pose(self) -> tuple[Floats, Floats]:
        return self._axes, self.point

    @cached_property
    def _axes(self) -> Floats:
        # The first in-plane axis is the projection of the camera axis with the smallest angle to
        # the plane.
        first = np.eye(3)[np.argmin(np.abs(self.normal))]
        first = first - (first @ self.normal) * self.normal
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first), self.normal], -1)

    @property
    def _corners(self) -> None:
        """A plane has no corners."""

    def _hit_depth(self, camera_position: Floats, ray: Floats) -> Floats:
        depth = -camera_position[2] / ray[2]
        return np.where((depth > 0) & (depth < MAX_PLANE_DEPTH), depth, np.inf)

    def _grey(self, points: Floats, ray: Floats, footprint: Floats) -> NDArray:
        return self.texture._grey(points[0], points[1], footprint / np.sqrt(np.abs(ray[2])))

    def _is_plain(self, points: Floats) -> NDArray[np.bool_]:
        return self.texture._is_plain(points[0], points[1])


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A textured box. Its faces differ in pattern and shade, and are invisible from inside.

    Parameters
    ----------
    texture : Texture
        Grey levels of all faces. Shading multiplies the grey levels of a face by 0.6 to 1.16,
        limited to [0, 255].
    center : array_like, shape (3,)
        Centre in frame 0.
    size : array_like, shape (3,)
        Edge lengths along the box's own axes.
    axes : array_like, shape (3, 3)
        Rotation whose columns are the box's axes in camera axes; the identity by default.
    motion : array_like, shape (6,)
        Twist (T, ω), length/frame and rad/frame; at rest by default.

    Raises
    ------
    ValueError
        If an array has the wrong shape or is not finite, a size is not positive, or `axes` is not
        a rotation.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import Box, Plane, Scene, Texture
    >>> wall = Plane(texture=Texture(wavelength=0.5), point=(0, 0, 8))
    >>> box = Box(texture=Texture(wavelength=0.3), center=(0, 0, 4), size=(1, 1, 1))
    >>> camera = tisfm.Camera(focal=64.0)
    >>> pair = Scene(objects=[wall, box], camera=camera, height=48, width=64).render()
    >>> round(float(pair.depth[24, 32]), 3), round(float(pair.depth[0, 0]), 3)
    (3.5, 8.0)
    """

    texture: Texture
    center: Vector
    size: Vector
    axes: Vector = field(default_factory=lambda: np.eye(3))
    motion: Vector = (0.0,) * 6

    def __post_init__(self) -> None:
        _freeze(self, center=(3,), size=(3,), axes=(3, 3), motion=(6,))
        if (self.size <= 0).any():
            raise InputError(f"size is {self.size.tolist()}: expected positive edge lengths")
        gram = self.axes.T @ self.axes
        if not np.allclose(gram, np.eye(3), atol=1e-9) or np.linalg.det(self.axes) < 0:
            raise InputError(f"axes is {self.axes.tolist()}: expected a rotation matrix")

    # Arguments of the methods below are in object coordinates, along the box's axes from its
    # centre: points and rays, (3, n); the camera position, (3,). Footprints as for `Plane`.
    def _pose(self) -> tuple[Floats, Floats]:
        return self.axes, self.center

    @cached_property
    def _corners(self) -> Floats:
        """The corners, (3, 8), relative to the centre, in the box's own axes."""
        return _CORNER_SIGNS * (self.size / 2)[:, None]

    def _hit_depth(self, camera_position: Floats, ray: Floats) -> Floats:
        # The slab method: the box is the intersection of three slabs between parallel planes.
        enter_depth, leave_depth = np.zeros(ray.shape[1]), np.full(ray.shape[1], np.inf)
        for position, direction, half_length in zip(
            camera_position, ray, self.size / 2, strict=True
        ):
            depth0, depth1 = (
                (-half_length - position) / direction,
                (half_length - position) / direction,
            )
            np.maximum(enter_depth, np.minimum(depth0, depth1), out=enter_depth)
            np.minimum(leave_depth, np.maximum(depth0, depth1), out=leave_depth)
        return np.where((enter_depth < leave_depth) & (enter_depth > 0), enter_depth, np.inf)

    def _grey(self, points: Floats, ray: Floats, footprint: Floats) -> NDArray:
        relative, axis = self._faces(points)
        grey = np.empty(points.shape[1], np.float32)
        for face, shade in enumerate(FACE_SHADES):
            normal_axis, sign = face // 2, 2 * (face % 2) - 1
            on_face = np.flatnonzero((axis == normal_axis) & (sign * relative[normal_axis] > 0))
            if on_face.size:
                s, t = (points[other, on_face] for other in range(3) if other != normal_axis)
                face_footprint = footprint[on_face] / np.sqrt(np.abs(ray[normal_axis, on_face]))
                grey[on_face] = shade * self.texture._grey(s, t, face_footprint, face)
        return np.clip(grey, 0, 255)

    def _is_plain(self, points: Floats) -> NDArray[np.bool_]:
        _, axis = self._faces(points)
        s, t = np.where(axis == 0, points[1], points[0]), np.where(axis == 2, points[1], points[2])
        return self.texture._is_plain(s, t)

    def _faces(self, points: Floats) -> tuple[Floats, NDArray[np.intp]]:
        """Return points, (3, n), divided by half edge lengths, and the normal axes of the faces."""
        relative = points / (self.size / 2)[:, None]
        return relative, np.argmax(np.abs(relative), axis=0)


class ObjectView:
    """An object in camera axes after a rigid motion P1 = R P0 + t.

    Rays are (x̂, ŷ, 1), shape (3, n), and depths, shape (n,), along the camera's Z axis.
    """

    def __init__(self, item: Plane | Box, rotation: Floats, translation: Floats) -> None:
        axes, center = item._pose()
        self.rotation, self.translation = rotation, translation
        axes, center = rotation @ axes, rotation @ center + translation
        # A point P in camera axes has the object coordinates object_rotation P + camera_position.
        self.item, self.object_rotation, self.camera_position = item, axes.T, -axes.T @ center
        self._bounds = _image_bounds(item._corners, axes, center)

    def misses_all(self, first: Floats, last: Floats) -> bool:
        """Return whether the bounds of the object exclude all (x̂, ŷ) from `first` to `last`."""
        if self._bounds is None:
            return False
        left, top, right, bottom = self._bounds
        return first[0] > right or last[0] < left or first[1] > bottom or last[1] < top

    def hit_depth(self, rays: Floats) -> Floats:
        """Return the depth of the object along rays, infinite if a ray misses the object."""
        return self.item._hit_depth(self.camera_position, self._to_object_axes(rays))

    def grey(self, rays: Floats, depth: Floats, focal: float) -> NDArray:
        """Return the grey levels, (n,) float32, at depths along rays; focal length in px."""
        ray = self._to_object_axes(rays)
        return self.item._grey(ray * depth + self.camera_position[:, None], ray, depth / focal)

    def is_plain(self, rays: Floats, depth: Floats) -> NDArray[np.bool_]:
        """Return whether the surface has a single grey level around the points at these depths."""
        return self.item._is_plain(
            self._to_object_axes(rays) * depth + self.camera_position[:, None]
        )

    def _to_object_axes(self, rays: Floats) -> Floats:
        # The slab method divides by components: the addition keeps them from being exactly zero.
        return self.object_rotation @ rays + 1e-150


def _image_bounds(
    corners: Floats | None, axes: Floats, center: Floats
) -> tuple[float, float, float, float] | None:
    """Return the bounds of the image of a box, with a margin: (left, top, right, bottom).

    The bounds are x̂ and ŷ. Return None for an object without corners, or if some corner is not in
    front of the camera.
    """
    if corners is None:
        return None
    x, y, z = axes @ corners + center[:, None]
    if z.min() <= BOUNDS_MARGIN * corners.max():
        return None
    x, y = x / z, y / z
    left, top, right, bottom = x.min(), y.min(), x.max(), y.max()
    margin = BOUNDS_MARGIN * (1 + max(-left, -top, right, bottom))
    return left - margin, top - margin, right + margin, bottom + margin


def _freeze(item: Plane | Box, **shapes: tuple[int, ...]) -> None:
    for name, shape in shapes.items():
        object.__setattr__(item, name, check_finite(getattr(item, name), shape, name))
