"""A predefined scene with moving objects: boxes that fly through the room."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.camera import Camera
from tisfm.checks import Floats, check_whole_numbers
from tisfm.errors import InputError
from tisfm.rigid import pose_matrix

from .geometry import Box
from .render import Scene
from .room import (
    FOCAL,
    Film,
    add_blur_and_noise,
    check_film,
    check_readout,
    detail_for,
    render_rolling_shutter,
    room_objects,
    wavelength_at,
)
from .texture import Texture


@dataclass(frozen=True, kw_only=True, eq=False)
class BodiesFilm(Film):
    """Frames of K moving bodies in a room at rest, with exact truth.

    Attributes
    ----------
    frames, depth, poses, camera
        As in `Film`.
    labels : (N, H, W) uint8
        Object at the centre of each pixel: 0 for the room, 1 to K for a body.
    body_poses : (K, N, 4, 4) float64
        Body to world; the axes of a body are along its edges, with the origin at its centre.
    body_sizes : (K, 3) float64
        Edge lengths along the body's axes, m.

    Examples
    --------
    >>> from tisfm.scenes import bodies_film, bodies_path
    >>> film = bodies_film(bodies_path(2), 48, 64)
    >>> film.labels.shape, film.body_sizes.shape
    ((2, 48, 64), (3, 3))
    """

    labels: NDArray[np.uint8]
    body_poses: Floats
    body_sizes: Floats


@dataclass(frozen=True, kw_only=True)
class _Flight:
    """The path of a body: it swings along each axis of the world, and rotates steadily."""

    size: tuple[float, float, float]  # edge lengths, m
    # center, amplitude: centre and amplitude of the swing along each axis, (3,), m
    center: tuple[float, float, float]
    amplitude: tuple[float, float, float]
    period: tuple[float, float, float]  # period of the swing along each axis, (3,), frames
    # frame in which the body passes the centre along each axis, (3,)
    center_frame: tuple[float, float, float]
    rotation_rate: tuple[float, float, float]  # (3,), rad/frame
    mean_grey: float  # mean grey level of the texture

    def pose(self, number: float) -> Floats:
        """Return the pose, body to world, (4, 4), at a frame number; fractions are allowed."""
        swing = np.sin(2 * np.pi * (number - np.array(self.center_frame)) / np.array(self.period))
        pose = pose_matrix(np.array([0, 0, 0, *self.rotation_rate]) * number)
        pose[:3, 3] = np.array(self.center) + np.array(self.amplitude) * swing
        return pose


_FLIGHTS = (
    # From the left to the right and back.
    _Flight(
        size=(0.6, 0.5, 0.4),
        center=(-0.1, 0.1, 2.15),
        amplitude=(1.05, 0.08, 0.05),
        period=(130, 70, 90),
        center_frame=(23, 0, 10),
        rotation_rate=(0.006, 0.03, 0.004),
        mean_grey=92,
    ),
    # From the right to the left and back, behind the first body.
    _Flight(
        size=(0.6, 0.5, 0.42),
        center=(-0.34, 0.17, 2.93),
        amplitude=(-0.83, 0.05, 0.03),
        period=(110, 80, 60),
        center_frame=(22, 30, 0),
        rotation_rate=(-0.01, -0.035, 0.006),
        mean_grey=168,
    ),
    # Up and down, in front of both.
    _Flight(
        size=(0.41, 0.4, 0.38),
        center=(0.38, 0.08, 1.45),
        amplitude=(0.25, 0.38, 0.05),
        period=(80, 48, 100),
        center_frame=(8, 11, 30),
        rotation_rate=(0.02, 0.025, -0.012),
        mean_grey=132,
    ),
)


def bodies_film(
    poses: ArrayLike,
    height: int = 240,
    width: int = 320,
    *,
    bodies: int = 3,
    seed: int = 0,
    focal: float | None = None,
    textured: bool = True,
    noise: float = 1.5,
    samples: int = 2,
    readout: float = 0.0,
) -> BodiesFilm:
    """Render the room with rotating boxes that fly through it, along a path of the camera.

    The boxes have edges of about half a metre, and swing from one side of the image to the other.
    With the poses of `bodies_path`, all boxes are visible in the first frames. At the default size
    each box moves by 1.5 to 9 px/frame relative to the room. Within 40 frames the third box
    occludes the first for some frames, and the first occludes the second.

    Parameters
    ----------
    poses : array_like, shape (N, 4, 4)
        Camera to world, in m; the identity is the pose of frame 0 in `room`.
    height, width : int
        Size of the frames, px.
    bodies : int, default 3
        Number of boxes, 0 to 3. The motion and texture of a box do not depend on this number.
    seed : int, default 0
        Pattern of the textures and of the noise. Paths of camera and bodies do not depend on it.
    focal : float, optional
        Focal length, px; by default 0.6 of the width.
    textured : bool, default True
        Whether walls and ceiling have a wallpaper with a pattern, rather than being bare.
    noise : float, default 1.5
        Standard deviation, grey levels, of the noise, independent at every pixel of every frame.
    samples : int, default 2
        Rays per pixel side, as in `Scene.render`.
    readout : float, default 0
        As for `room_film`; the bodies also move while a frame is read. The ground truth is the
        truth at the readout of the middle row.

    Returns
    -------
    BodiesFilm
        Frames and truth.

    Raises
    ------
    ValueError
        If an option is not valid, or a pose is not a rigid motion or is outside of the room.

    Examples
    --------
    >>> from tisfm.scenes import bodies_film, bodies_path
    >>> film = bodies_film(bodies_path(3), 48, 64, bodies=2)
    >>> film.frames.shape, film.body_poses.shape
    ((3, 48, 64), (2, 3, 4, 4))
    """
    path = check_film(poses, height, width, noise)
    check_readout(readout)
    check_whole_numbers(0, bodies=bodies)
    if bodies > len(_FLIGHTS):
        raise InputError(f"bodies is {bodies}: expected {len(_FLIGHTS)} at most")
    camera = Camera(focal=FOCAL * width if focal is None else focal)
    flights = _FLIGHTS[:bodies]
    static_objects = room_objects(width, seed, textured=textured)
    textures = [_body_texture(flight, width, seed, number) for number, flight in enumerate(flights)]
    body_poses = np.array(
        [[flight.pose(number) for number in range(len(path))] for flight in flights]
    ).reshape(bodies, len(path), 4, 4)
    frames = np.empty((len(path), height, width), np.uint8)
    depth = np.empty((len(path), height, width), np.float32)
    labels = np.empty((len(path), height, width), np.uint8)
    random = np.random.default_rng(seed)

    def scene_at(frame: int, delay: float) -> Scene:
        box_poses = [flight.pose(frame + delay) for flight in flights]
        boxes = [
            Box(texture=texture, center=pose[:3, 3], size=flight.size, axes=pose[:3, :3])
            for flight, texture, pose in zip(flights, textures, box_poses, strict=True)
        ]
        return Scene(objects=[*static_objects, *boxes], camera=camera, height=height, width=width)

    for k, pose in enumerate(path):
        scene = scene_at(k, 0.0)
        depth[k], scene_labels = scene.depth_and_labels(pose)
        if readout:
            frame = render_rolling_shutter(partial(scene_at, k), path, k, readout, samples)
        else:
            frame = scene.render_frame(pose, samples=samples)
        frames[k] = add_blur_and_noise(frame, random, noise, 0.0, "uint8")
        labels[k] = np.maximum(scene_labels - len(static_objects) + 1, 0)
    return BodiesFilm(
        frames=frames,
        depth=depth,
        poses=path,
        camera=camera,
        labels=labels,
        body_poses=body_poses,
        body_sizes=np.array([flight.size for flight in flights]).reshape(bodies, 3),
    )


def bodies_path(count: int = 40) -> Floats:
    """Return poses, (count, 4, 4), of a camera that observes the bodies of `bodies_film`.

    For 40 frames the camera moves sideways and forward and rotates slightly. Then it moves back in
    40 frames, and so on.

    Parameters
    ----------
    count : int, default 40
        Number of frames.

    Raises
    ------
    ValueError
        If `count` is not a positive whole number.

    Examples
    --------
    >>> from tisfm.scenes import bodies_path
    >>> bodies_path(20).shape
    (20, 4, 4)
    """
    check_whole_numbers(1, count=count)
    steps = 40 * np.abs((np.arange(count) / 40 + 1) % 2 - 1)
    return np.array([pose_matrix((0.022 * k, 0, 0.006 * k, 0, -0.003 * k, 0)) for k in steps])


def _body_texture(flight: _Flight, width: int, seed: int, number: int) -> Texture:
    return Texture(
        wavelength=wavelength_at(flight.center[2]),
        octaves=4,
        detail=detail_for(width),
        mean=flight.mean_grey,
        contrast=42.0,
        seed=seed + 100 + number,
    )
