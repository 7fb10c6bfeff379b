"""A predefined indoor scene: bare walls, a tiled floor, a door, pictures and boxes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.camera import Camera
from tisfm.checks import Floats, check_finite, check_whole_numbers
from tisfm.errors import InputError
from tisfm.rigid import pose_matrix, rigid_motion, rigid_twist

from .geometry import Box, Plane
from .render import Scene, SyntheticPair, check_dtype
from .texture import Texture

# Rotation of the camera from the normal of the far wall, rad: to the right, and down.
_YAW = math.radians(26)
_PITCH = math.radians(8)
# Positions from the camera along the axes of the room, X right, Y down, Z ahead, m.
_FLOOR_Y = 1.5
_CEILING_Y = -1.15
_FAR_WALL_Z = 3.5
_RIGHT_WALL_X = 2.3
_LEFT_WALL_X = -2.6
_BACK_WALL_Z = -2.5
_TILE_SPACING = 0.33  # m from tile to tile
_JOINT_WIDTH = 0.006  # m
_TILE_PERIOD = 64  # tiles along each axis until their shades repeat
FOCAL = 0.6
"""Default focal length as a share of the width."""

_MIN_WAVELENGTH = 4.0  # px: shortest wave without octaves of detail, in an image of this width:
_REFERENCE_WIDTH = 320  # px
_SHUTTER_ROWS = 2  # rows that are rendered at one instant, with a rolling shutter
_FLOOR_LABEL = 5  # smaller labels belong to the walls and the ceiling
_AXES = (  # columns: the axes of the room, right, down and ahead, in camera axes
    rigid_motion((0, 0, 0, _PITCH, 0, 0))[0] @ rigid_motion((0, 0, 0, 0, -_YAW, 0))[0]
)
# Columns: the axes of a wall in axes of the room: to the right along the wall, down, into the wall.
_FAR_WALL_AXES = np.eye(3)
_RIGHT_WALL_AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
# A position, right, down and ahead, or edge lengths along the axes of a box; m.
Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class _Tiles(Texture):
    """Square tiles with weakly marbled grey levels and different brightness, and dark joints."""

    # spacing, joint_width: distance from tile to tile, and width of a joint, in the scene's unit
    spacing: float
    joint_width: float
    shade_std: float  # standard deviation of the brightness of tiles, grey levels
    joint_grey: float  # grey level of joints

    def _grey(self, s: Floats, t: Floats, footprint: Floats, face: int = 0) -> NDArray:
        random = np.random.default_rng([self.seed, face, _TILE_PERIOD])
        shades = self.shade_std * random.uniform(-1.7, 1.7, (_TILE_PERIOD, _TILE_PERIOD))
        column, row = (np.floor(x / self.spacing).astype(np.int64) % _TILE_PERIOD for x in (s, t))
        # The shades of tiles smaller than a pixel fade out.
        shade_weight = np.clip(self.spacing / footprint - 1, 0, 1)
        grey = super()._grey(s, t, footprint, face) + shade_weight * shades[row, column]
        tile_share = (1 - self._joint_share(s, footprint)) * (1 - self._joint_share(t, footprint))
        return np.clip(grey * tile_share + self.joint_grey * (1 - tile_share), 0, 255).astype(
            np.float32
        )

    def _joint_share(self, x: Floats, footprint: Floats) -> Floats:
        """Return the share of joints in intervals of the length `footprint` around x."""

        def joint_length(end: Floats) -> Floats:  # total length of joints from 0 to `end`
            tiles = np.floor(end / self.spacing)
            return tiles * self.joint_width + np.minimum(
                end - tiles * self.spacing, self.joint_width
            )

        half_footprint = footprint / 2
        return (joint_length(x + half_footprint) - joint_length(x - half_footprint)) / footprint


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
    """Render a room at rest from inside: a tiled floor, a few objects, and slanted bare walls.

    Walls and ceiling have only faint shading, and fill more than half of the image. The tiles of
    the floor are similar to each other. The objects are a door with its frame and handle, two
    pictures and two boxes. Lengths are in m: the camera is 1.5 m above the floor, and the walls are
    2 to 4 m away. At the default size displacements are about 7 to 24 px; they scale with the size.

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
        Labels are 0 for the far wall, 1 for the right wall, 2 for the left wall, 3 for the wall
        behind the camera, 4 for the ceiling, 5 for the floor, and 6 and above for the objects.
        `textured` is False on walls and ceiling.

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
    motion = -check_finite(camera_motion, (6,), "camera_motion")
    camera = Camera(focal=FOCAL * width if focal is None else focal)
    objects: list[Plane | Box] = [*_walls(motion, width, seed), *_furniture(motion, width, seed)]
    scene = Scene(objects=objects, camera=camera, height=height, width=width)
    pair = scene.render(samples=samples, dtype="float32")
    random = np.random.default_rng(seed)
    frame0, frame1 = (
        add_blur_and_noise(frame, random, noise, blur, dtype)
        for frame in (pair.frame0, pair.frame1)
    )
    return replace(pair, frame0=frame0, frame1=frame1, textured=pair.labels >= _FLOOR_LABEL)


