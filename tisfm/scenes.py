"""Synthetic frame pairs with exact truth: textured planes and boxes in rigid motion, ray-cast.

Camera axes are X right, Y down, Z forward, those of frame 0; lengths are in any one unit. A motion
is a twist (T, ω) per frame: a point P has velocity T + ω × P (eq. 1-2 of the paper) and moves, from
one frame to the next, by the exact exponential of the twist, P1 = R P0 + t. A camera that moves by
(V, Ω) in its own axes sees a static scene with T = -V, ω = -Ω.

Grey levels are painted on the surfaces, so brightness constancy holds exactly up to anti-aliasing
and quantisation. The paint is band-limited and measured in scene units: the picture does not
depend on the size at which it is rendered, except that waves too short for the pixels fade out.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.camera import Camera

__all__ = [
    "STATIC_KINDS",
    "Box",
    "Plane",
    "Scene",
    "SyntheticPair",
    "Texture",
    "rigid_motion",
    "static_scene",
    "two_blocks",
]

Floats = NDArray[np.float64]
# Of a field: array_like when it is given, a read-only float64 array once it is checked.
Vector = Any

STILL = (0.0,) * 6
# Surfaces farther than this count as missed, which keeps grazing rays finite.
FARTHEST = 1e9
# Samples cast at once: their temporary arrays stay in the cache.
CHUNK = 1 << 15

# The noise tile holds TILE / SAMPLES_PER_WAVE waves a side; octaves are turned and shifted copies.
TILE = 512
SAMPLES_PER_WAVE = 16

# Strength of the octaves, the finest first; the last one holds for all beyond.
STRENGTHS = (0.09, 0.16, 0.55, 0.85)

# Shade by direction of a box's face, -X +X -Y +Y -Z +Z: the top light, one side in the shade.
FACE_SHADES = (0.66, 0.76, 1.16, 0.6, 0.98, 0.86)


def rigid_motion(motion: ArrayLike) -> tuple[Floats, Floats]:
    """Return the finite rigid motion of a twist acting for one frame.

    Parameters
    ----------
    motion : array_like, shape (6,)
        Twist (T, ω): translational velocity, length/frame, and rotational velocity, rad/frame.

    Returns
    -------
    rotation : ndarray, shape (3, 3)
        R = exp([ω]×).
    translation : ndarray, shape (3,)
        t = V(ω) T, with V the integral of exp(s[ω]×) over s in [0, 1]. P1 = R P0 + t.

    Raises
    ------
    ValueError
        If `motion` is not six finite numbers.
    """
    twist = _vector(motion, 6, "motion", "a twist (T1, T2, T3, ω1, ω2, ω3)")
    velocity, spin = twist[:3], twist[3:]
    angle = float(np.linalg.norm(spin))
    cross = np.array([[0.0, -spin[2], spin[1]], [spin[2], 0.0, -spin[0]], [-spin[1], spin[0], 0.0]])
    # sin θ/θ, (1 - cos θ)/θ² and (θ - sin θ)/θ³, none of which cancels at small angles.
    first = float(np.sinc(angle / np.pi))
    second = 0.5 * float(np.sinc(angle / (2 * np.pi))) ** 2
    if angle < 1e-2:
        third = 1 / 6 - angle**2 / 120 + angle**4 / 5040
    else:
        third = (angle - math.sin(angle)) / angle**3
    rotation = np.eye(3) + first * cross + second * cross @ cross
    translation = (np.eye(3) + second * cross + third * cross @ cross) @ velocity
    return rotation, translation


@dataclass(frozen=True, kw_only=True)
class Texture:
    """Marbled paint: macro blotches with weak variation inside.

    Parameters
    ----------
    wavelength : float
        Wavelength of the finest octave, in the scene's unit of length.
    octaves : int, default 5
        Number of octaves; each doubles the wavelength. The two finest are the weak variation.
    mean, contrast : float
        Grey levels lie within mean ± contrast before shading.
    seed : int, default 0
        Another seed gives another pattern.

    Raises
    ------
    ValueError
        If the wavelength, the number of octaves or the range of grey levels is impossible.
    """

    wavelength: float
    octaves: int = 5
    mean: float = 124.0
    contrast: float = 76.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.wavelength) and self.wavelength > 0):
            raise ValueError(f"wavelength is {self.wavelength}: expected a positive length")
        if self.octaves < 1:
            raise ValueError(f"octaves is {self.octaves}: expected at least 1")
        if not 0 <= self.contrast <= min(self.mean, 255 - self.mean):
            raise ValueError(
                f"mean ± contrast is {self.mean} ± {self.contrast}: expected grey levels in "
                "[0, 255]"
            )
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}: expected a non-negative integer")

    def grey(self, s: Floats, t: Floats, footprint: Floats, *, face: int = 0) -> NDArray:
        """Return the grey level at surface points.

        Parameters
        ----------
        s, t : ndarray, shape (n,)
            Coordinates on the surface, in the scene's unit of length.
        footprint : ndarray, shape (n,)
            Size of a pixel's patch of surface, same unit. A wave shorter than two footprints is
            left out, one longer than three is whole.
        face : int, default 0
            Faces of an object have the same statistics and different patterns.

        Returns
        -------
        ndarray, shape (n,), float32
            Grey level within mean ± contrast.
        """
        random = np.random.default_rng([self.seed, face])
        longest = self.wavelength * 2 ** (self.octaves - 1)
        # Bending the blotches by the longest wave gives the veins of marble.
        bend = 0.05 * longest
        bent_s = s + bend * _noise(s, t, longest, random)
        bent_t = t + bend * _noise(s, t, longest, random)
        total = np.zeros(s.shape, np.float32)
        for octave in range(self.octaves):
            wavelength = self.wavelength * 2**octave
            kept = np.clip(wavelength / footprint - 2, 0, 1).astype(np.float32)
            at_s, at_t = (s, t) if octave < 2 else (bent_s, bent_t)
            strength = np.float32(STRENGTHS[min(octave, len(STRENGTHS) - 1)])
            wave = _noise(at_s, at_t, wavelength, random)
            total += strength * kept * kept * (3 - 2 * kept) * wave
        # The soft limit flattens the inside of the blotches and bounds the range.
        return np.float32(self.mean) + np.float32(self.contrast) * np.tanh(total)


def _noise(s: Floats, t: Floats, wavelength: float, random: np.random.Generator) -> NDArray:
    """Look up one octave of noise, unit variance, turned and shifted at random."""
    angle, *shift = random.uniform(0, 1, 3) * (2 * math.pi, TILE, TILE)
    across = math.cos(angle) * SAMPLES_PER_WAVE / wavelength
    along = math.sin(angle) * SAMPLES_PER_WAVE / wavelength
    column = across * s - along * t + shift[0]
    row = along * s + across * t + shift[1]
    left, top = np.floor(column), np.floor(row)
    index = (top.astype(np.int64) % TILE) * TILE + left.astype(np.int64) % TILE
    corner = _tile().take(index, axis=0)
    dx = (column - left).astype(np.float32)
    dy = (row - top).astype(np.float32)
    return corner[:, 0] + dx * corner[:, 1] + dy * (corner[:, 2] + dx * corner[:, 3])


@lru_cache(maxsize=1)
def _tile() -> NDArray:
    """Return a periodic octave of noise as coefficients of bilinear interpolation, (TILE², 4)."""
    white = np.random.default_rng(2007).standard_normal((TILE, TILE))
    frequency = np.fft.fftfreq(TILE) * SAMPLES_PER_WAVE
    radius = np.hypot(frequency[:, None], frequency[None, :])
    band = (radius > 0.7) & (radius < 1.3)
    wave = np.fft.ifft2(np.fft.fft2(white) * band).real
    wave /= wave.std()
    east, south = np.roll(wave, -1, axis=1), np.roll(wave, -1, axis=0)
    south_east = np.roll(east, -1, axis=0)
    coefficients = np.stack([wave, east - wave, south - wave, south_east - east - south + wave], -1)
    tile = coefficients.reshape(-1, 4).astype(np.float32)
    tile.flags.writeable = False
    return tile


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
        _freeze(self, "point", _vector(self.point, 3, "point", "(X, Y, Z)"))
        normal = _vector(self.normal, 3, "normal", "(X, Y, Z)")
        if not normal.any():
            raise ValueError("normal is (0, 0, 0): expected a direction")
        _freeze(self, "normal", normal / np.linalg.norm(normal))
        _freeze(self, "motion", _vector(self.motion, 6, "motion", "a twist (T, ω)"))

    def _pose(self) -> tuple[Floats, Floats]:
        # The in-plane axes start from the camera axis most nearly in the plane.
        across = np.eye(3)[np.argmin(np.abs(self.normal))]
        across = across - (across @ self.normal) * self.normal
        across /= np.linalg.norm(across)
        return np.stack([across, np.cross(self.normal, across), self.normal], -1), self.point

    def _hit(self, origin: Floats, ray: Floats) -> Floats:
        depth = -origin[2] / ray[2]
        return np.where((depth > 0) & (depth < FARTHEST), depth, np.inf)

    def _paint(self, at: Floats, ray: Floats, footprint: Floats) -> NDArray:
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
        _freeze(self, "center", _vector(self.center, 3, "center", "(X, Y, Z)"))
        size = _vector(self.size, 3, "size", "three edge lengths")
        if (size <= 0).any():
            raise ValueError(f"size is {tuple(size.tolist())}: expected positive edge lengths")
        _freeze(self, "size", size)
        axes = np.array(self.axes, dtype=np.float64)
        if axes.shape != (3, 3):
            raise ValueError(f"axes has shape {axes.shape}: expected a rotation, (3, 3)")
        if not (np.allclose(axes.T @ axes, np.eye(3), atol=1e-9) and np.linalg.det(axes) > 0):
            raise ValueError(f"axes is {axes.tolist()}: expected a rotation matrix")
        _freeze(self, "axes", axes)
        _freeze(self, "motion", _vector(self.motion, 6, "motion", "a twist (T, ω)"))

    def _pose(self) -> tuple[Floats, Floats]:
        return self.axes, self.center

    def _hit(self, origin: Floats, ray: Floats) -> Floats:
        """Intersect by slabs: inside the box is inside all three pairs of planes."""
        enter = np.zeros(ray.shape[1])
        leave = np.full(ray.shape[1], np.inf)
        for position, direction, half in zip(origin, ray, self.size / 2, strict=True):
            one, other = (-half - position) / direction, (half - position) / direction
            np.maximum(enter, np.minimum(one, other), out=enter)
            np.minimum(leave, np.maximum(one, other), out=leave)
        return np.where((enter < leave) & (enter > 0), enter, np.inf)

    def _paint(self, at: Floats, ray: Floats, footprint: Floats) -> NDArray:
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


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticPair:
    """Two frames of a scene and the truth at the pixel centres of frame 0.

    Attributes
    ----------
    frame0, frame1 : ndarray, shape (H, W), uint8 or float32
        Grey levels on the 8-bit scale; float32 ones are not rounded.
    camera : Camera
        The camera of both frames.
    depth : ndarray, shape (H, W), float64
        Z in frame 0.
    flow : ndarray, shape (H, W, 2), float64
        Finite displacement (u, v), px: projection of P1 = R P0 + t less the pixel; NaN where P1 is
        not in front of the camera.
    tau, omega : ndarray, shape (3, H, W), float64
        T/Z, 1/frame, and ω, rad/frame: the twist of the object seen at each pixel.
    labels : ndarray, shape (H, W), int32
        Index of the object seen. In the scenes of this module 0 is the background, 1 the floor, and
        boxes follow.
    motions : ndarray, shape (K, 6), float64
        Twist (T, ω) of each object, by label.
    visible : ndarray, shape (H, W), bool
        Whether the same point is seen in frame 1: it projects between the centres of the border
        pixels and nothing hides it.
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
        What there is to see; an object's place in the sequence is its label. Together they must
        cover the image: put a background plane among them.
    camera : Camera
        Focal length and principal point, px.
    height, width : int
        Size of the frames, px, at least 1 each.

    Raises
    ------
    TypeError
        If an object is neither a Plane nor a Box.
    ValueError
        If there is no object or the size is not positive.
    """

    objects: Sequence[Plane | Box]
    camera: Camera
    height: int
    width: int

    def __post_init__(self) -> None:
        _check_size(self.height, self.width)
        _freeze(self, "objects", tuple(self.objects))
        if not self.objects:
            raise ValueError("objects is empty: expected at least a background Plane")
        for index, item in enumerate(self.objects):
            if not isinstance(item, Plane | Box):
                raise TypeError(
                    f"objects[{index}] is a {type(item).__name__}: expected a Plane or a Box"
                )

    def render(self, *, samples: int = 3, dtype: str = "uint8") -> SyntheticPair:
        """Cast the rays of both frames and work out the truth.

        Parameters
        ----------
        samples : int, default 3
            Rays per pixel side: each pixel averages samples² of them. Time grows alike.
        dtype : {"uint8", "float32"}
            Type of the frames; float32 keeps the fractions of a grey level.

        Returns
        -------
        SyntheticPair
            The frames and the truth. The same scene gives the same pair every time.

        Raises
        ------
        ValueError
            If an option is not as above, or some ray meets no object.
        """
        if samples < 1:
            raise ValueError(f"samples is {samples}: expected at least 1 ray per pixel side")
        if dtype not in ("uint8", "float32"):
            raise ValueError(f"dtype is {dtype!r}: expected 'uint8' or 'float32'")
        frames = [self._frame(self._views(when), samples) for when in (0, 1)]
        if dtype == "uint8":
            frames = [np.rint(frame).astype(np.uint8) for frame in frames]
        return SyntheticPair(frame0=frames[0], frame1=frames[1], **self._truth())

    def _views(self, when: int) -> list[tuple[Floats, Floats]]:
        """Return, per object, the map from camera axes to its own: q = turn P + origin."""
        views = []
        for item in self.objects:
            axes, center = item._pose()
            if when == 1:
                rotation, translation = rigid_motion(item.motion)
                axes, center = rotation @ axes, rotation @ center + translation
            views.append((axes.T, -axes.T @ center))
        return views

    def _rows(self, rays_per_pixel: int) -> Iterator[slice]:
        """Cut the image in bands of rows whose rays make one chunk."""
        rows = max(1, CHUNK // (self.width * rays_per_pixel))
        for top in range(0, self.height, rows):
            yield slice(top, min(top + rows, self.height))

    def _cast(
        self, views: list[tuple[Floats, Floats]], rays: Floats
    ) -> tuple[Floats, NDArray[np.int32]]:
        """Return depth and label of the nearest object along rays (x̂, ŷ, 1), (3, n)."""
        nearest = np.full(rays.shape[1], np.inf)
        labels = np.zeros(rays.shape[1], np.int32)
        for label, (item, (turn, origin)) in enumerate(zip(self.objects, views, strict=True)):
            depth = item._hit(origin, _turned(turn, rays))
            closer = depth < nearest
            nearest[closer] = depth[closer]
            labels[closer] = label
        return nearest, labels

    def _frame(self, views: list[tuple[Floats, Floats]], samples: int) -> NDArray:
        """Render one frame, (H, W) float32."""
        frame = np.empty((self.height, self.width), np.float32)
        offsets = _sample_offsets(samples)
        for band in self._rows(samples**2):
            rays = self._rays(band, offsets)
            depth, labels = self._cast(views, rays)
            _check_covered(depth)
            grey = np.empty(depth.size, np.float32)
            for label, (item, (turn, origin)) in enumerate(zip(self.objects, views, strict=True)):
                on = np.flatnonzero(labels == label)
                if on.size:
                    ray = _turned(turn, rays[:, on])
                    at = ray * depth[on] + origin[:, None]
                    grey[on] = item._paint(at, ray, depth[on] / self.camera.focal)
            frame[band] = grey.reshape(samples**2, -1, self.width).mean(axis=0)
        return frame

    def _rays(self, band: slice, offsets: Floats) -> Floats:
        """Return the rays (x̂, ŷ, 1) of a band of rows, (3, offsets · rows · W)."""
        cx, cy = self.camera.center_for(self.height, self.width)
        x = np.arange(self.width) - cx
        y = np.arange(band.start, band.stop) - cy
        shape = (len(offsets), y.size, x.size)
        rays = np.ones((3, *shape))
        rays[0] = (x[None, None, :] + offsets[:, 0, None, None]) / self.camera.focal
        rays[1] = (y[None, :, None] + offsets[:, 1, None, None]) / self.camera.focal
        return rays.reshape(3, -1)

    def _truth(self) -> dict:
        """Work out the truth at the pixel centres of frame 0."""
        shape = (self.height, self.width)
        depth, labels = np.empty(shape), np.empty(shape, np.int32)
        flow, visible = np.empty((*shape, 2)), np.empty(shape, bool)
        before, after = self._views(0), self._views(1)
        motions = np.array([item.motion for item in self.objects])
        for band in self._rows(1):
            rays = self._rays(band, np.zeros((1, 2)))
            z, label = self._cast(before, rays)
            _check_covered(z)
            displacement, seen = self._follow(after, rays, z, label)
            depth[band] = z.reshape(-1, self.width)
            labels[band] = label.reshape(-1, self.width)
            flow[band] = displacement.T.reshape(-1, self.width, 2)
            visible[band] = seen.reshape(-1, self.width)
        twist = np.moveaxis(motions[labels], -1, 0)
        return {
            "camera": self.camera,
            "depth": depth,
            "flow": flow,
            "tau": twist[:3] / depth,
            "omega": twist[3:].copy(),
            "labels": labels,
            "motions": motions,
            "visible": visible,
        }

    def _follow(
        self, after: list[tuple[Floats, Floats]], rays: Floats, depth: Floats, labels: NDArray
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Move the points seen in frame 0; return their flow, (2, n), and whether they are seen."""
        moved = np.empty_like(rays)
        for label, item in enumerate(self.objects):
            on = labels == label
            rotation, translation = rigid_motion(item.motion)
            moved[:, on] = rotation @ (rays[:, on] * depth[on]) + translation[:, None]
        in_front = moved[2] > 0
        new_rays = moved / np.where(in_front, moved[2], np.nan)
        flow = self.camera.focal * (new_rays - rays)[:2]
        cx, cy = self.camera.center_for(self.height, self.width)
        x = self.camera.focal * new_rays[0] + cx
        y = self.camera.focal * new_rays[1] + cy
        seen = in_front & (x >= 0) & (x <= self.width - 1) & (y >= 0) & (y <= self.height - 1)
        nearest, _ = self._cast(after, np.where(seen, new_rays, rays))
        # The point itself is met at its own depth, up to rounding.
        return flow, seen & (nearest > moved[2] * (1 - 1e-6))


