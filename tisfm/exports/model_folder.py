"""The folder of an exported model: frames and masks in it, and its replacement as a whole."""

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from tisfm.errors import InputError
from tisfm.folders.result_folder import LOCK, locked_folder, make_result_folder, remove
from tisfm.formats import FormatError, atomic_write, write_png
from tisfm.formats.atomic import copy_file, is_temporary, link_or_copy
from tisfm.reconstruction.result.folder import PICTURES, has_labels
from tisfm.reconstruction.result.reconstruction import Reconstruction

FORMAT = 1  # version of ``export.json``
RECORD = "export.json"  # written last, removed first
IMAGES, MASKS, MODELS = "images", "masks", "sparse"
TRANSFORMS, POINTS = "transforms.json", "sparse_points.ply"
ENTRIES = (RECORD, IMAGES, MASKS, MODELS, TRANSFORMS, POINTS)  # of the folder
_SYSTEM_FILES = {".DS_Store", "Thumbs.db", "desktop.ini"}  # file browsers write them
NEW, EARLIER = ".tisfm-new", ".tisfm-earlier"


@contextmanager
def open_export(
    folder: str | PathLike[str],  # made if it does not exist
    record: dict[str, Any],  # contents of ``export.json``; the block may add to it
) -> Iterator[Path]:
    """Yield a new folder to write an export to; it replaces the earlier export when the block ends.

    If an exception leaves the block, the earlier export stays, or the folder is removed if it is
    new. The next export removes what a killed process has left.

    Raises FileExistsError if the folder holds files that no export wrote.

    Raises OSError if the folder cannot be made or written to, or another run writes to it.
    """
    is_new_folder = not Path(folder).exists()
    path = make_result_folder(folder)
    try:
        with _new_folder(path, record) as new_folder:
            yield new_folder
    except BaseException:
        if is_new_folder:
            with suppress(OSError):  # the folder has other files by now
                path.rmdir()
        raise


@contextmanager
def _new_folder(path: Path, record: dict[str, Any]) -> Iterator[Path]:
    """Yield the new folder inside a folder that exists."""
    with locked_folder(path):
        refuse_foreign_files(path)
        remove(path / NEW)
        (path / NEW).mkdir()
        try:
            yield path / NEW
            with atomic_write(path / NEW / RECORD, durable=True) as file:
                file.write(json.dumps({"format": FORMAT, **record}, indent=1).encode())
        except BaseException:
            shutil.rmtree(path / NEW, ignore_errors=True)
            raise
        _replace_earlier(path)


def _replace_earlier(path: Path) -> None:
    """Replace the earlier export by the new one; ``export.json`` goes first and comes last."""
    remove(path / EARLIER)
    (path / EARLIER).mkdir()
    moved_names: list[str] = []
    try:
        _move(path, path / EARLIER, ENTRIES)
        for name in reversed(ENTRIES):
            if os.path.lexists(path / NEW / name):
                moved_names.append(name)
                (path / NEW / name).replace(path / name)
    except BaseException:
        for name in moved_names:
            remove(path / name)
        _move(path / EARLIER, path, ENTRIES[::-1])
        shutil.rmtree(path / NEW, ignore_errors=True)
        raise
    finally:
        shutil.rmtree(path / EARLIER, ignore_errors=True)
    (path / NEW).rmdir()


def _move(source: Path, target: Path, names: Iterable[str]) -> None:
    for name in names:
        if os.path.lexists(source / name):
            (source / name).replace(target / name)


def refuse_foreign_files(path: Path) -> None:
    """Raise FileExistsError if a folder holds files that no export wrote."""
    names = {item.name for item in path.iterdir() if not is_temporary(item.name)} - {
        LOCK,
        *_SYSTEM_FILES,
    }
    own_names = {RECORD, NEW, EARLIER} & names
    foreign = sorted(names - {NEW, EARLIER} - set(ENTRIES if own_names else ()))
    if foreign:
        raise FileExistsError(
            f"{path} has other files, such as {foreign[0]}: give a new folder, or an empty one"
        )


Images = Literal["copy", "link", "none"]
STATIC_LEVEL = 255  # level of the static scene in a mask


def picture_name(frame: int) -> str:
    """Return the file name of a frame, as in the folder of the reconstruction."""
    return f"{frame:06d}.jpg"


def check_images(images: str) -> None:
    """Raise ValueError unless `images` is a choice of `Images`."""
    if images not in get_args(Images):
        raise InputError(f"images is {images!r}: expected 'copy', 'link' or 'none'")


def has_masks(result: Reconstruction) -> bool:
    """Return whether a reconstruction has labels of pixels that move on their own."""
    return result.settings.motion == "objects" or has_labels(result.folder)


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
        read_checked_picture(result, frame)
        source, target = (
            result.folder / PICTURES / picture_name(frame),
            folder / picture_name(frame),
        )
        copy = link_or_copy if images == "link" else copy_file
        copy(source, target)


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
        mask = np.where(result.labels(frame) == 0, STATIC_LEVEL, 0).astype(np.uint8)
        write_png(folder / Path(picture_name(frame)).with_suffix(suffix), mask)


def read_checked_picture(result: Reconstruction, frame: int) -> np.ndarray:
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