@dataclass(frozen=True, kw_only=True, eq=False)
class Film:
    """Frames of a scene at rest from a moving camera, with exact ground truth.

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
    """Render the room along a path of the camera.

    Parameters
    ----------
    poses : array_like, shape (N, 4, 4)
        Camera to world, in m; the identity is the pose of frame 0 in `room`.
    height, width, seed, focal, noise, blur, samples
        As for `room`. The noise of the frames is independent.
    textured : bool, default False
        Whether walls and ceiling have a wallpaper with a pattern, rather than being bare.
    readout : float, default 0
        Readout time of a rolling shutter, as for `tisfm.Camera`. Poses and depth hold at the
        readout of the middle row. Between poses, the camera moves with constant velocity and
        rotation rate.

    Raises
    ------
    ValueError
        If an option is not valid, or a pose is not a rigid motion or is outside of the room.

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
    objects = room_objects(width, seed, textured=textured)
    scene = Scene(objects=objects, camera=camera, height=height, width=width)
    random = np.random.default_rng(seed)
    check_readout(readout)
    frames = np.empty((len(path), height, width), np.uint8)
    depth = np.empty((len(path), height, width), np.float32)
    for k, pose in enumerate(path):
        depth[k], _ = scene.depth_and_labels(pose)
        if readout:
            frame = render_rolling_shutter(lambda delay: scene, path, k, readout, samples)
        else:
            frame = scene.render_frame(pose, samples=samples)
        frames[k] = add_blur_and_noise(frame, random, noise, blur, "uint8")
    return Film(frames=frames, depth=depth, poses=path, camera=camera)


def check_film(
    poses: ArrayLike, height: int, width: int, noise: float, blur: float = 0.0
) -> Floats:
    """Check the options of a film; return the poses, (N, 4, 4) float64."""
    _check_picture(height, width, noise, blur)
    path = np.asarray(poses, np.float64)
    if path.ndim != 3 or path.shape[1:] != (4, 4) or len(path) == 0:
        raise InputError(f"poses is {path.shape}: expected (N, 4, 4), one at least")
    return path


def room_objects(width: int, seed: int, *, textured: bool) -> list[Plane | Box]:
    """Return the objects of the room at rest, for images of a width, px."""
    motion = np.zeros(6)
    return [*_walls(motion, width, seed, textured=textured), *_furniture(motion, width, seed)]


def _check_picture(height: int, width: int, noise: float, blur: float) -> None:
    check_whole_numbers(1, height=height, width=width)
    for name, value in (("noise", noise), ("blur", blur)):
        if not 0 <= value < math.inf:
            raise InputError(f"{name} is {value!r}: expected a number of at least 0")


def check_readout(readout: float) -> None:
    """Raise ValueError unless the readout time is at most the time from frame to frame."""
    if not -1 <= readout <= 1:
        raise InputError(f"readout is {readout!r}: expected a number from -1 to 1")


