"""The objects of a scene: planes and boxes, where rays hit them, and their grey levels."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tisfm.checks import Floats, Vector, check_finite
from tisfm.errors import InputError

from .texture import Texture

# Depth of a plane, in scene units, beyond which a ray counts as a miss: grazing rays stay finite.
MAX_PLANE_DEPTH = 1e9
# Margin of the bounds of a box, as a share of its largest coordinate: far more than rounding.
BOUNDS_MARGIN = 1e-6
# Factors of the grey level of a box's faces -X +X -Y +Y -Z +Z: the top is light, one side dark.
FACE_SHADES = (0.66, 0.76, 1.16, 0.6, 0.98, 0.86)
_CORNER_SIGNS = 2.0 * np.indices((2, 2, 2)).reshape(3, 8) - 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Plane:
    """An infinite textured plane, opaque from both sides.

    Parameters
    ----------
    texture : Texture
        Its paint.
    point : array_like, shape (3,)
        Any point of the plane in frame 0.
    normal : array_like, shape (3,)
        Its normal, of any length and sign. By default the plane is fronto-parallel.
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

    def _pose(self) -> tuple[Floats, Floats]:
        return self._axes, self.point

    @cached_property
    def _axes(self) -> Floats:
        # The in-plane axes start from the camera axis most nearly in the plane.
        across = np.eye(3)[np.argmin(np.abs(self.normal))]
        across = across - (across @ self.normal) * self.normal
        across /= np.linalg.norm(across)
        return np.stack([across, np.cross(self.normal, across), self.normal], -1)

    @property
    def _corners(self) -> None:
        """A plane has none."""

    def _hit(self, origin: Floats, ray: Floats) -> Floats:
        depth = -origin[2] / ray[2]
        return np.where((depth > 0) & (depth < MAX_PLANE_DEPTH), depth, np.inf)

    def _grey(self, at: Floats, ray: Floats, footprint: Floats) -> NDArray:
        return self.texture._grey(at[0], at[1], footprint / np.sqrt(np.abs(ray[2])))

    def _plain(self, at: Floats) -> NDArray[np.bool_]:
        return self.texture._plain(at[0], at[1])


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A textured box; its faces differ in pattern and shade. It is invisible from inside.

    Parameters
    ----------
    texture : Texture
        Its paint. Shading multiplies the grey level by 0.6 to 1.16, limited to [0, 255].
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

    def _pose(self) -> tuple[Floats, Floats]:
        return self.axes, self.center

    @cached_property
    def _corners(self) -> Floats:
        """The corners, (3, 8), in the box's own axes, from its centre."""
        return _CORNER_SIGNS * (self.size / 2)[:, None]

    def _hit(self, origin: Floats, ray: Floats) -> Floats:
        # The slab method: the box is the intersection of three slabs between parallel planes.
        enter, leave = np.zeros(ray.shape[1]), np.full(ray.shape[1], np.inf)
        for position, direction, half in zip(origin, ray, self.size / 2, strict=True):
            one, other = (-half - position) / direction, (half - position) / direction
            np.maximum(enter, np.minimum(one, other), out=enter)
            np.minimum(leave, np.maximum(one, other), out=leave)
        return np.where((enter < leave) & (enter > 0), enter, np.inf)

    def _grey(self, at: Floats, ray: Floats, footprint: Floats) -> NDArray:
        relative, axis = self._faces(at)
        grey = np.empty(at.shape[1], np.float32)
        for face, shade in enumerate(FACE_SHADES):
            normal, sign = face // 2, 2 * (face % 2) - 1
            on = np.flatnonzero((axis == normal) & (sign * relative[normal] > 0))
            if on.size:
                s, t = (at[other, on] for other in range(3) if other != normal)
                patch = footprint[on] / np.sqrt(np.abs(ray[normal, on]))
                grey[on] = shade * self.texture._grey(s, t, patch, face)
        return np.clip(grey, 0, 255)

    def _plain(self, at: Floats) -> NDArray[np.bool_]:
        _, axis = self._faces(at)
        s, t = np.where(axis == 0, at[1], at[0]), np.where(axis == 2, at[1], at[2])
        return self.texture._plain(s, t)

    def _faces(self, at: Floats) -> tuple[Floats, NDArray[np.intp]]:
        """Return points relative to the half lengths, and the axis that their face is normal to."""
        relative = at / (self.size / 2)[:, None]
        return relative, np.argmax(np.abs(relative), axis=0)


class ObjectView:
    """An object in camera axes after a rigid motion P1 = R P0 + t.

    Rays are (x̂, ŷ, 1), shape (3, n), and depths, shape (n,), along the camera's Z axis.
    """

    def __init__(self, item: Plane | Box, rotation: Floats, translation: Floats) -> None:
        axes, center = item._pose()
        self.rotation, self.translation = rotation, translation
        axes, center = rotation @ axes, rotation @ center + translation
        # A point P of the camera axes has the object coordinates turn P + origin.
        self.item, self.turn, self.origin = item, axes.T, -axes.T @ center
        self._bounds = _bounds_of(item._corners, axes, center)

    def is_beside(self, first: Floats, last: Floats) -> bool:
        """Return whether no ray meets the object whose (x̂, ŷ) are between the first and last."""
        if self._bounds is None:
            return False
        left, top, right, bottom = self._bounds
        return first[0] > right or last[0] < left or first[1] > bottom or last[1] < top

    def hit(self, rays: Floats) -> Floats:
        """Return the depth of the object along rays, infinite where they miss it."""
        return self.item._hit(self.origin, self._turned(rays))

    def grey(self, rays: Floats, depth: Floats, focal: float) -> NDArray:
        """Return the grey level, float32, where rays hit the object; focal length in px."""
        ray = self._turned(rays)
        return self.item._grey(ray * depth + self.origin[:, None], ray, depth / focal)

    def plain(self, rays: Floats, depth: Floats) -> NDArray[np.bool_]:
        """Return whether the surface has a single grey level where rays hit the object."""
        return self.item._plain(self._turned(rays) * depth + self.origin[:, None])

    def _turned(self, rays: Floats) -> Floats:
        # Avoids components of exactly zero, by which the slab method would divide.
        return self.turn @ rays + 1e-150


def _bounds_of(
    corners: Floats | None, axes: Floats, center: Floats
) -> tuple[float, float, float, float] | None:
    """Return the rectangle in which a box is seen, with a margin: (left, top, right, bottom).

    Its sides are x̂ and ŷ. None without corners, and where some are not in front of the camera.
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
