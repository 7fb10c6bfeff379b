"""The folder of an export, replaced as a whole or not at all."""

import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import Any

from tisfm.folders.result_folder import LOCK, locked_folder, make_result_folder, remove
from tisfm.formats import atomic_write
from tisfm.formats.atomic import is_temporary

FORMAT = 1
RECORD = "export.json"  # written last, removed first
IMAGES, MASKS, MODELS = "images", "masks", "sparse"
TRANSFORMS, POINTS = "transforms.json", "sparse_points.ply"
PARTS = (RECORD, IMAGES, MASKS, MODELS, TRANSFORMS, POINTS)
_SYSTEM_FILES = {".DS_Store", "Thumbs.db", "desktop.ini"}  # file browsers write them
NEW, EARLIER = ".tisfm-new", ".tisfm-earlier"


@contextmanager
def renewed_export(
    folder: str | PathLike[str],  # made if it does not exist
    about: dict[str, Any],  # contents of ``export.json``; the block may add to it
) -> Iterator[Path]:
    """Yield a new folder to write an export to; it replaces the earlier export when the block ends.

    If an exception leaves the block, the earlier export stays, or the folder is removed if it is
    new. The next export removes what a killed process has left.

    Raises FileExistsError if the folder holds files that are not of an export.

    Raises OSError if the folder cannot be made or written to, or another run writes to it.
    """
    is_new = not Path(folder).exists()
    path = make_result_folder(folder)
    try:
        with _renewed(path, about) as new:
            yield new
    except BaseException:
        if is_new:
            with suppress(OSError):  # the folder has other files by now
                path.rmdir()
        raise


@contextmanager
def _renewed(path: Path, about: dict[str, Any]) -> Iterator[Path]:
    """Yield the new folder inside a folder that exists."""
    with locked_folder(path):
        refuse_others(path)
        remove(path / NEW)
        (path / NEW).mkdir()
        try:
            yield path / NEW
            with atomic_write(path / NEW / RECORD, durable=True) as file:
                file.write(json.dumps({"format": FORMAT, **about}, indent=1).encode())
        except BaseException:
            shutil.rmtree(path / NEW, ignore_errors=True)
            raise
        _exchange(path)


def _exchange(path: Path) -> None:
    """Replace the earlier export by the new one; ``export.json`` goes first and comes last."""
    remove(path / EARLIER)
    (path / EARLIER).mkdir()
    moved: list[str] = []
    try:
        _move(path, path / EARLIER, PARTS)
        for name in reversed(PARTS):
            if os.path.lexists(path / NEW / name):
                moved.append(name)
                (path / NEW / name).replace(path / name)
    except BaseException:
        for name in moved:
            remove(path / name)
        _move(path / EARLIER, path, PARTS[::-1])
        shutil.rmtree(path / NEW, ignore_errors=True)
        raise
    finally:
        shutil.rmtree(path / EARLIER, ignore_errors=True)
    (path / NEW).rmdir()


def _move(source: Path, target: Path, names: Iterable[str]) -> None:
    for name in names:
        if os.path.lexists(source / name):
            (source / name).replace(target / name)


def refuse_others(path: Path) -> None:
    """Raise FileExistsError if a folder holds files that are not of an export."""
    there = {item.name for item in path.iterdir() if not is_temporary(item.name)} - {
        LOCK,
        *_SYSTEM_FILES,
    }
    ours = {RECORD, NEW, EARLIER} & there
    others = sorted(there - {NEW, EARLIER} - set(PARTS if ours else ()))
    if others:
        raise FileExistsError(
            f"{path} has other files, such as {others[0]}: give a new folder, or an empty one"
        )
