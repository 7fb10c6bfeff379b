"""A ready scene indoors: bare walls, a tiled floor, a door, pictures and boxes, from inside."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.camera import Camera
from tisfm.checks import Floats, finite, whole
from tisfm.errors import InputError
from tisfm.rigid import pose_matrix, rigid_motion, rigid_twist

from .geometry import Box, Plane
from .render import Scene, SyntheticPair, check_dtype
from .texture import Texture

# The camera looks to the right of the far wall and down.
_YAW, _PITCH = math.radians(26), math.radians(8)
_FLOOR, _CEILING = 1.5, -1.15  # m below the camera
_AHEAD, _RIGHT, _LEFT, _BEHIND = 3.5, 2.3, -2.6, -2.5  # m from the camera to the walls
_TILE, _JOINT = 0.33, 0.006  # m
_TILES = 64  # a side: beyond, they repeat
FOCAL = 0.6  # of the width
# Without detail the finest wave has this length, px, in a picture of this width, px.
_FINEST, _WIDTH = 4.0, 320
_ROWS = 2  # that are rendered as if they were read at once
_BARE = 5  # labels below are those of bare walls and of the ceiling

_AXES = (  # of the room in columns: right, down, ahead
    rigid_motion((0, 0, 0, _PITCH, 0, 0))[0] @ rigid_motion((0, 0, 0, 0, -_YAW, 0))[0]
)
# Axes of a wall in columns, in those of the room: along it to the right, down, into the wall.
_FAR_WALL = np.eye(3)
_RIGHT_WALL = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
Place = tuple[float, float, float]  # right, down, ahead, or edge lengths along a thing's axes, m


@dataclass(frozen=True, kw_only=True)
class _Tiles(Texture):
    """Square tiles of a little marbled paint, each somewhat brighter or darker, with dark joints.

    Parameters
    ----------
    side, joint : float
        From tile to tile, and the width of the joint between two, in the scene's unit of length.
    spread : float
        Deviation of a tile's grey level from the mean.
    joint_grey : float
        Grey level of joints.
    """

    side: float
    joint: float
    spread: float
    joint_grey: float

    def _grey(self, s: Floats, t: Floats, footprint: Floats, face: int = 0) -> NDArray:
        random = np.random.default_rng([self.seed, face, _TILES])
        shades = self.spread * random.uniform(-1.7, 1.7, (_TILES, _TILES))
        column, row = (np.floor(at / self.side).astype(np.int64) % _TILES for at in (s, t))
        # Tiles that are smaller than a pixel fade into their mean.
        kept = np.clip(self.side / footprint - 1, 0, 1)
        grey = super()._grey(s, t, footprint, face) + kept * shades[row, column]
        bare = (1 - self._joint_share(s, footprint)) * (1 - self._joint_share(t, footprint))
        return np.clip(grey * bare + self.joint_grey * (1 - bare), 0, 255).astype(np.float32)

    def _joint_share(self, at: Floats, footprint: Floats) -> Floats:
        """Return the share of joints in an interval of the footprint's length around points."""

        def joints(end: Floats) -> Floats:  # their length from 0 to there
            whole_tiles = np.floor(end / self.side)
            return whole_tiles * self.joint + np.minimum(end - whole_tiles * self.side, self.joint)

        half = footprint / 2
        return (joints(at + half) - joints(at - half)) / footprint


