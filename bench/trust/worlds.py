"""Rendered worlds of the bench: surfaces, and the path of a camera through them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tisfm.rigid import pose_matrix, rigid_motion
from tisfm.scenes import Box, Patch, Plane, Texture
from tisfm.scenes.room import room_objects

FRAMES = 16
WIDTH = 320  # px
HEIGHT = 240  # px
SHORTEST_WAVE = 4.0  # px: of the textures, at the distance that they are made for

Surface = Plane | Box
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Repeated(Texture):
    """A pattern that repeats exactly along both axes of a surface.

    The wavelength is the distance from tile to tile.
    """

    def _grey(
        self, s: NDArray, t: NDArray, footprint: NDArray, face: int = 0
    ) -> NDArray[np.float32]:
        phase = 2 * math.pi / self.wavelength
        pattern = np.tanh(3 * np.cos(phase * s) * np.cos(phase * t)) + 0.3 * np.cos(
            2 * phase * (s + 0.4 * t)
        )
        fade = np.clip(self.wavelength / footprint / 2 - 1, 0, 1)
        return np.asarray(self.mean + self.contrast * 0.75 * fade * pattern, np.float32)


@dataclass(frozen=True, kw_only=True)
class Shaded(Texture):
    """A texture with soft shadows, as of trees, that rest on the surface."""

    shadow_size: float  # length

    def _grey(
        self, s: NDArray, t: NDArray, footprint: NDArray, face: int = 0
    ) -> NDArray[np.float32]:
        x, y = (2 * math.pi * c / self.shadow_size for c in (s, t))
        pattern = np.sin(x + 1.3 * np.sin(0.7 * y)) + np.sin(0.6 * x - 0.9 * y)
        light = 1 - 0.5 / (1 + np.exp(-4 * pattern))
        return np.asarray(super()._grey(s, t, footprint, face) * light, np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Mirror:
    """A mirror on a wall: a box whose surface shows the room in front of it."""

    box: Box
    point: Vector  # of the reflecting plane
    normal: Vector  # of length 1
    hidden: tuple[Surface, ...]  # what stands behind the mirror: it is left out of the reflection


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """Surfaces at rest and a camera that moves through them."""

    name: str
    surfaces: tuple[Surface, ...]
    poses: NDArray[np.float64]  # (N, 4, 4), camera to world
    focal: float  # px
    # boxes that move with a velocity, length/frame
    movers: tuple[tuple[Box, Vector], ...] = ()
    mirror: Mirror | None = field(default=None)

    def surfaces_at(self, time: float) -> tuple[Surface, ...]:
        """Return all surfaces at a time in frames."""
        moved = [
            replace(box, center=np.asarray(box.center) + time * np.asarray(velocity))
            for box, velocity in self.movers
        ]
        mirrors = [] if self.mirror is None else [self.mirror.box]
        return (*self.surfaces, *moved, *mirrors)


def smooth_path(
    seed: int,
    velocity: Vector,  # length/frame, in the axes of the camera
    turn: Vector = (0.0, 0.0, 0.0),  # rad/frame
    *,
    wobble: float = 0.008,  # rad: amplitude of an additional turn about each axis
    count: int = FRAMES,
) -> NDArray[np.float64]:
    """Return the poses of a camera with an even motion and a wobble that depends on the seed."""
    random = np.random.default_rng([seed, 38])
    rates, phases = random.uniform(0.3, 0.8, 3), random.uniform(0, 2 * math.pi, 3)
    pose, poses = np.eye(4), []
    for k in range(count):
        poses.append(pose)
        swing = wobble * np.sin(rates * k + phases) * (1.0, 1.0, 0.5)
        pose = pose @ pose_matrix(np.r_[velocity, np.asarray(turn) + swing])
    return np.array(poses)


def paint(
    depth: float, focal: float, seed: int, mean: float = 124, contrast: float = 60
) -> Texture:
    """Return a texture for a surface at a distance."""
    return Texture(
        wavelength=SHORTEST_WAVE * depth / focal, mean=mean, contrast=contrast, seed=1000 + seed
    )


def room(seed: int, *, textured: bool = True) -> World:
    """Return the furnished room, with wallpaper or with bare walls."""
    velocities = ((0.06, 0.01, 0.02), (0.03, 0.0, 0.06), (-0.05, 0.02, 0.03), (0.0, 0.03, 0.05))
    turns = ((0, 0.008, 0), (0.004, 0, 0), (0, -0.006, 0.003), (0, 0.004, 0))
    k = seed % len(velocities)
    poses = smooth_path(seed, velocities[k], turns[k])
    surfaces = tuple(room_objects(WIDTH, seed, textured=textured))
    name = "room" if textured else "bare room"
    return World(name=f"{name} {seed}", surfaces=surfaces, poses=poses, focal=192.0)


def yard(seed: int) -> World:
    """Return boxes on the ground before a wall."""
    random = np.random.default_rng([seed, 1])
    focal = (250.0, 320.0, 200.0, 420.0, 280.0)[seed % 5]
    surfaces: list[Surface] = [
        Plane(texture=paint(9, focal, seed), point=(0, 0, 9), normal=(0.15, 0, -1)),
        Plane(texture=paint(5, focal, seed + 1, mean=100), point=(0, 1.6, 0), normal=(0, -1, 0)),
    ]
    for number in range(9):
        size = random.uniform(0.5, 1.3, 3)
        depth, right = random.uniform(3.2, 7.5), random.uniform(-0.55, 0.55)
        axes, _ = rigid_motion((0, 0, 0, 0, random.uniform(-0.7, 0.7), 0))
        surfaces.append(
            Box(
                texture=paint(depth, focal, seed + 10 + number, mean=random.uniform(90, 150)),
                center=(right * WIDTH / focal * depth, 1.6 - size[1] / 2, depth),
                size=size,
                axes=axes,
            )
        )
    velocities = (
        (0.07, 0.0, 0.0), (0.02, 0.0, 0.09), (-0.05, -0.02, 0.04), (0.05, 0.01, -0.03),
        (0.03, -0.03, 0.06),
    )  # fmt: skip
    poses = smooth_path(seed, velocities[seed % 5], (0, -0.006 + 0.004 * (seed % 4), 0))
    return World(name=f"yard {seed}", surfaces=tuple(surfaces), poses=poses, focal=focal)


def street(seed: int) -> World:
    """Return a street between facades with parked cars, and a camera that drives along it."""
    random = np.random.default_rng([seed, 2])
    focal = (220.0, 300.0, 180.0, 260.0)[seed % 4]
    surfaces: list[Surface] = [
        Plane(texture=paint(45, focal, seed), point=(0, 0, 60), normal=(0, 0, -1)),
        Plane(texture=paint(7, focal, seed + 1, mean=90), point=(0, 1.5, 0), normal=(0, -1, 0)),
        Plane(texture=paint(9, focal, seed + 2), point=(-5, 0, 0), normal=(1, 0, 0)),
        Plane(texture=paint(9, focal, seed + 3), point=(5.5, 0, 0), normal=(-1, 0, 0)),
    ]
    for number in range(8):
        side = -3.6 if number % 2 else 3.9
        surfaces.append(
            Box(
                texture=paint(9, focal, seed + 10 + number, mean=random.uniform(80, 160)),
                center=(side, 0.8, 6 + 3.5 * number + random.uniform(0, 1)),
                size=(1.7, 1.4, 4 - 1.6 * (number % 3) / 2),
            )
        )
    speed = (0.35, 0.5, 0.25, 0.4)[seed % 4]
    poses = smooth_path(seed, (0, 0, speed), (0, 0.004 * (seed % 3 - 1), 0), wobble=0.003)
    return World(name=f"street {seed}", surfaces=tuple(surfaces), poses=poses, focal=focal)


def table(seed: int) -> World:
    """Return small boxes on a table below the camera, which circles around them."""
    random = np.random.default_rng([seed, 3])
    focal = (300.0, 360.0)[seed % 2]
    down = rigid_motion((0, 0, 0, math.radians(50), 0, 0))[0]  # axes of the table in camera axes
    surfaces: list[Surface] = [
        Plane(texture=paint(1.2, focal, seed), point=down @ (0, 0.8, 0), normal=down @ (0, -1, 0))
    ]
    for number in range(7):
        size = random.uniform(0.08, 0.25, 3)
        place = (random.uniform(-0.5, 0.5), 0.8 - size[1] / 2, 0.8 + random.uniform(-0.35, 0.35))
        surfaces.append(
            Box(
                texture=paint(1.1, focal, seed + 10 + number),
                center=down @ place,
                size=size,
                axes=down @ rigid_motion((0, 0, 0, 0, random.uniform(-1, 1), 0))[0],
            )
        )
    poses = smooth_path(seed, (0.03, 0, 0.004), (0, -0.02, 0))
    return World(name=f"table {seed}", surfaces=tuple(surfaces), poses=poses, focal=focal)


def plane(
    name: str,
    normal: Vector,
    velocity: Vector,
    *,
    wobble: float,
    seed: int,
    focal: float = 320.0,  # px
    texture: Texture | None = None,
) -> World:
    """Return a single textured plane at a distance of 5."""
    wall = Plane(texture=texture or paint(5, focal, seed), point=(0, 0, 5), normal=normal)
    poses = smooth_path(seed, velocity, wobble=wobble)
    return World(name=name, surfaces=(wall,), poses=poses, focal=focal)


def shaded_floor() -> World:
    """Return a floor with shadows, which a camera comes down to."""
    texture = Shaded(wavelength=0.06, mean=120, contrast=60, seed=1005, shadow_size=2.2)
    return plane(
        "shaded floor", (0.35, -0.3, -0.89), (0.01, 0.015, 0.14), wobble=0.022, seed=5, focal=430,
        texture=texture,
    )  # fmt: skip


def blurred_desk() -> World:
    """Return a plane with a coarse, weak texture."""
    texture = Texture(wavelength=0.13, mean=120, contrast=35, seed=1008)
    return plane(
        "blurred desk", (0.05, -0.25, -0.97), (0.09, 0.05, 0.03), wobble=0.018, seed=8, focal=300,
        texture=texture,
    )  # fmt: skip


def poster(seed: int) -> World:
    """Return a poster on a bare wall."""
    focal = 300.0
    wall = Plane(texture=paint(4, focal, seed, mean=170, contrast=2), point=(0, 0, 4))
    sheet = Box(texture=paint(4, focal, seed + 1), center=(0.2, 0, 4), size=(3.2, 2.2, 0.01))
    poses = smooth_path(seed, (0.05, 0.02, 0.02), (0, -0.01, 0))
    return World(name=f"poster {seed}", surfaces=(wall, sheet), poses=poses, focal=focal)


def sparse(seed: int) -> World:
    """Return a few textured boxes in a hall without texture."""
    focal = 260.0
    plain = [
        Plane(texture=paint(6, focal, seed, mean=185, contrast=0), point=(0, 0, 6)),
        Plane(
            texture=Texture(
                wavelength=0.1,
                mean=120,
                contrast=0,
                patches=(Patch(center=(0.6, 0.2), size=(0.4, 0.3), grey=60),),
            ),
            point=(0, 1.5, 0),
            normal=(0, -1, 0),
        ),
    ]
    places = [(-1.2, 1.1, 4.0), (0.3, 0.7, 3.2), (1.5, 1.4, 5.0)]  # right, height, ahead
    if seed > 1:
        random = np.random.default_rng([seed, 4])
        rights, depths = random.permutation([-1.4, -0.2, 1.2]), random.uniform(2.8, 5.2, 3)
        places = [
            (right, random.uniform(0.6, 1.6), depth)
            for right, depth in zip(rights, depths, strict=True)
        ]
    boxes = [
        Box(texture=paint(z, focal, seed + k), center=(x, 1.5 - h / 2, z), size=(0.7, h, 0.6))
        for k, (x, h, z) in enumerate(places)
    ]
    velocity = ((0.06, 0, 0.02), (-0.05, 0.01, 0.03))[seed // 2 % 2]
    poses = smooth_path(seed, velocity, (0, 0.004, 0))
    return World(name=f"sparse {seed}", surfaces=(*plain, *boxes), poses=poses, focal=focal)


def tiles(seed: int) -> World:
    """Return walls and a floor whose pattern repeats exactly."""
    focal = 256.0
    wave = (0.4, 0.7)[seed % 2]
    surfaces = (
        Plane(texture=Repeated(wavelength=wave, mean=130, contrast=55), point=(0, 0, 6)),
        Plane(
            texture=Repeated(wavelength=wave, mean=110, contrast=45),
            point=(0, 1.5, 0),
            normal=(0, -1, 0),
        ),
        Plane(
            texture=Repeated(wavelength=wave, mean=140, contrast=50),
            point=(-3, 0, 0),
            normal=(1, 0, 0),
        ),
    )
    poses = smooth_path(seed, (0.06, 0, 0.03), (0, 0.003, 0))
    return World(name=f"tiles {seed}", surfaces=surfaces, poses=poses, focal=focal)


def mirror_hall(seed: int) -> World:
    """Return a hall with a mirror that covers a large part of its far wall."""
    focal = 220.0
    far = Plane(texture=paint(5, focal, seed), point=(0, 0, 5), normal=(0, 0, -1))
    walls: tuple[Surface, ...] = (
        Plane(texture=paint(4, focal, seed + 1), point=(0, 1.5, 0), normal=(0, -1, 0)),
        Plane(texture=paint(4, focal, seed + 2), point=(0, -1.8, 0), normal=(0, 1, 0)),
        Plane(texture=paint(4, focal, seed + 3), point=(-3, 0, 0), normal=(1, 0, 0)),
        Plane(texture=paint(4, focal, seed + 4), point=(3, 0, 0), normal=(-1, 0, 0)),
        Plane(texture=paint(6, focal, seed + 5), point=(0, 0, -3), normal=(0, 0, 1)),
        Box(texture=paint(4, focal, seed + 6), center=(-1.4, 1.1, 3.4), size=(0.7, 0.8, 0.7)),
        Box(texture=paint(4, focal, seed + 7), center=(1.6, 1.0, 2.8), size=(0.6, 1.0, 0.6)),
    )
    size = ((2.4, 1.6), (4.4, 2.8))[seed % 2]
    box = Box(texture=paint(4, focal, 0), center=(0, -0.2, 5), size=(*size, 0.02))
    mirror = Mirror(box=box, point=(0, 0, 4.99), normal=(0, 0, -1), hidden=(far,))
    poses = smooth_path(seed, (0.06, 0, 0.02), (0, 0.003, 0))
    return World(
        name=f"mirror hall {seed}", surfaces=(far, *walls), poses=poses, focal=focal, mirror=mirror
    )


# Cars: position (right, ahead), and velocity (right, ahead) in steps of the camera.
CARS = (
    ((0.3, 5.0), (0.0, 0.9)),  # ahead
    ((-2.0, 13.0), (0.0, -0.6)),  # oncoming
    ((2.0, 6.5), (0.0, 1.3)),  # overtaking
    ((-3.0, 10.0), (0.4, 0.0)),  # crossing
    ((0.1, 8.5), (0.05, 0.8)),
    ((-2.1, 19.0), (0.0, -0.7)),
)
TRUCK = ((0.0, 4.2), (0.0, 1.0))  # drives as fast as the camera


def with_traffic(world: World, count: int) -> World:
    """Return a world with moving boxes of the size of cars."""
    return _with_movers(world, CARS[:count], (1.5, 1.3, 1.8))


def with_truck(world: World, width: float) -> World:
    """Return a world with a truck ahead of the camera."""
    return _with_movers(world, (TRUCK,), (width, 2.4, 2.0))


def _with_movers(world: World, cars: Sequence[tuple], size: Vector) -> World:
    step = float(np.linalg.norm(world.poses[1, :3, 3] - world.poses[0, :3, 3]))
    movers = []
    for number, ((right, ahead), (across, along)) in enumerate(cars):
        car = Box(
            texture=paint(ahead, world.focal, 500 + number),
            center=(right, 1.45 - size[1] / 2, ahead),
            size=size,
        )
        movers.append((car, (across * step, 0.0, along * step)))
    return replace(world, movers=tuple(movers))


OTHER_PLACE = 50  # added to the number of a world: another place, seen with the same focal length
MAKERS: dict[str, Callable[[], World]] = {
    **{f"room {k}": lambda k=k: room(k) for k in (*range(4), OTHER_PLACE)},  # type: ignore[misc]
    **{f"bare room {k}": lambda k=k: room(k, textured=False) for k in range(2)},  # type: ignore[misc]
    **{f"yard {k}": lambda k=k: yard(k) for k in (*range(5), OTHER_PLACE + 1)},  # type: ignore[misc]
    **{f"street {k}": lambda k=k: street(k) for k in (*range(4), OTHER_PLACE)},  # type: ignore[misc]
    **{f"table {k}": lambda k=k: table(k) for k in range(2)},  # type: ignore[misc]
    "floor": lambda: plane("floor", (0, 0, -1), (0, -0.14, 0), wobble=0.0, seed=1),
    "wobbling floor": lambda: plane(
        "wobbling floor", (0, 0, -1), (0.1, -0.08, 0), wobble=0.02, seed=2
    ),
    "slanted wall": lambda: plane(
        "slanted wall", (0.5, 0, -0.866), (0.1, 0, 0.05), wobble=0.008, seed=3
    ),
    "tilted floor": lambda: plane(
        "tilted floor", (0, -0.7, -0.7), (0.05, 0, 0.1), wobble=0.006, seed=4
    ),
    "shaded floor": shaded_floor,
    "blurred desk": blurred_desk,
    "approached wall": lambda: plane(
        "approached wall", (0.3, 0.2, -0.93), (0.005, -0.01, 0.13), wobble=0.015, seed=6, focal=290
    ),
    "passed facade": lambda: plane(
        "passed facade", (0.7, 0.1, -0.71), (0.11, 0.02, 0.06), wobble=0.012, seed=7, focal=460
    ),
    "poster 0": lambda: poster(0),
    **{f"sparse {k}": lambda k=k: sparse(k) for k in range(6)},  # type: ignore[misc]
    "tiles 0": lambda: tiles(0),
    "tiles 1": lambda: tiles(1),
    "mirror hall 0": lambda: mirror_hall(0),
    "mirror hall 1": lambda: mirror_hall(1),
}
"""Name → function that makes the world."""
