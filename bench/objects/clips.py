"""Sequences with true masks of moving objects: clips of DAVIS, and rendered films."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.evaluation.moving_objects import find_true_masks
from tisfm.formats import read_image
from tisfm.formats.label_picture import read_label_picture
from tisfm.rigid import pose_matrix
from tisfm.scenes import Film, bodies_film, bodies_path, walkers_film

FOLDER = "davis"  # in the folder of sequences
DAVIS = "DAVIS"  # group of clips
RENDERED = "rendered"  # group of clips
RENDERED_CLIPS = ("bodies", "walkers", "walkers, back")
FRAMES = 40  # of a rendered film
SIZE = (240, 320)  # px, height and width of a rendered film
SMOKE_SIZE, SMOKE_FRAMES = (60, 80), 6  # in a smoke run


@dataclass(frozen=True, kw_only=True, eq=False)
class Clip:
    name: str
    group: str
    frames: list[NDArray[np.uint8]]  # (H, W) grey or (H, W, 3) RGB
    truth: list[NDArray[np.uint8]]  # (H, W); 0 for the static scene, else the object
    camera: Camera | None = None
    film: Film | None = None  # of a rendered clip, with the true depth and camera path
    body_poses: NDArray[np.float64] | None = None  # (K, N, 4, 4), object to world, of rigid objects

    @property
    def grey(self) -> list[NDArray[np.uint8]]:
        return [grey_of(frame) for frame in self.frames]


def grey_of(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:  # (H, W)
    if frame.ndim == 2:
        return frame
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY), np.uint8)


def render_clip(name: str, *, small: bool = False) -> Clip:
    """Render one of `RENDERED_CLIPS`: boxes that fly through a room, or walkers in a street."""
    count, size = (SMOKE_FRAMES, SMOKE_SIZE) if small else (FRAMES, SIZE)
    path = bodies_path(count)
    if name == "bodies":
        bodies = bodies_film(path, *size)
        return _clip_of(name, bodies, bodies.labels, bodies.body_poses)
    if name == "walkers, back":
        steps = [(0.03 * k, 0, -0.02 * k, 0, 0.002 * k, 0) for k in range(count)]
        path = np.array([pose_matrix(step) for step in steps])
    walkers = walkers_film(path, *size, seed=len(name))
    return _clip_of(name, walkers, walkers.labels, None)


def _clip_of(
    name: str, film: Film, labels: NDArray[np.uint8], body_poses: NDArray[np.float64] | None
) -> Clip:
    return Clip(
        name=name,
        group=RENDERED,
        frames=list(film.frames),
        truth=list(labels),
        camera=film.camera,
        film=film,
        body_poses=body_poses,
    )


def davis_folders(data: Path) -> list[Path]:
    """Return the folders of the DAVIS clips; an empty result if DAVIS is absent."""
    folder = data / FOLDER
    if not folder.is_dir():
        return []
    return sorted(clip for clip in folder.iterdir() if (clip / "images").is_dir())


def davis_clip(folder: Path) -> Clip:
    """Read a clip; raise ValueError if the numbers of masks and images differ."""
    images, masks = (_pictures(part) for part in (folder / "images", find_true_masks(folder)))
    if len(images) != len(masks):
        raise ValueError(f"{folder} has {len(images)} images and {len(masks)} masks")
    return Clip(
        name=folder.name,
        group=DAVIS,
        frames=[read_image(file) for file in images],
        truth=[read_label_picture(file) for file in masks],
    )


def _pictures(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in (".jpg", ".png"))


def neighbours(count: int, number: int, nearest: int, end: int) -> Iterator[int]:
    """Yield the frames on both sides of a frame, at distances from `end` − 1 down to `nearest`."""
    for distance in range(end - 1, nearest - 1, -1):
        for other in (number - distance, number + distance):
            if 0 <= other < count:
                yield other
