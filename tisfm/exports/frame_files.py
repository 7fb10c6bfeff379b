"""Frames of a reconstruction as files of an export, and what in them moves on its own."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from tisfm.errors import InputError
from tisfm.formats import FormatError, write_png
from tisfm.formats.atomic import copy_file, link_or_copy
from tisfm.reconstruction.result.folder import PICTURES
from tisfm.reconstruction.result.reconstruction import Reconstruction

Images = Literal["copy", "link", "none"]
AT_REST = 255  # of a mask: what counts


def name_of(frame: int) -> str:
    """Return what the picture of a frame is called, as in the folder of the reconstruction."""
    return f"{frame:06d}.jpg"


def check_images(images: str) -> None:
    """Raise ValueError if that is no way to take the frames along."""
    if images not in get_args(Images):
        raise InputError(f"images is {images!r}: expected 'copy', 'link' or 'none'")


def has_masks(result: Reconstruction) -> bool:
    """Return whether it says of every pixel what moves on its own."""
    return result.settings.motion == "objects"


def write_pictures(
    result: Reconstruction, frames: Sequence[int], folder: Path, images: Images
) -> None:
    """Copy the pictures of frames, byte for byte, or link them.

    A link is a hard one, where the file system has such: it stays right if the reconstruction is
    moved, deleted or made anew. Elsewhere the file is copied, and so is the picture that a symbolic
    link in the reconstruction leads to.

    Raises
    ------
    FileNotFoundError, tisfm.formats.FormatError
        If a picture is missing or damaged, or of another size.
    """
    folder.mkdir()
    for frame in frames:
        picture_of(result, frame)
        source, target = result.folder / PICTURES / name_of(frame), folder / name_of(frame)
        take = link_or_copy if images == "link" else copy_file
        take(source, target)


def write_masks(result: Reconstruction, frames: Sequence[int], folder: Path, suffix: str) -> None:
    """Write which pixels of frames are at rest, as PNG: 255 if so, 0 of what moves on its own.

    Parameters
    ----------
    result : Reconstruction
    frames : sequence of int
    folder : Path
        Made here.
    suffix : str
        In place of the picture's: ``.png``, or ``.jpg.png`` as COLMAP has it.
    """
    folder.mkdir()
    for frame in frames:
        at_rest = np.where(result.labels(frame) == 0, AT_REST, 0).astype(np.uint8)
        write_png(folder / Path(name_of(frame)).with_suffix(suffix), at_rest)


def picture_of(result: Reconstruction, frame: int) -> np.ndarray:
    """Return the picture of a frame, (H, W) or (H, W, 3) RGB uint8.

    Raises
    ------
    FileNotFoundError, tisfm.formats.FormatError
        If it is missing or damaged, or has another size than the reconstruction says.
    """
    picture = result.picture(frame)
    if picture.shape[:2] != result.shape:
        raise FormatError(
            f"the picture of frame {frame} in {result.folder} is {picture.shape[:2]}: expected "
            f"{result.shape}"
        )
    return picture