def two_blocks(
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    camera_motion: ArrayLike = (0.03, 0.0, 0.0, 0.0, 0.0, 0.0),
    block_motions: ArrayLike | None = None,
    samples: int = 3,
    dtype: str = "uint8",
) -> SyntheticPair:
    """Render two blocks that move on their own, each in translation, before a moving camera.

    After the Marbled-block sequence of the paper's section 6: the larger block moves in depth and
    to the left, the other forward and to the left, along the floor they stand on. At the default
    size displacements are about 1 to 4 px; they scale with the size, as does the whole picture.

    Parameters
    ----------
    height, width : int
        Size of the frames, px.
    seed : int, default 0
        Pattern of the textures.
    focal : float, optional
        Focal length, px; by default the width, so that every size shows the same view.
    camera_motion : array_like, shape (6,)
        (V, Ω) of the camera in its own axes, length/frame and rad/frame. The blocks are at depths
        of about 4.6 and 4, the background at about 9.
    block_motions : array_like, shape (2, 6), optional
        Twists (T, ω) of the larger and of the smaller block as seen by a camera at rest.
    samples, dtype
        As in `Scene.render`.

    Returns
    -------
    SyntheticPair
        Labels are 0 for the background, 1 for the floor, 2 for the larger block, 3 for the other.

    Raises
    ------
    ValueError
        If a size, the focal length or a motion is impossible.
    """
    if block_motions is None:
        own = _ROOM @ np.array([[-0.014, 0.0, 0.04], [-0.014, 0.0, -0.04]]).T
        block_motions = np.hstack([own.T, np.zeros((2, 3))])
    own = np.array(block_motions, dtype=np.float64)
    if own.shape != (2, 6):
        raise ValueError(f"block_motions has shape {own.shape}: expected two twists, (2, 6)")
    static = _seen_from(camera_motion)
    objects: list[Plane | Box] = [
        *_walls(static, seed),
        _block((-0.62, 4.7), (1.5, 1.3, 1.2), 28, static + own[0], seed + 2),
        _block((0.75, 3.7), (0.8, 0.85, 0.8), -33, static + own[1], seed + 3),
    ]
    return _view(objects, height, width, focal).render(samples=samples, dtype=dtype)


