"""A predefined scene with bodies that are not rigid: people who walk across a street."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from tisfm.camera import Camera
from tisfm.checks import Floats, check_whole_numbers
from tisfm.errors import InputError

from .geometry import Box, Plane
from .render import Scene
from .room import FOCAL, Film, add_blur_and_noise, check_film, detail_for, wavelength_at
from .texture import Texture

_GROUND_Y = 1.5  # m below the camera of frame 0
# Lengths of a walker, m, and angles, rad.
_THIGH, _CALF = 0.42, 0.44
_TORSO_HEIGHT, _HEAD_HEIGHT = 0.56, 0.26
_SHOULDER_DROP, _ARM = 0.05, 0.62
_HIP_SIDE, _SHOULDER_SIDE = 0.1, 0.24
_LEG_SWING, _KNEE_BEND, _ARM_SWING = 0.42, 0.7, 0.5
_UP = np.array((0.0, -1.0, 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkersFilm(Film):
    """Frames of K walkers in a street at rest, with exact truth.

    Attributes
    ----------
    frames, depth, poses, camera
        As in `Film`.
    labels : (N, H, W) uint8
        Object at the centre of each pixel: 0 for the street, 1 to K for a walker.
    positions : (K, N, 3) float64
        Point on the ground below the hips of each walker, in the world, m.

    Examples
    --------
    >>> from tisfm.scenes import bodies_path, walkers_film
    >>> film = walkers_film(bodies_path(2), 48, 64)
    >>> film.labels.shape, film.positions.shape
    ((2, 48, 64), (2, 2, 3))
    """

    labels: NDArray[np.uint8]
    positions: Floats


@dataclass(frozen=True, kw_only=True)
class _Walk:
    """A walk along a straight line."""

    start: tuple[float, float]  # right and ahead of the camera of frame 0, m
    heading: float  # angle of the direction from the right towards ahead, rad
    speed: float  # m/frame
    stride: float  # frames of two steps
    phase: float  # share of the stride in frame 0
    size: float  # height over that of the usual walker, which has 1.7 m
    # mean grey levels of shirt, trousers, and head and arms
    greys: tuple[float, float, float]

    def position(self, number: int) -> Floats:
        """Return the point on the ground, (3,), in a frame."""
        right, ahead = (
            start + number * self.speed * part
            for start, part in zip(
                self.start, (np.cos(self.heading), np.sin(self.heading)), strict=True
            )
        )
        return np.array((right, _GROUND_Y, ahead))


_WALKS = (
    # To the right, behind the post.
    _Walk(
        start=(-1.4, 3.3), heading=0.12, speed=0.055, stride=26, phase=0.0, size=1.0,
        greys=(186, 62, 150),
    ),
    # To the left and nearer, farther away than the first walker.
    _Walk(
        start=(2.3, 5.6), heading=np.pi + 0.45, speed=0.06, stride=24, phase=0.3, size=1.06,
        greys=(70, 112, 160),
    ),
)  # fmt: skip


def walkers_film(
    poses: ArrayLike,
    height: int = 240,
    width: int = 320,
    *,
    walkers: int = 2,
    seed: int = 0,
    focal: float | None = None,
    noise: float = 1.5,
    samples: int = 2,
) -> WalkersFilm:
    """Render a street in which people walk, along a path of the camera.

    The camera of frame 0 is 1.5 m above the ground. The walkers are 1.7 and 1.8 m tall, and 3 to
    6 m away. Their legs and arms swing, so they are not rigid; one foot at least is on the ground.
    Posts stand between the camera and the walkers, and boxes and a wall behind them.

    Parameters
    ----------
    poses : array_like, shape (N, 4, 4)
        Camera to world, in m, as `bodies_path` makes them.
    height, width : int
        Size of the frames, px.
    walkers : int, default 2
        Number of walkers, 0 to 2.
    seed : int, default 0
        Pattern of the textures and of the noise.
    focal : float, optional
        Focal length, px; by default 0.6 of the width.
    noise : float, default 1.5
        Standard deviation, grey levels, of the noise, independent at every pixel of every frame.
    samples : int, default 2
        Rays per pixel side, as in `Scene.render`.

    Raises
    ------
    ValueError
        If an option is not valid, or a pose is not a rigid motion.

    Examples
    --------
    >>> from tisfm.scenes import bodies_path, walkers_film
    >>> film = walkers_film(bodies_path(3), 48, 64, walkers=1)
    >>> film.frames.shape, film.depth.shape
    ((3, 48, 64), (3, 48, 64))
    """
    path = check_film(poses, height, width, noise)
    check_whole_numbers(0, walkers=walkers)
    if walkers > len(_WALKS):
        raise InputError(f"walkers is {walkers}: expected {len(_WALKS)} at most")
    camera = Camera(focal=FOCAL * width if focal is None else focal)
    street = _street(width, seed)
    walks = _WALKS[:walkers]
    frames = np.empty((len(path), height, width), np.uint8)
    depth = np.empty((len(path), height, width), np.float32)
    labels = np.empty((len(path), height, width), np.uint8)
    random = np.random.default_rng(seed)
    for k, pose in enumerate(path):
        boxes: list[Box] = []
        owners = [0] * len(street)
        for number, walk in enumerate(walks, 1):
            body = list(_body(walk, k, width, seed + 1000 * number))
            boxes += body
            owners += [number] * len(body)
        scene = Scene(objects=[*street, *boxes], camera=camera, height=height, width=width)
        depth[k], scene_labels = scene.depth_and_labels(pose)
        labels[k] = np.array(owners, np.uint8)[scene_labels]
        frame = scene.render_frame(pose, samples=samples)
        frames[k] = add_blur_and_noise(frame, random, noise, 0.0, "uint8")
    positions = np.array([[walk.position(k) for k in range(len(path))] for walk in walks])
    return WalkersFilm(
        frames=frames,
        depth=depth,
        poses=path,
        camera=camera,
        labels=labels,
        positions=positions.reshape(walkers, len(path), 3),
    )


def _street(width: int, seed: int) -> list[Plane | Box]:
    """Return the ground, a wall, and boxes and posts that stand on the ground."""

    def make_texture(depth: float, mean: float, contrast: float, number: int) -> Texture:
        return Texture(
            wavelength=wavelength_at(depth),
            octaves=4,
            detail=detail_for(width),
            mean=mean,
            contrast=contrast,
            seed=seed + number,
        )

    def stand(right: float, ahead: float, size: tuple[float, float, float], number: int) -> Box:
        return Box(
            texture=make_texture(ahead, 105 + 14 * (number % 5), 44, number),
            center=(right, _GROUND_Y - size[1] / 2, ahead),
            size=size,
        )

    return [
        Plane(
            texture=make_texture(5.0, 120, 46, 0), point=(0, _GROUND_Y, 0), normal=(0, -1, 0)
        ),
        Plane(texture=make_texture(13.0, 138, 48, 1), point=(0, 0, 13.0)),
        stand(-4.2, 10.5, (2.6, 3.2, 1.5), 2),
        stand(3.6, 9.6, (2.2, 1.4, 1.2), 3),
        stand(0.6, 11.5, (1.2, 2.2, 0.8), 4),
        stand(-0.35, 2.5, (0.07, 2.6, 0.07), 5),
        stand(1.15, 3.1, (0.16, 0.7, 0.16), 6),
        stand(-2.5, 4.8, (0.5, 0.6, 0.5), 7),
    ]  # fmt: skip


def _body(walk: _Walk, number: int, width: int, seed: int) -> Iterator[Box]:
    """Yield the parts of a walker in a frame; the lower foot touches the ground."""
    ahead = np.array((np.cos(walk.heading), 0.0, np.sin(walk.heading)))
    axes = np.stack([ahead, -_UP, np.cross(ahead, -_UP)], axis=1)  # ahead, down, to a side
    angle = 2 * np.pi * (number / walk.stride + walk.phase)
    shirt, trousers, skin = walk.greys

    def part(
        top: Floats, angle: float, size: tuple[float, float, float], grey: float, index: int
    ) -> tuple[Box, Floats]:
        """Return a part that hangs from a point, and its lower end, relative to the hips."""
        swing = Rotation.from_rotvec((0, 0, angle)).as_matrix()
        down = swing @ np.array((0.0, 1.0, 0.0))
        texture = Texture(
            wavelength=wavelength_at(5.0),
            octaves=4,
            detail=detail_for(width),
            mean=grey,
            contrast=34.0,
            seed=seed + index,
        )
        box = Box(
            texture=texture,
            center=walk.size * (top + size[1] / 2 * down),
            size=walk.size * np.array(size),
            axes=axes @ swing,
        )
        return box, top + size[1] * down

    parts: list[Box] = []
    feet = []
    for index, side in enumerate((-1, 1)):
        hip = np.array((0.0, 0.0, side * _HIP_SIDE))
        leg = side * _LEG_SWING * np.sin(angle)
        bend = _KNEE_BEND * max(0.0, side * np.cos(angle)) ** 2
        thigh, knee = part(hip, -leg, (0.15, _THIGH, 0.14), trousers, 2 * index)
        calf, foot = part(knee, -leg + bend, (0.11, _CALF, 0.11), trousers, 2 * index + 1)
        shoulder = np.array((0.0, _SHOULDER_DROP - _TORSO_HEIGHT, side * _SHOULDER_SIDE))
        arm_angle = side * _ARM_SWING * np.sin(angle)
        arm, _ = part(shoulder, arm_angle, (0.09, _ARM, 0.09), skin, 4 + index)
        parts += [thigh, calf, arm]
        feet.append(foot[1])
    torso, _ = part(np.array((0.0, -_TORSO_HEIGHT, 0.0)), 0.0, (0.24, _TORSO_HEIGHT, 0.4), shirt, 6)
    neck = np.array((0.02, -_TORSO_HEIGHT - _HEAD_HEIGHT, 0.0))
    head, _ = part(neck, 0.0, (0.2, _HEAD_HEIGHT, 0.17), skin, 7)
    hips = walk.position(number) - walk.size * max(feet) * np.array((0.0, 1.0, 0.0))
    for box in (*parts, torso, head):
        yield Box(
            texture=box.texture, center=hips + axes @ box.center, size=box.size, axes=box.axes
        )
