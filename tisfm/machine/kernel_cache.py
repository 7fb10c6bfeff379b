"""The folder in which Taichi keeps compiled kernels.

Taichi locks this folder by a file. If a process is killed while it holds the lock, the file stays:
Taichi would neither read nor write there any more, and every process would compile all kernels.
"""

import atexit
import contextlib
import os
import tempfile
import time
from pathlib import Path
from typing import Any

LOCK, _LIST = "ticache.lock", "ticache.tcb"  # Taichi's names of the lock and of the list
# s: a lock file this old is left over, as the list of kernels is locked for less than 1 s.
STALE_LOCK_AGE = 120.0
_TURN_FILE = "tisfm.turn"  # locked by the process that writes kernels
_MAX_LOCK_WAIT = 5.0  # s, for the lock of `_TURN_FILE`; set by hand
_LOCK_RETRY_INTERVAL = 0.02  # s, between attempts to lock it; set by hand


def cache_options() -> dict[str, Any]:
    """Return options for ``ti.init`` under which Taichi survives a read-only cache folder.

    The lock of a killed process is removed.
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
    """Wait until no other process writes kernels, which each does when it ends.

    Taichi itself waits only briefly for its lock: of workers that end together, all but one would
    print an error and lose their kernels. The file stays locked until this process has ended, after
    Taichi has written.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return
    with contextlib.suppress(OSError):  # the folder is gone, or has no locks
        file = os.open(folder / _TURN_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        end = time.monotonic() + _MAX_LOCK_WAIT
        while time.monotonic() < end:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(_LOCK_RETRY_INTERVAL)
            else:
                break


def cache_folder() -> Path | None:
    """Return the folder of compiled kernels; None on Windows, where Taichi chooses it."""
    if os.name == "nt":
        return None
    home = os.environ.get("HOME") or os.path.expanduser("~")
    base = os.environ.get("XDG_CACHE_HOME", f"{home}/.cache")
    return Path(os.environ.get("TI_OFFLINE_CACHE_FILE_PATH", f"{base}/taichi/ticache"))


def remove_stale_lock(
    folder: Path,  # Taichi's cache
) -> None:
    """Remove the lock of a dead process, and kernels that it may have written incompletely.

    Under its lock, Taichi writes kernels and then the list of all. It never rewrites a kernel that
    exists or is listed; it makes an incomplete list anew.

    Raises OSError if files cannot be read or removed.
    """
    lock = folder / LOCK
    try:
        lock_time = lock.stat().st_mtime
    except FileNotFoundError:
        return
    if time.time() - lock_time < STALE_LOCK_AGE:
        return
    list_file = folder / _LIST
    if not list_file.exists() or list_file.stat().st_mtime < lock_time:
        for kernel in folder.glob("T*.tic"):
            if kernel.stat().st_mtime >= lock_time:
                kernel.unlink(missing_ok=True)
    lock.unlink(missing_ok=True)
