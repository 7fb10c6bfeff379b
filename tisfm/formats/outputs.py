"""Folders for results, in which nothing replaces a file that is read."""

import contextlib
import os
import tempfile
from collections.abc import Hashable, Iterable, Iterator
from pathlib import Path

Paths = Iterable[str | os.PathLike[str]]


class InputFiles:
    """The files that a command reads, none of which a result may replace.

    Files are compared by what they are, not by how they are called: through symbolic and hard
    links, "..", and names that a file system takes for the same.

    Parameters
    ----------
    files : iterable of paths
        Those that do not exist do not count.
    """

    def __init__(self, files: Paths = ()) -> None:
        self._known: dict[Hashable, str] = {
            identity: os.fspath(file) for file in files for identity in _identities(file)
        }

    def refuse(self, *outputs: str | os.PathLike[str]) -> None:
        """Raise an error if a result would replace one of the files.

        Parameters
        ----------
        *outputs : path
            Files about to be written, whether they exist or not.

        Raises
        ------
        ValueError
            If one of them is one of the files.
        """
        for output in outputs:
            for identity in _identities(output):
                if identity in self._known:
                    raise ValueError(
                        f"the result {os.fspath(output)} would replace "
                        f"{self._known[identity]}, which is read: give another folder with -o"
                    )


def make_folder(folder: str | os.PathLike[str]) -> Path:
    """Make a folder for results, unless there is one, and check that it can be written to.

    Raises
    ------
    OSError
        If it cannot be made or written to.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise type(error)(
            f"cannot write results to the folder {folder} ({error.strerror}): give another with -o"
        ) from error
    return folder


def _identities(path: str | os.PathLike[str]) -> Iterator[Hashable]:
    """Yield by what a file that exists is known: its number, if it has one, and its real path."""
    with contextlib.suppress(OSError, ValueError):  # there is no such file, and can be none
        about = os.stat(path)
        if about.st_ino:  # 0 where the file system numbers nothing
            yield about.st_dev, about.st_ino
        yield os.path.normcase(os.path.realpath(path))