def render_rolling_shutter(
    scene_at: Callable[[float], Scene], path: Floats, number: int, readout: float, samples: int
) -> NDArray:
    """Return a frame, (H, W) float32, whose rows are rendered at their readout times.

    `path` contains the poses of the frames, (N, 4, 4); `number` is the number of the frame.
    `scene_at` returns the scene at a delay from the frame, in frame intervals; a delay can be
    negative.
    """
    scene0 = scene_at(0.0)
    cx, cy = scene0.camera.center_for(scene0.height, scene0.width)
    bands = []
    for top in range(0, scene0.height, _SHUTTER_ROWS):
        rows = min(_SHUTTER_ROWS, scene0.height - top)
        delay = readout * (top + (rows - scene0.height) / 2) / scene0.height
        scene = scene_at(delay)
        camera = replace(scene.camera, center=(cx, cy - top))
        band = replace(scene, camera=camera, height=rows)
        bands.append(band.render_frame(_interpolate_pose(path, number, delay), samples=samples))
    return np.concatenate(bands)


def _interpolate_pose(path: Floats, number: int, delay: float) -> Floats:
    """Return the pose at a delay from a frame, in frame intervals; a delay can be negative."""
    neighbour = number + (1 if delay > 0 else -1)
    if not 0 <= neighbour < len(path):  # beyond an end of the path: extrapolate the nearest motion
        neighbour = 2 * number - neighbour
    if not 0 <= neighbour < len(path):  # the path has a single pose
        return path[number]
    motion = np.linalg.inv(path[number]) @ path[neighbour]
    twist = rigid_twist(motion[:3, :3], motion[:3, 3])
    return np.asarray(path[number] @ pose_matrix(delay * (neighbour - number) * twist))


def _walls(motion: Floats, width: int, seed: int, *, textured: bool = False) -> list[Plane]:
    """Return walls, ceiling and floor, in the order of their labels."""

    def wall(number: int, mean: float, point: Triple, normal: Triple) -> Plane:
        if textured:
            wavelength, detail, contrast = wavelength_at(3.0), detail_for(width), 40.0
        else:  # waves of some metres and very weak shorter waves, like the shading of a bare wall
            wavelength, detail, contrast = 0.7, 0, 11.0
        texture = Texture(
            wavelength=wavelength,
            octaves=5 if textured else 4,
            detail=detail,
            mean=mean,
            contrast=contrast,
            seed=seed + number,
        )
        return Plane(texture=texture, point=_AXES @ point, normal=_AXES @ normal, motion=motion)

    tiles = _Tiles(
        wavelength=wavelength_at(2.5),
        detail=detail_for(width),
        mean=118,
        contrast=7,
        seed=seed + _FLOOR_LABEL,
        spacing=_TILE_SPACING,
        joint_width=_JOINT_WIDTH,
        shade_std=5.0,
        joint_grey=72,
    )
    floor = Plane(
        texture=tiles, point=_AXES @ (0.1, _FLOOR_Y, 0.05), normal=_AXES @ (0, -1, 0), motion=motion
    )
    return [
        wall(0, 196, (0, 0, _FAR_WALL_Z), (0, 0, -1)),
        wall(1, 176, (_RIGHT_WALL_X, 0, 0), (-1, 0, 0)),
        wall(2, 182, (_LEFT_WALL_X, 0, 0), (1, 0, 0)),
        wall(3, 188, (0, 0, _BACK_WALL_Z), (0, 0, 1)),
        wall(4, 214, (0, _CEILING_Y, 0), (0, 1, 0)),
        floor,
    ]


