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
    MARKER,
    MASKS,
    OPTIONAL_FILES,
    PARTS,
    PICTURES,
    RECORD,
    write_record,
)

EARLIER = ".tisfm-earlier"  # holds the earlier result until the new one is complete
MOVING_OUT = ".tisfm-leaving"  # its name while files are moved into it
MOVING_BACK = ".tisfm-restoring"  # its name while they are moved back
# Chunks of a result that is not yet complete.
CHUNKS = ".tisfm-chunks"
_FOLDERS = (EARLIER, MOVING_OUT, MOVING_BACK, CHUNKS)


@contextmanager
def renewed_folder(
    folder: str | os.PathLike[str],  # made if it does not exist
) -> Iterator[Path]:
    """Prepare a folder for a reconstruction, and lock it within the block.

    An earlier reconstruction in it is put aside. It is removed when the block ends, and put back if
    an exception leaves the block. If the process is killed, it stays aside until the next run.

    Raises FileExistsError if it holds files that do not belong to a reconstruction.

    Raises OSError if the folder cannot be made or written to, or another run writes to it.
    """
    path = make_result_folder(folder)
    with locked_folder(path):
        with renewed_locked_folder(path):
            yield path
        try_to_remove(path / CHUNKS)  # left by an interrupted run


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
        if (source / CAMERA).exists():  # somebody may have deleted it
            copy_file(source / CAMERA, path / CAMERA)
        write_record(path, result)


def _prepare(path: Path) -> None:
    """Put an earlier result aside, remove an incomplete one, and make the inner folders."""
    refuse_others(path)
    for name in (*_FOLDERS, MARKER):  # tisfm makes no links; a link would lead out of the folder
        remove_link(path / name)
    (path / MARKER).touch()
    # First complete the step at which an earlier run was killed.
    if (path / MOVING_BACK).exists():
        _move(path / MOVING_BACK, path)
        (path / MOVING_BACK).rmdir()
    if os.path.lexists(path / RECORD) and (path / EARLIER).exists():
        remove(path / EARLIER)  # the newer one is complete
    if os.path.lexists(path / RECORD) or (path / MOVING_OUT).exists():
        (path / MOVING_OUT).mkdir(exist_ok=True)
        _move(path, path / MOVING_OUT)
        (path / MOVING_OUT).rename(path / EARLIER)
    _remove(path)
    for name in (DEPTH, PICTURES, CACHE):
        (path / name).mkdir()


def refuse_others(path: Path) -> None:
    """Raise FileExistsError if a folder holds other files than those of a reconstruction."""
    expected = {*PARTS, *OPTIONAL_FILES, CACHE, MARKER}
    if not is_report(path / REPORT):  # a report.html that tisfm did not write
        expected.discard(REPORT)
    names = sorted(item.name for item in path.iterdir())
    internal = {name for name in names if name in (LOCK, *_FOLDERS) or is_temporary(name)}
    others = [name for name in names if name not in expected | internal]
    if not others and not internal & set(_FOLDERS) and not {RECORD, MARKER} & set(names):
        others = [
            name for name in names if name not in internal
        ]  # known names, but no mark of tisfm
    if others:
        raise FileExistsError(
            f"{path} has other files, such as {others[0]}: give a new folder, or an empty one"
        )


def _restore(path: Path) -> None:
    """Restore the earlier result, if there was one."""
    if (path / MOVING_OUT).exists():  # no file of the new result exists yet
        (path / MOVING_OUT).rename(path / MOVING_BACK)
    elif (path / EARLIER).exists():
        _remove(path)
        (path / EARLIER).rename(path / MOVING_BACK)
    if (path / MOVING_BACK).exists():
        _move(path / MOVING_BACK, path)
        (path / MOVING_BACK).rmdir()
        (path / MARKER).unlink(missing_ok=True)


def _move(source: Path, target: Path) -> None:
    """Move the files of a result; its record is the last."""
    for name in (*(name for name in (*PARTS, *OPTIONAL_FILES) if name != RECORD), RECORD):
        if os.path.lexists(source / name):
            (source / name).replace(target / name)


def _remove(path: Path) -> None:
    """Remove the files of a result, except the file that marks the folder as ours."""
    remove(path / RECORD)  # first: without it the result is not complete
    for name in {*PARTS, *OPTIONAL_FILES, CACHE} - {RECORD}:
        remove(path / name)


class TemporaryFolder:
    """A new folder, deleted when the last reference to this object goes, or when the process ends.

    `tempfile.TemporaryDirectory` would warn that it was not closed; here this is the normal end.
    """

    def __init__(self) -> None:
        self.name = tempfile.mkdtemp(prefix="tisfm-")  # path of the folder
        self._remove = weakref.finalize(self, shutil.rmtree, self.name, ignore_errors=True)

    def remove(self) -> None:
        """Delete the folder now."""
        self._remove()
