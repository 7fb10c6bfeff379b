"""The pictures of a folder and the files of a pattern, in natural order of their names."""

import glob
import os
from pathlib import Path

from tisfm.formats import IMAGE_SUFFIXES
from tisfm.formats.images import natural_order


def pictures_of(folder: str) -> list[Path]:
    """Return the pictures of a folder, hidden files apart; FileNotFoundError if it has none."""
    files = [
        file
        for file in Path(folder).iterdir()
        if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
    ]
    if not files:
        raise FileNotFoundError(
            f"the folder {folder} has no images: expected files ending in "
            f"{', '.join(IMAGE_SUFFIXES)}"
        )
    return sorted(files, key=natural_order)


def matching_files(pattern: str) -> list[Path]:
    """Return the files that match a glob pattern; FileNotFoundError if there is none."""
    files = [file for file in map(Path, glob.glob(pattern)) if file.is_file()]
    if not files:
        raise FileNotFoundError(f"no file matches {pattern}: check the pattern")
    return sorted(files, key=natural_order)


def several_pictures(path: str, name: str) -> list[Path]:
    """Return the pictures of a folder or pattern, or the one of a file.

    Raises
    ------
    FileNotFoundError
        If there is none; `name` is what the error calls it.
    """
    if os.path.isdir(path):
        return pictures_of(path)
    if os.path.isfile(path):
        return [Path(path)]
    if glob.has_magic(path):
        return matching_files(path)
    raise FileNotFoundError(f"there is no {name} {path}: check the path")