def room(
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    camera_motion: ArrayLike = (0.12, 0.0, 0.08, 0.003, 0.01, 0.006),
    noise: float = 1.5,
    blur: float = 0.0,
    samples: int = 3,
    dtype: str = "uint8",
) -> SyntheticPair:
    """Render a room at rest, seen from inside: a tiled floor, a few things, and slanted bare walls.

    Walls and ceiling show faint shading alone, and are more than half of the image. The tiles of
    the floor look alike. There are a door with its frame and handle, two pictures and two boxes.
    Lengths are in m: the camera is 1.5 m above the floor, walls are 2 to 4 m away. At the default
    size displacements are about 7 to 24 px; they scale with the size.

    Parameters
    ----------
    height, width : int
        Size of the frames, px.
    seed : int, default 0
        Pattern of the textures and of the noise.
    focal : float, optional
        Focal length, px; by default 0.6 of the width.
    camera_motion : array_like, shape (6,)
        (V, Ω) of the camera in its own axes, m/frame and rad/frame.
    noise : float, default 1.5
        Standard deviation, grey levels, of the noise in both frames, independent at every pixel.
    blur : float, default 0
        Standard deviation, px, of a Gaussian that blurs both frames like a lens out of focus.
    samples, dtype
        As in `Scene.render`.

    Returns
    -------
    SyntheticPair
        Labels are 0 for the far wall, 1 for the right one, 2 for the left one, 3 for the one behind
        the camera, 4 for the ceiling and 5 for the floor; things follow. `textured` is False on
        walls and ceiling.

    Raises
    ------
    ValueError
        If an option is impossible.

    Examples
    --------
    >>> from tisfm.scenes import room
    >>> scene = room(48, 64, noise=0.0)
    >>> scene.depth.shape, bool(scene.textured.mean() < 0.5)
    ((48, 64), True)
    """
    _check_picture(height, width, noise, blur)
    check_dtype(dtype)
    motion = -finite(camera_motion, (6,), "camera_motion")
    camera = Camera(focal=FOCAL * width if focal is None else focal)
    objects: list[Plane | Box] = [*_shell(motion, width, seed), *_things(motion, width, seed)]
    scene = Scene(objects=objects, camera=camera, height=height, width=width)
    pair = scene.render(samples=samples, dtype="float32")
    random = np.random.default_rng(seed)
    frame0, frame1 = (
        taken(frame, random, noise, blur, dtype) for frame in (pair.frame0, pair.frame1)
    )
    return replace(pair, frame0=frame0, frame1=frame1, textured=pair.labels >= _BARE)


@dataclass(frozen=True, kw_only=True, eq=False)
class Film:
    """Frames of a scene at rest from a camera that moves, with exact truth.

    Attributes
    ----------
    frames : (N, H, W) uint8
    depth : (N, H, W) float32
        Z in the axes of each frame, in the scene's unit.
    poses : (N, 4, 4) float64
        Camera to world.
    camera : Camera

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.scenes import room_film
    >>> film = room_film(np.eye(4)[None], 48, 64)
    >>> film.poses.shape, film.camera.focal
    ((1, 4, 4), 38.4)
    """

    frames: NDArray[np.uint8]
    depth: NDArray[np.float32]
    poses: Floats
    camera: Camera


def room_film(
    poses: ArrayLike,
    height: int = 240,
    width: int = 320,
    *,
    seed: int = 0,
    focal: float | None = None,
    textured: bool = False,
    noise: float = 1.5,
    blur: float = 0.0,
    samples: int = 3,
    readout: float = 0.0,
) -> Film:
    """Render the room from a path of the camera.

    Parameters
    ----------
    poses : array_like, shape (N, 4, 4)
        Camera to world, in m; the identity is where `room` has frame 0.
    height, width, seed, focal, noise, blur, samples
        As for `room`. Noise is another one in every frame.
    textured : bool, default False
        Whether walls and ceiling are papered with a pattern, rather than bare.
    readout : float, default 0
        How long a frame is read, row after row, as for `tisfm.Camera`. Poses and depth are those of
        the middle row; between poses, the camera moves and turns evenly.

    Raises
    ------
    ValueError
        If an option is impossible, or a pose is no rigid motion or outside of the room.

    Examples
    --------
    >>> from tisfm.rigid import pose_matrix
    >>> from tisfm.scenes import room_film
    >>> film = room_film([pose_matrix([0.1 * k, 0, 0, 0, 0, 0]) for k in range(3)], 48, 64)
    >>> film.frames.shape, film.depth.shape
    ((3, 48, 64), (3, 48, 64))
    """
    path = check_film(poses, height, width, noise, blur)
    camera = Camera(focal=FOCAL * width if focal is None else focal)
    objects = room_at_rest(width, seed, textured=textured)
    scene = Scene(objects=objects, camera=camera, height=height, width=width)
    random = np.random.default_rng(seed)
    check_readout(readout)
    frames = np.empty((len(path), height, width), np.uint8)
    depth = np.empty((len(path), height, width), np.float32)
    for k, pose in enumerate(path):
        depth[k], _ = scene.depth_and_labels(pose)
        if readout:
            frame = read_in_turn(lambda late: scene, path, k, readout, samples)
        else:
            frame = scene.frame_from(pose, samples=samples)
        frames[k] = taken(frame, random, noise, blur, "uint8")
    return Film(frames=frames, depth=depth, poses=path, camera=camera)