def _furniture(motion: Floats, width: int, seed: int) -> list[Box]:
    """Return a door, pictures, skirting boards and boxes."""
    boxes: list[Box] = []

    def make_texture(mean: float, contrast: float) -> Texture:
        return Texture(
            wavelength=wavelength_at(3.5),
            detail=detail_for(width),
            mean=mean,
            contrast=contrast,
            seed=seed + _FLOOR_LABEL + 1 + len(boxes),
        )

    def add_box(axes: Floats, center: Triple, size: Triple, surface: Texture) -> None:
        boxes.append(
            Box(texture=surface, center=_AXES @ center, size=size, axes=_AXES @ axes, motion=motion)
        )

    def add_to_far_wall(right: float, down: float, size: Triple, surface: Texture) -> None:
        add_box(
            _FAR_WALL_AXES, (right, down, _FAR_WALL_Z), (size[0], size[1], 2 * size[2]), surface
        )

    def add_to_right_wall(ahead: float, down: float, size: Triple, surface: Texture) -> None:
        add_box(
            _RIGHT_WALL_AXES,
            (_RIGHT_WALL_X, down, ahead),
            (size[0], size[1], 2 * size[2]),
            surface,
        )

    def add_to_floor(right: float, ahead: float, size: Triple, degrees: float) -> None:
        axes, _ = rigid_motion((0, 0, 0, 0, math.radians(degrees), 0))
        add_box(axes, (right, _FLOOR_Y - size[1] / 2, ahead), size, make_texture(128, 40))

    # A door of 0.85 × 2 m on the far wall.
    add_to_far_wall(0.55, 0.5, (0.85, 2.0, 0.015), make_texture(152, 4))
    for side in (-1, 1):
        add_to_far_wall(0.55 + side * 0.465, 0.46, (0.08, 2.08, 0.03), make_texture(205, 2))
    add_to_far_wall(0.55, -0.54, (0.85, 0.08, 0.03), make_texture(205, 2))
    add_to_far_wall(0.21, 0.5, (0.05, 0.18, 0.03), make_texture(70, 8))
    add_to_far_wall(0.27, 0.47, (0.14, 0.025, 0.06), make_texture(60, 8))
    # Skirting boards.
    add_to_far_wall(-1.28, _FLOOR_Y - 0.05, (2.65, 0.1, 0.012), make_texture(215, 3))
    add_to_far_wall(1.68, _FLOOR_Y - 0.05, (1.25, 0.1, 0.012), make_texture(215, 3))
    add_to_right_wall(0.5, _FLOOR_Y - 0.05, (6.0, 0.1, 0.012), make_texture(215, 3))
    # Pictures in their frames.
    for ahead, down, picture_width, picture_height in (
        (2.55, -0.05, 0.62, 0.46),
        (1.55, 0.02, 0.4, 0.52),
    ):
        add_to_right_wall(
            ahead, down, (picture_width + 0.07, picture_height + 0.07, 0.02), make_texture(62, 6)
        )
        add_to_right_wall(
            ahead, down, (picture_width, picture_height, 0.022), make_texture(135, 80)
        )
    # Boxes on the floor.
    add_to_floor(1.55, 2.75, (0.5, 0.42, 0.4), 18)
    add_to_floor(-0.35, 2.6, (0.3, 0.24, 0.34), -35)
    return boxes


def wavelength_at(depth: float) -> float:
    """Return the shortest wavelength, m, of a texture at a depth, m, without octaves of detail."""
    return _MIN_WAVELENGTH * depth / _REFERENCE_WIDTH / FOCAL


def detail_for(width: int) -> int:
    """Return the number of octaves of shorter waves for an image of a width, px."""
    return max(0, round(math.log2(width / _REFERENCE_WIDTH)))


def add_blur_and_noise(
    frame: NDArray, random: np.random.Generator, noise: float, blur: float, dtype: str
) -> NDArray:
    """Blur and add noise to a frame, (H, W) float32; `blur` and `noise` are standard deviations."""
    if blur:
        frame = cv2.GaussianBlur(frame, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    frame = frame + np.float32(noise) * random.standard_normal(frame.shape, np.float32)
    frame = np.clip(frame, 0, 255)
    return np.rint(frame).astype(np.uint8) if dtype == "uint8" else frame
