"""The store of rendered films, a folder of the user: a film is rendered once for the same code."""

import hashlib
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

FOLDER = "tisfm-trust-films"
MAX_AGE = 30 * 86400.0  # s since the last use of a film: older ones are removed


def find_store() -> Path:
    """Return the folder of the films, in the user's folder for caches; it is made if needed.

    Raises
    ------
    OSError
        If the folder cannot be made.
    """
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(caches) / FOLDER
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


def name_film(*words: object) -> str:
    """Return the name of the file of a film, from all that decides it."""
    return f"{hashlib.sha256(' '.join(map(str, words)).encode()).hexdigest()[:16]}.npz"


def read_film(name: str) -> dict[str, np.ndarray] | None:
    """Return the arrays of a film; None if it is not stored."""
    path = find_store() / name
    try:
        with np.load(path) as stored:
            arrays = {key: stored[key] for key in stored}
        os.utime(path)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):  # none, or a damaged file
        return None
    return arrays


def write_film(name: str, arrays: Mapping[str, Any]) -> None:
    """Store the arrays of a film; films that were not used for long are removed."""
    folder = find_store()
    part = folder / f"{name}.{os.getpid()}.part"
    with part.open("wb") as file:
        np.savez(file, **arrays)
    part.replace(folder / name)
    oldest = time.time() - MAX_AGE
    for path in folder.iterdir():
        try:
            if path.stat().st_mtime < oldest:
                path.unlink(missing_ok=True)
        except OSError:  # another process removed it
            continue
