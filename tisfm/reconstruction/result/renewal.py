"""The output folder of a reconstruction: prepared, restored after a failure, or temporary."""

import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tisfm.folders.files import REPORT, is_report
from tisfm.folders.result_folder import (
    LOCK,
    locked_folder,
    make_result_folder,
    make_subfolder,
    remove,
    remove_link,
    try_to_remove,
)
from tisfm.formats.atomic import copy_file, is_temporary
from tisfm.reconstruction.result.folder import (
    CACHE,
    CAMERA,
    DEPTH,
    FIXED_MASK,
    MARKER,
    MASKS,
    OPTIONAL_FILES,
    PARTS,
    PICTURES,
    RECORD,
    write_record,
)

# Folder of the earlier result until the new result is complete.
EARLIER = ".tisfm-earlier"
# Name of this folder while files are moved into it.
MOVING_OUT = ".tisfm-leaving"
# Name of this folder while files are moved back.
MOVING_BACK = ".tisfm-restoring"
# Folder of the chunks of an incomplete result.
CHUNKS = ".tisfm-chunks"
_INTERNAL_FOLDERS = (EARLIER, MOVING_OUT, MOVING_BACK, CHUNKS)


@contextmanager
def renewed_folder(
    folder: str | os.PathLike[str],  # created if it does not exist
) -> Iterator[Path]:
    """Prepare a folder for a reconstruction, and lock it within the block.

    An earlier reconstruction moves to a subfolder. At the end of the block, it is removed; after an
    exception, it moves back. If the process is killed, it stays in the subfolder until the next
    run.

    Raises FileExistsError if the folder has files that do not belong to a reconstruction.

    Raises OSError if the folder cannot be made or written to, or another run writes to it.
    """
    path = make_result_folder(folder)
    with locked_folder(path):
        with renewed_locked_folder(path):
            yield path
        try_to_remove(path / CHUNKS)  # from an interrupted run


@contextmanager
def renewed_locked_folder(path: Path) -> Iterator[None]:
    """As `renewed_folder`, for a folder that exists and is locked."""
    try:
        _prepare(path)
        yield
    except BaseException:
        _restore(path)
        raise
    try_to_remove(path / EARLIER)


def copy_folder(result: Any, target: str | os.PathLike[str]) -> None:
    """Write a reconstruction to another folder, its record last."""
    source: Path = result.folder
    if Path(target).resolve() == source.resolve():
        write_record(source, result)
        return
    with renewed_folder(target) as path:
        remove(path / CACHE)
        for name in (DEPTH, PICTURES, MASKS):
            if not (source / name).is_dir():
                continue
            make_subfolder(path / name)
            for file in sorted((source / name).iterdir()):
                copy_file(file, path / name / file.name)
        for name in (CAMERA, FIXED_MASK):
            if (source / name).exists():  # the user may have deleted it
                copy_file(source / name, path / name)
        write_record(path, result)


def _prepare(path: Path) -> None:
    """Move an earlier result to a subfolder, remove an incomplete result, and make subfolders."""
    refuse_other_files(path)
    for name in (
        *_INTERNAL_FOLDERS,
        MARKER,
    ):  # tisfm makes no links; a link leads out of the folder
        remove_link(path / name)
    (path / MARKER).touch()
    # First complete the step at which an earlier run was killed.
    if (path / MOVING_BACK).exists():
        _move_files(path / MOVING_BACK, path)
        (path / MOVING_BACK).rmdir()
    if os.path.lexists(path / RECORD) and (path / EARLIER).exists():
        remove(path / EARLIER)  # the newer result is complete
    if os.path.lexists(path / RECORD) or (path / MOVING_OUT).exists():
        (path / MOVING_OUT).mkdir(exist_ok=True)
        _move_files(path, path / MOVING_OUT)
        (path / MOVING_OUT).rename(path / EARLIER)
    _remove_files(path)
    for name in (DEPTH, PICTURES, CACHE):
        (path / name).mkdir()


def refuse_other_files(path: Path) -> None:
    """Raise FileExistsError if a folder has files that do not belong to a reconstruction."""
    expected = {*PARTS, *OPTIONAL_FILES, CACHE, MARKER}
    if not is_report(path / REPORT):  # tisfm did not write this report.html
        expected.discard(REPORT)
    names = sorted(item.name for item in path.iterdir())
    internal = {name for name in names if name in (LOCK, *_INTERNAL_FOLDERS) or is_temporary(name)}
    other_files = [name for name in names if name not in expected | internal]
    if (
        not other_files
        and not internal & set(_INTERNAL_FOLDERS)
        and not {RECORD, MARKER} & set(names)
    ):
        # The names are known, but no file shows that tisfm made the folder.
        other_files = [name for name in names if name not in internal]
    if other_files:
        raise FileExistsError(
            f"{path} has other files, such as {other_files[0]}: give a new folder, or an empty one"
        )


def _restore(path: Path) -> None:
    """Restore the earlier result, if any."""
    if (path / MOVING_OUT).exists():  # no file of the new result exists yet
        (path / MOVING_OUT).rename(path / MOVING_BACK)
    elif (path / EARLIER).exists():
        _remove_files(path)
        (path / EARLIER).rename(path / MOVING_BACK)
    if (path / MOVING_BACK).exists():
        _move_files(path / MOVING_BACK, path)
        (path / MOVING_BACK).rmdir()
        (path / MARKER).unlink(missing_ok=True)


def _move_files(source: Path, target: Path) -> None:
    """Move the files of a result, the record last."""
    for name in (*(name for name in (*PARTS, *OPTIONAL_FILES) if name != RECORD), RECORD):
        if os.path.lexists(source / name):
            (source / name).replace(target / name)


def _remove_files(path: Path) -> None:
    """Remove the files of a result, except the file that marks the folder as one of tisfm."""
    remove(path / RECORD)  # first, since a result without its record is incomplete
    for name in {*PARTS, *OPTIONAL_FILES, CACHE} - {RECORD}:
        remove(path / name)


class TemporaryFolder:
    """A new folder, deleted with the last reference to this object, or at the end of the process.

    `tempfile.TemporaryDirectory` would warn that the folder was not closed; here this is normal.
    """

    def __init__(self) -> None:
        self.name = tempfile.mkdtemp(prefix="tisfm-")  # path of the folder
        self._remove = weakref.finalize(self, shutil.rmtree, self.name, ignore_errors=True)

    def remove(self) -> None:
        """Delete the folder now."""
        self._remove()
