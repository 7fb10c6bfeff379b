"""Sequences with true masks of moving objects: clips of DAVIS, and the film of bodies."""

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
from tisfm.scenes import BodiesFilm, bodies_film, bodies_path

FOLDER = "davis"  # in the folder of sequences
DAVIS = "DAVIS"  # group of clips
BODIES = "bodies"  # group of clips
FRAMES = 40  # of the film
SIZE = (240, 320)  # px, height and width of the film
SMOKE_FRAMES = 6  # of the film in a smoke run


@dataclass(frozen=True, kw_only=True, eq=False)
class Clip:
    name: str
    group: str
    frames: list[NDArray[np.uint8]]  # (H, W) grey or (H, W, 3) RGB
    truth: list[NDArray[np.uint8]]  # (H, W); 0 for the static scene, else the object
    camera: Camera | None = None
    film: BodiesFilm | None = None  # of a rendered clip, with the true paths

    @property
    def grey(self) -> list[NDArray[np.uint8]]:
        return [grey_of(frame) for frame in self.frames]


def grey_of(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:  # (H, W)
    if frame.ndim == 2:
        return frame
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY), np.uint8)


def render_clip(*, small: bool = False) -> Clip:
    height, width = (60, 80) if small else SIZE
    film = bodies_film(bodies_path(SMOKE_FRAMES if small else FRAMES), height, width)
    return Clip(
        name="bodies",
        group=BODIES,
        frames=list(film.frames),
        truth=list(film.labels),
        camera=film.camera,
        film=film,
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
