"""Small films of a room, with exact truth."""

import numpy as np

from tests.rendered import room_film, shared
from tisfm.camera import Camera
from tisfm.rigid import pose_matrix
from tisfm.scenes import Box, Film, Scene, Texture, bodies_path
from tisfm.scenes.room import FOCAL, add_blur_and_noise, room_objects, wavelength_at

STEP = np.array((0.12, 0.0, 0.05, 0.0, 0.012, 0.0))  # of the camera in a frame: m and rad


def along(count, step=STEP):
    """Return the poses of a camera with the same motion in every frame."""
    return np.array([pose_matrix(k * np.asarray(step)) for k in range(count)])


def walk(count=9, height=180, width=240, *, seed=0):
    """Return a film of `count` frames."""
    return room_film(along(count), height, width, samples=2, seed=seed)


def there_and_back(film):
    """Return the frames of a film, then the same views in reverse with more noise."""
    noise = np.random.default_rng(1).normal(0, 0.5, film.frames.shape)
    back = np.clip(np.rint(film.frames + noise), 0, 255).astype(np.uint8)[::-1]
    return [*film.frames, *back]


def mirrored(film):
    """Return the frames of a film as in a mirror: they look like another scene."""
    return list(np.ascontiguousarray(film.frames[:, :, ::-1]))


@shared
def board_film(count=10, height=120, width=160, *, with_board=True):
    """Return a film of a papered room, and the mask of a board, (N, H, W) bool.

    The board fills a third of the frames, has more contrast than the room, and moves on its own.
    """
    path, camera, random = bodies_path(count), Camera(focal=FOCAL * width), np.random.default_rng(0)
    room = room_objects(width, 0, textured=True)
    paint = Texture(wavelength=wavelength_at(1.6), octaves=4, mean=120, contrast=60, seed=100)
    frames, depth, seen = [], [], []
    for k, pose in enumerate(path):
        board = Box(
            texture=paint,
            center=np.array((-0.2, -0.05, 1.6)) + k * np.array((0.03, -0.012, 0.0)),
            size=(1.15, 1.035, 0.5),
            axes=pose_matrix(k * np.array((0, 0, 0, 0.006, -0.012, 0.008)))[:3, :3],
        )
        objects = [*room, board] if with_board else room
        scene = Scene(objects=objects, camera=camera, height=height, width=width)
        frame, far, labels = scene.render_view_with_labels(pose, samples=2)
        frames.append(add_blur_and_noise(frame, random, 1.5, 0.0, "uint8"))
        depth.append(far)
        seen.append(labels >= len(room))
    film = Film(frames=np.stack(frames), depth=np.stack(depth), poses=path, camera=camera)
    return film, np.stack(seen)


def path_error(found, true):
    """Return the rmse of camera centres after a similarity, over the length of the true path."""
    from tisfm.metrics import absolute_errors, path_length

    return absolute_errors(found, true).similarity / path_length(true)


def depth_error(depth, true, scale=1.0):
    """Return the mean relative error of a depth map; a pixel without depth has the error 1."""
    error = np.abs(scale * depth - true) / true
    return float(np.nan_to_num(error, nan=1.0).mean())