def check_film(
    poses: ArrayLike, height: int, width: int, noise: float, blur: float = 0.0
) -> Floats:
    """Return the path of a film's camera, (N, 4, 4) float64; raise ValueError for bad options."""
    _check_picture(height, width, noise, blur)
    path = np.asarray(poses, np.float64)
    if path.ndim != 3 or path.shape[1:] != (4, 4) or len(path) == 0:
        raise InputError(f"poses is {path.shape}: expected (N, 4, 4), one at least")
    return path


def room_at_rest(width: int, seed: int, *, textured: bool) -> list[Plane | Box]:
    """Return all there is in the room, for pictures of a width, px."""
    still = np.zeros(6)
    return [*_shell(still, width, seed, textured=textured), *_things(still, width, seed)]


def _check_picture(height: int, width: int, noise: float, blur: float) -> None:
    whole(1, height=height, width=width)
    for name, value in (("noise", noise), ("blur", blur)):
        if not 0 <= value < math.inf:
            raise InputError(f"{name} is {value!r}: expected a number of at least 0")


def check_readout(readout: float) -> None:
    """Raise ValueError unless a frame is read within the time to the next."""
    if not -1 <= readout <= 1:
        raise InputError(f"readout is {readout!r}: expected a number from -1 to 1")


def read_in_turn(
    scene_at: Callable[[float], Scene], path: Floats, number: int, readout: float, samples: int
) -> NDArray:
    """Return a frame, (H, W) float32, of which every few rows are seen from where they are read.

    `scene_at` returns the scene so much of an interval after the frame, or before it.
    """
    now = scene_at(0.0)
    cx, cy = now.camera.center_for(now.height, now.width)
    parts = []
    for top in range(0, now.height, _ROWS):
        rows = min(_ROWS, now.height - top)
        late = readout * (top + (rows - now.height) / 2) / now.height
        scene = scene_at(late)
        camera = replace(scene.camera, center=(cx, cy - top))
        part = replace(scene, camera=camera, height=rows)
        parts.append(part.frame_from(_between(path, number, late), samples=samples))
    return np.concatenate(parts)


def _between(path: Floats, number: int, late: float) -> Floats:
    """Return the pose so much of an interval after a frame, or before it."""
    other = number + (1 if late > 0 else -1)
    if not 0 <= other < len(path):  # it went on as it came, or as it will
        other = 2 * number - other
    if not 0 <= other < len(path):
        return path[number]
    motion = np.linalg.inv(path[number]) @ path[other]
    twist = rigid_twist(motion[:3, :3], motion[:3, 3])
    return np.asarray(path[number] @ pose_matrix(late * (other - number) * twist))


def _shell(motion: Floats, width: int, seed: int, *, textured: bool = False) -> list[Plane]:
    """Return walls, ceiling and floor, in the order of their labels."""

    def wall(number: int, mean: float, point: Place, normal: Place) -> Plane:
        if textured:
            wavelength, detail, contrast = wavelength_at(3.0), detail_for(width), 40.0
        else:  # waves of some metres, and hardly any shorter ones: how light falls on it
            wavelength, detail, contrast = 0.7, 0, 11.0
        paint = Texture(
            wavelength=wavelength,
            octaves=5 if textured else 4,
            detail=detail,
            mean=mean,
            contrast=contrast,
            seed=seed + number,
        )
        return Plane(texture=paint, point=_AXES @ point, normal=_AXES @ normal, motion=motion)

    tiles = _Tiles(
        wavelength=wavelength_at(2.5),
        detail=detail_for(width),
        mean=118,
        contrast=7,
        seed=seed + _BARE,
        side=_TILE,
        joint=_JOINT,
        spread=5.0,
        joint_grey=72,
    )
    floor = Plane(
        texture=tiles, point=_AXES @ (0.1, _FLOOR, 0.05), normal=_AXES @ (0, -1, 0), motion=motion
    )
    return [
        wall(0, 196, (0, 0, _AHEAD), (0, 0, -1)),
        wall(1, 176, (_RIGHT, 0, 0), (-1, 0, 0)),
        wall(2, 182, (_LEFT, 0, 0), (1, 0, 0)),
        wall(3, 188, (0, 0, _BEHIND), (0, 0, 1)),
        wall(4, 214, (0, _CEILING, 0), (0, 1, 0)),
        floor,
    ]