# (V, Ω) of the camera in its own axes. The turn adds to the sideways flow.
_STATIC_MOTIONS = {
    "sideways": (0.03, 0.0, 0.0, 0.0, 0.0, 0.0),
    "forward": (0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
    "sideways+rotation": (0.03, 0.0, 0.0, 0.002, 0.004, 0.003),
    "forward+rotation": (0.0, 0.0, 0.1, 0.002, 0.004, 0.003),
}
STATIC_KINDS = tuple(_STATIC_MOTIONS)


def static_scene(
    kind: str,
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    samples: int = 3,
    dtype: str = "uint8",
) -> SyntheticPair:
    """Render three blocks at rest on a floor, seen by a moving camera.

    Parameters
    ----------
    kind : {"sideways", "forward", "sideways+rotation", "forward+rotation"}
        Motion of the camera: V along its X or Z axis, without or with rotation about all three
        axes. At the default size displacements are a couple of px; they scale with the size.
    height, width, seed, focal
        As in `two_blocks`.
    samples, dtype
        As in `Scene.render`.

    Returns
    -------
    SyntheticPair
        All objects have the same motion. Labels are 0 for the background, 1 for the floor, 2, 3
        and 4 for the blocks.

    Raises
    ------
    ValueError
        If the kind is unknown, or a size or the focal length is impossible.
    """
    if kind not in _STATIC_MOTIONS:
        raise ValueError(f"kind is {kind!r}: expected one of {', '.join(map(repr, STATIC_KINDS))}")
    static = _seen_from(_STATIC_MOTIONS[kind])
    objects: list[Plane | Box] = [
        *_walls(static, seed),
        _block((-1.0, 4.4), (0.9, 1.2, 0.9), 35, static, seed + 2),
        _block((0.95, 5.6), (1.7, 1.0, 1.0), -18, static, seed + 3),
        _block((0.35, 3.3), (0.55, 0.5, 0.55), 20, static, seed + 4),
    ]
    return _view(objects, height, width, focal).render(samples=samples, dtype=dtype)


# The camera of the ready scenes looks down on the floor by 25°, from a height of 2.6.
_PITCH = math.radians(25)
_ROOM = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, math.cos(_PITCH), -math.sin(_PITCH)],
        [0.0, math.sin(_PITCH), math.cos(_PITCH)],
    ]
)
_EYE_HEIGHT = 2.6
_WALL_DISTANCE = 9.0
# Finest wave, px at a width of 320 and at the depth of the surface.
_FINEST = 4.0


