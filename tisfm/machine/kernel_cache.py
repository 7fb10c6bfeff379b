"""The folder in which Taichi keeps compiled kernels.

Taichi's lock on that folder is a file, which lasts when a process is killed that has just made
it. From then on Taichi would neither read nor write there, and every process would compile anew.
"""

import atexit
import contextlib
import os
import tempfile
import time
from pathlib import Path
from typing import Any

LOCK, _LIST = "ticache.lock", "ticache.tcb"
STALE = 120.0  # s; it is held while the list of kernels is read or written, for less than one
_TURN, _PATIENCE, _PAUSE = "tisfm.turn", 5.0, 0.02  # a file; s


def cache_options() -> dict[str, Any]:
    """Return options for ``ti.init`` that survive a cache folder which cannot be written.

    What a process that was killed has left there is removed.
    """
    if "HOME" not in os.environ and "XDG_CACHE_HOME" not in os.environ and os.name != "nt":
        os.environ["HOME"] = os.path.expanduser("~")  # from the user database
    folder = cache_folder()
    if folder is None:
        return {}
    try:
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return {"offline_cache": False, "offline_cache_file_path": tempfile.gettempdir()}
    with contextlib.suppress(OSError):  # another process may do the same
        remove_stale_lock(folder)
    atexit.unregister(_take_turn)
    atexit.register(_take_turn, folder)
    return {}


def _take_turn(folder: Path) -> None:
    """Wait until no other process is writing kernels, as they do when they end.

    Taichi does not wait for its lock for long: of workers that end together, all but one would
    complain, and not keep what they have compiled. The file stays locked until this process is
    gone, after Taichi has written.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return
    with contextlib.suppress(OSError):  # the folder is gone, or has no locks
        file = os.open(folder / _TURN, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        end = time.monotonic() + _PATIENCE
        while time.monotonic() < end:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(_PAUSE)
            else:
                break


def cache_folder() -> Path | None:
    """Return where Taichi keeps compiled kernels; None on Windows, where it finds a place."""
    if os.name == "nt":
        return None
    home = os.environ.get("HOME") or os.path.expanduser("~")
    base = os.environ.get("XDG_CACHE_HOME", f"{home}/.cache")
    return Path(os.environ.get("TI_OFFLINE_CACHE_FILE_PATH", f"{base}/taichi/ticache"))


def remove_stale_lock(folder: Path) -> None:
    """Remove a lock whose owner must be dead, and the kernels that may be cut off.

    Under its lock, Taichi writes kernels and then the list of all. It never writes a kernel again
    whose file is there or which is listed; a list that is cut off it makes anew.

    Parameters
    ----------
    folder : Path
        Taichi's cache.

    Raises
    ------
    OSError
        If files cannot be looked at or removed.
    """
    lock = folder / LOCK
    try:
        made = lock.stat().st_mtime
    except FileNotFoundError:
        return
    if time.time() - made < STALE:
        return
    listed = folder / _LIST
    if not listed.exists() or listed.stat().st_mtime < made:
        for kernel in folder.glob("T*.tic"):
            if kernel.stat().st_mtime >= made:
                kernel.unlink(missing_ok=True)
    lock.unlink(missing_ok=True)