def _things(motion: Floats, width: int, seed: int) -> list[Box]:
    """Return a door, pictures, skirting boards and boxes."""
    things: list[Box] = []

    def paint(mean: float, contrast: float) -> Texture:
        return Texture(
            wavelength=wavelength_at(3.5),
            detail=detail_for(width),
            mean=mean,
            contrast=contrast,
            seed=seed + _BARE + 1 + len(things),
        )

    def add(wall: Floats, center: Place, size: Place, texture: Texture) -> None:
        things.append(
            Box(
                texture=texture,
                center=_AXES @ center,
                size=size,
                axes=_AXES @ wall,
                motion=motion,
            )
        )

    def on_far(across: float, down: float, size: Place, texture: Texture) -> None:
        add(_FAR_WALL, (across, down, _AHEAD), (size[0], size[1], 2 * size[2]), texture)

    def on_right(ahead: float, down: float, size: Place, texture: Texture) -> None:
        add(_RIGHT_WALL, (_RIGHT, down, ahead), (size[0], size[1], 2 * size[2]), texture)

    def on_floor(across: float, ahead: float, size: Place, degrees: float) -> None:
        turn, _ = rigid_motion((0, 0, 0, 0, math.radians(degrees), 0))
        add(turn, (across, _FLOOR - size[1] / 2, ahead), size, paint(128, 40))

    # A door of 0.85 × 2 m on the far wall.
    on_far(0.55, 0.5, (0.85, 2.0, 0.015), paint(152, 4))
    for side in (-1, 1):
        on_far(0.55 + side * 0.465, 0.46, (0.08, 2.08, 0.03), paint(205, 2))
    on_far(0.55, -0.54, (0.85, 0.08, 0.03), paint(205, 2))
    on_far(0.21, 0.5, (0.05, 0.18, 0.03), paint(70, 8))
    on_far(0.27, 0.47, (0.14, 0.025, 0.06), paint(60, 8))
    # Skirting boards.
    on_far(-1.28, _FLOOR - 0.05, (2.65, 0.1, 0.012), paint(215, 3))
    on_far(1.68, _FLOOR - 0.05, (1.25, 0.1, 0.012), paint(215, 3))
    on_right(0.5, _FLOOR - 0.05, (6.0, 0.1, 0.012), paint(215, 3))
    # Pictures in their frames.
    for ahead, down, across, high in ((2.55, -0.05, 0.62, 0.46), (1.55, 0.02, 0.4, 0.52)):
        on_right(ahead, down, (across + 0.07, high + 0.07, 0.02), paint(62, 6))
        on_right(ahead, down, (across, high, 0.022), paint(135, 80))
    # Boxes on the floor.
    on_floor(1.55, 2.75, (0.5, 0.42, 0.4), 18)
    on_floor(-0.35, 2.6, (0.3, 0.24, 0.34), -35)
    return things


def wavelength_at(depth: float) -> float:
    """Return the finest wave without detail at a depth, m; the same at every size."""
    return _FINEST * depth / _WIDTH / FOCAL


def detail_for(width: int) -> int:
    """Return how many octaves of shorter waves a picture of a width, px, shows."""
    return max(0, round(math.log2(width / _WIDTH)))


def taken(
    frame: NDArray, random: np.random.Generator, noise: float, blur: float, dtype: str
) -> NDArray:
    """Return a frame, (H, W) float32, as a camera takes it: blurred and noisy, or as it is."""
    if blur:
        frame = cv2.GaussianBlur(frame, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    frame = frame + np.float32(noise) * random.standard_normal(frame.shape, np.float32)
    frame = np.clip(frame, 0, 255)
    return np.rint(frame).astype(np.uint8) if dtype == "uint8" else frame