def _wavelength(depth: float) -> float:
    return _FINEST * depth / 320


def _seen_from(camera_motion: ArrayLike) -> Floats:
    """Return the twist of what is at rest, for a camera that moves by (V, Ω)."""
    return -_vector(camera_motion, 6, "camera_motion", "(V1, V2, V3, Ω1, Ω2, Ω3)")


def _walls(motion: Floats, seed: int) -> list[Plane]:
    """Return the background and the floor of the room."""
    wall = Texture(wavelength=_wavelength(_WALL_DISTANCE), mean=114, contrast=42, seed=seed)
    floor = Texture(wavelength=_wavelength(4.5), mean=88, contrast=42, seed=seed + 1)
    return [
        Plane(
            texture=wall,
            point=_ROOM @ (0, 0, _WALL_DISTANCE),
            normal=_ROOM @ (0, 0, -1),
            motion=motion,
        ),
        Plane(
            texture=floor,
            point=_ROOM @ (0, _EYE_HEIGHT, 0),
            normal=_ROOM @ (0, -1, 0),
            motion=motion,
        ),
    ]


def _block(
    at: tuple[float, float], size: tuple[float, float, float], yaw: float, motion: Floats, seed: int
) -> Box:
    """Stand a box on the floor at (X, Z) of the room, turned by `yaw` degrees."""
    center = _ROOM @ (at[0], _EYE_HEIGHT - size[1] / 2, at[1])
    turn, _ = rigid_motion((0, 0, 0, 0, math.radians(yaw), 0))
    return Box(
        texture=Texture(wavelength=_wavelength(float(center[2])), mean=140, contrast=52, seed=seed),
        center=center,
        size=size,
        axes=_ROOM @ turn,
        motion=motion,
    )


