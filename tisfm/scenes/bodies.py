"""A ready film of bodies that turn as they go, and pass behind each other, in a room."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.camera import Camera
from tisfm.checks import Floats, whole
from tisfm.rigid import pose_matrix

from .geometry import Box, Plane
from .render import Scene
from .room import _FOCAL, Film, _detail, _shell, _taken, _things, _wavelength
from .texture import Texture

# Of each body, in the axes of the first camera: where it begins and ends, m, how far it turns in
# all, rad, its edge lengths, m, and how far it sways to the side, down and ahead, m.
_BODIES = (
    ((-1.05, 0.15, 1.80), (0.95, 0.05, 1.85), (0.5, 2.2, 0.2), (0.50, 0.50, 0.40), (0, 0.12, 0.1)),
    ((1.00, -0.20, 2.30), (-0.45, 0.05, 2.45), (-0.4, -1.8, 0.3), (0.50, 0.60, 0.45), (0, 0.2, 0)),
    ((0.05, 0.20, 2.60), (0.80, -0.30, 2.40), (0.6, 1.4, -0.5), (0.50, 0.45, 0.45), (0, 0.1, 0)),
)
_LEANING = (0.2, 0.5, -0.1)  # rad, of a body at first
# Of the camera over the film: how far it goes, m, and turns, rad; and how far it sways.
_WAY, _SWAY = np.array([0.6, 0.05, 0.32, 0.01, 0.08, 0.0]), np.array([0, 0.06, 0, 0.02, 0, 0.02])


@dataclass(frozen=True, kw_only=True, eq=False)
class BodiesFilm(Film):
    """A film in which bodies move on their own, with exact truth.

    Attributes
    ----------
    labels : (N, H, W) uint8
        0 for what is at rest, k for body k.
    body_poses : (K, N, 4, 4) float64
        Body to world, of each of K bodies in every frame.
    sizes : (K, 3) float64
        Edge lengths of the bodies along their axes, m.
    """

    labels: NDArray[np.uint8]
    body_poses: Floats
    sizes: Floats


def bodies_film(
    count: int = 40,
    height: int = 240,
    width: int = 320,
    *,
    poses: ArrayLike | None = None,
    bodies: int = 3,
    seed: int = 0,
    noise: float = 1.5,
    samples: int = 3,
) -> BodiesFilm:
    """Render a papered room in which boxes turn, go their ways, and pass behind each other.

    The first goes to the right before the others, of which the second comes towards it and the
    third goes the same way behind it. In 40 frames of the default size they go 1 to 5 px a frame
    before the room, and turn by up to 3°.

    Parameters
    ----------
    count : int
        Of frames: the bodies go the same ways in as many steps.
    height, width, seed, noise, samples
        As for `tisfm.scenes.room_film`.
    poses : array_like, shape (count, 4, 4), optional
        Of the camera, camera to world; by default it goes to the right and forward, and turns.
    bodies : int
        From 0 to 3.

    Raises
    ------
    ValueError
        If an option is impossible, or a pose is no rigid motion or outside of the room.
    """
    whole(1, count=count, height=height, width=width)
    if bodies not in range(len(_BODIES) + 1):
        raise ValueError(f"bodies is {bodies!r}: expected a number from 0 to {len(_BODIES)}")
    at = np.linspace(0, 1, count)
    path = np.asarray(_path(at) if poses is None else poses, np.float64)
    if path.shape != (count, 4, 4):
        raise ValueError(f"poses is {path.shape}: expected ({count}, 4, 4)")
    camera = Camera(focal=_FOCAL * width)
    still = np.zeros(6)
    around: list[Plane | Box] = [
        *_shell(still, width, seed, textured=True),
        *_things(still, width, seed),
    ]
    body_poses = np.array([_poses_of(k, at) for k in range(bodies)]).reshape(bodies, count, 4, 4)
    random = np.random.default_rng(seed)
    frames, labels = (np.empty((count, height, width), np.uint8) for _ in range(2))
    depth = np.empty((count, height, width), np.float32)
    for frame, pose in enumerate(path):
        moving = [_body(k, body_poses[k, frame], width, seed) for k in range(bodies)]
        scene = Scene(objects=[*around, *moving], camera=camera, height=height, width=width)
        seen, depth[frame], of_objects = scene._seen(pose, samples)
        labels[frame] = np.maximum(of_objects - len(around) + 1, 0)
        frames[frame] = _taken(seen, random, noise, 0.0, "uint8")
    return BodiesFilm(
        frames=frames,
        depth=depth,
        poses=path,
        camera=camera,
        labels=labels,
        body_poses=body_poses,
        sizes=np.array([_BODIES[k][3] for k in range(bodies)]).reshape(bodies, 3),
    )


def _poses_of(body: int, at: Floats) -> Floats:
    """Return the poses, (N, 4, 4), of a body at shares of its way."""
    begin, end, turn, _, sway = _BODIES[body]
    found = []
    for part in at:
        pose = pose_matrix(np.r_[0, 0, 0, part * np.array(turn)])
        pose = pose @ pose_matrix(np.r_[0, 0, 0, _LEANING])
        pose[:3, 3] = (1 - part) * np.array(begin) + part * np.array(end)
        pose[:3, 3] += np.sin(2 * np.pi * part + body) * np.array(sway)
        found.append(pose)
    return np.array(found)


def _path(at: Floats) -> Floats:
    """Return the poses, (N, 4, 4), of the camera at shares of its way."""
    sway = np.sin(3 * np.pi * at)[:, None] * _SWAY
    return np.array([pose_matrix(twist) for twist in at[:, None] * _WAY + sway])


def _body(body: int, pose: Floats, width: int, seed: int) -> Box:
    paint = Texture(
        wavelength=_wavelength(2.2), detail=_detail(width), mean=125, contrast=45, seed=seed + 50 + body
    )
    return Box(texture=paint, center=pose[:3, 3], size=_BODIES[body][3], axes=pose[:3, :3])
