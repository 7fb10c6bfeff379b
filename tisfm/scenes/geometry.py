"""The objects of a scene: planes and boxes, where a ray meets them and what grey it finds."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .checks import Floats, Vector, finite, freeze
from .rigid import rigid_motion
from .texture import Texture

STILL = (0.0,) * 6
# Surfaces farther than this count as missed, which keeps grazing rays finite.
FARTHEST = 1e9
# Shade by direction of a box's face, -X +X -Y +Y -Z +Z: the top light, one side in the shade.
FACE_SHADES = (0.66, 0.76, 1.16, 0.6, 0.98, 0.86)


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
        If a vector has the wrong length, is not finite, or the normal is zero.
    """

    texture: Texture
    point: Vector = (0.0, 0.0, 10.0)
    normal: Vector = (0.0, 0.0, -1.0)
    motion: Vector = STILL

    def __post_init__(self) -> None:
        normal = finite(self.normal, (3,), "normal", "(X, Y, Z)")
        if not normal.any():
            raise ValueError("normal is (0, 0, 0): expected a direction")
        freeze(
            self,
            point=finite(self.point, (3,), "point", "(X, Y, Z)"),
            normal=normal / np.linalg.norm(normal),
            motion=finite(self.motion, (6,), "motion", "a twist (T, ω)"),
        )

    def _pose(self) -> tuple[Floats, Floats]:
        # The in-plane axes start from the camera axis most nearly in the plane.
        across = np.eye(3)[np.argmin(np.abs(self.normal))]
        across = across - (across @ self.normal) * self.normal
        across /= np.linalg.norm(across)
        return np.stack([across, np.cross(self.normal, across), self.normal], -1), self.point

    def _hit(self, origin: Floats, ray: Floats) -> Floats:
        depth = -origin[2] / ray[2]
        return np.where((depth > 0) & (depth < FARTHEST), depth, np.inf)

    def _grey(self, at: Floats, ray: Floats, footprint: Floats) -> NDArray:
        return self.texture.grey(at[0], at[1], footprint / np.sqrt(np.abs(ray[2])))


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A textured box; its faces differ in pattern and shade. From inside it is not seen.

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
    """

    texture: Texture
    center: Vector
    size: Vector
    axes: Vector = field(default_factory=lambda: np.eye(3))
    motion: Vector = STILL

    def __post_init__(self) -> None:
        size = finite(self.size, (3,), "size", "three edge lengths")
        if (size <= 0).any():
            raise ValueError(f"size is {size.tolist()}: expected positive edge lengths")
        axes = finite(self.axes, (3, 3), "axes", "a rotation")
        if not (np.allclose(axes.T @ axes, np.eye(3), atol=1e-9) and np.linalg.det(axes) > 0):
            raise ValueError(f"axes is {axes.tolist()}: expected a rotation matrix")
        center = finite(self.center, (3,), "center", "(X, Y, Z)")
        motion = finite(self.motion, (6,), "motion", "a twist (T, ω)")
        freeze(self, center=center, size=size, axes=axes, motion=motion)

    def _pose(self) -> tuple[Floats, Floats]:
        return self.axes, self.center

    def _hit(self, origin: Floats, ray: Floats) -> Floats:
        # By slabs: inside the box is inside all three pairs of planes.
        enter = np.zeros(ray.shape[1])
        leave = np.full(ray.shape[1], np.inf)
        for position, direction, half in zip(origin, ray, self.size / 2, strict=True):
            one, other = (-half - position) / direction, (half - position) / direction
            np.maximum(enter, np.minimum(one, other), out=enter)
            np.minimum(leave, np.maximum(one, other), out=leave)
        return np.where((enter < leave) & (enter > 0), enter, np.inf)

    def _grey(self, at: Floats, ray: Floats, footprint: Floats) -> NDArray:
        relative = at / (self.size / 2)[:, None]
        axis = np.argmax(np.abs(relative), axis=0)
        grey = np.empty(at.shape[1], np.float32)
        for face, shade in enumerate(FACE_SHADES):
            normal, sign = face // 2, 2 * (face % 2) - 1
            on = np.flatnonzero((axis == normal) & (sign * relative[normal] > 0))
            if on.size:
                s, t = (at[other, on] for other in range(3) if other != normal)
                patch = footprint[on] / np.sqrt(np.abs(ray[normal, on]))
                grey[on] = shade * self.texture.grey(s, t, patch, face=face)
        return np.clip(grey, 0, 255)


class View:
    """An object seen by the camera in frame 0 or 1: its axes are at q = turn P + origin.

    Rays are (x̂, ŷ, 1), shape (3, n), and depths, shape (n,), are along the camera's Z axis.
    """

    def __init__(self, item: Plane | Box, when: int) -> None:
        axes, center = item._pose()
        if when == 1:
            rotation, translation = rigid_motion(item.motion)
            axes, center = rotation @ axes, rotation @ center + translation
        self.item, self.turn, self.origin = item, axes.T, -axes.T @ center

    def hit(self, rays: Floats) -> Floats:
        """Return the depth at which rays meet the object, infinite where they miss it."""
        return self.item._hit(self.origin, self._turned(rays))

    def grey(self, rays: Floats, depth: Floats, footprint: Floats) -> NDArray:
        """Return the grey level, float32, where rays meet the object; footprint as for paint."""
        ray = self._turned(rays)
        return self.item._grey(ray * depth + self.origin[:, None], ray, footprint)

    def _turned(self, rays: Floats) -> Floats:
        # A component of exactly zero would divide by zero where slabs are met.
        return self.turn @ rays + 1e-150