def _view(objects: list[Plane | Box], height: int, width: int, focal: float | None) -> Scene:
    _check_size(height, width)
    camera = Camera(focal=float(width) if focal is None else focal)
    return Scene(objects=objects, camera=camera, height=height, width=width)


def _sample_offsets(samples: int) -> Floats:
    """Return where a pixel is sampled, px from its centre, (samples², 2).

    One sample in each cell of a square grid, which is slightly turned so that every sample has a
    column and a row of its own: edges along the pixel axes get samples² + 1 levels.
    """
    column, row = (index.ravel() for index in np.mgrid[:samples, :samples])
    x = (column + (row + 0.5) / samples) / samples
    y = (row + (samples - column - 0.5) / samples) / samples
    return np.stack([x, y], axis=-1) - 0.5


def _turned(turn: Floats, rays: Floats) -> Floats:
    # A component of exactly zero would divide by zero where slabs are met.
    return turn @ rays + 1e-150


def _check_covered(depth: Floats) -> None:
    if not np.isfinite(depth).all():
        raise ValueError(
            f"objects leave {np.mean(~np.isfinite(depth)):.0%} of a band of rays without a "
            "surface: expected them to cover the image, for instance with a background Plane"
        )


def _check_size(height: int, width: int) -> None:
    for name, value in (("height", height), ("width", width)):
        if not isinstance(value, int | np.integer) or value < 1:
            raise ValueError(f"{name} is {value!r}: expected a positive whole number of px")


def _vector(value: ArrayLike, length: int, name: str, meaning: str) -> Floats:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (length,):
        raise ValueError(f"{name} has shape {vector.shape}: expected {meaning}, ({length},)")
    if not np.isfinite(vector).all():
        raise ValueError(f"{name} is {tuple(vector.tolist())}: expected finite numbers")
    return vector


def _freeze(owner: object, name: str, value: object) -> None:
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    object.__setattr__(owner, name, value)
