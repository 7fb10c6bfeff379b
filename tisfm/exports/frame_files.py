"""Frames of a reconstruction, and masks of moving objects, as files of an export."""

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
AT_REST = 255  # level of the static scene in a mask


def name_of(frame: int) -> str:
    """Return the file name of a frame, as in the folder of the reconstruction."""
    return f"{frame:06d}.jpg"


def check_images(images: str) -> None:
    """Raise ValueError unless `images` is a choice of `Images`."""
    if images not in get_args(Images):
        raise InputError(f"images is {images!r}: expected 'copy', 'link' or 'none'")


def has_masks(result: Reconstruction) -> bool:
    """Return whether a reconstruction has labels of moving objects."""
    return result.settings.motion == "objects"


def write_pictures(
    result: Reconstruction, frames: Sequence[int], folder: Path, images: Images
) -> None:
    """Copy the pictures of frames, byte for byte, or link them.

    Links are hard links, which stay valid if the reconstruction is moved, deleted or replaced. The
    file is copied if the file system has no hard links, or the picture is a symbolic link.

    Raises FileNotFoundError, tisfm.formats.FormatError if a picture is missing or damaged, or of
    another size.
    """
    folder.mkdir()
    for frame in frames:
        picture_of(result, frame)
        source, target = result.folder / PICTURES / name_of(frame), folder / name_of(frame)
        take = link_or_copy if images == "link" else copy_file
        take(source, target)


def write_masks(result: Reconstruction, frames: Sequence[int], folder: Path, suffix: str) -> None:
    """Write masks of frames as PNG: 255 for the static scene, 0 for moving objects.

    Parameters
    ----------
    result : Reconstruction
    frames : sequence of int
    folder : Path
        Made here.
    suffix : str
        Replaces the suffix of the picture: ``.png``, or ``.jpg.png`` for COLMAP.
    """
    folder.mkdir()
    for frame in frames:
        at_rest = np.where(result.labels(frame) == 0, AT_REST, 0).astype(np.uint8)
        write_png(folder / Path(name_of(frame)).with_suffix(suffix), at_rest)


def picture_of(result: Reconstruction, frame: int) -> np.ndarray:
    """Return the picture of a frame, (H, W) or (H, W, 3) RGB uint8.

    Raises FileNotFoundError, tisfm.formats.FormatError if the file is missing or damaged, or its
    size is not that of the reconstruction.
    """
    picture = result.picture(frame)
    if picture.shape[:2] != result.shape:
        raise FormatError(
            f"the picture of frame {frame} in {result.folder} is {picture.shape[:2]}: expected "
            f"{result.shape}"
        )
    return picture
