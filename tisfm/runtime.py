"""The Taichi runtime: the only place that starts it."""

import contextlib
import io
import os
import sys
import tempfile
from typing import Any

import cv2
import numpy as np


def start(arch: str = "cpu", *, threads: int | None = None) -> None:
    """Start Taichi, unless it is running already.

    Optional: the first interpretation starts it with the defaults. Taichi keeps one runtime per
    process, so arch and threads are chosen before the first use. A runtime that an application
    started with its own ``ti.init`` is used as it is and never reset.

    Parameters
    ----------
    arch : {"cpu"}
        Where kernels run.
    threads : int, optional
        Upper bound on CPU threads, by default and at most as many as there are cores. Results
        do not depend on it.

    Raises
    ------
    ValueError
        If arch is not one of those above or threads is not a positive integer.
    RuntimeError
        If Taichi is already running in another way than the one asked for.

    Notes
    -----
    Taichi keeps compiled kernels in the user's cache folder, and ends the process with a
    segmentation fault where there is none that it can write. It is then started without that
    cache, and compiles anew in every process. Where neither HOME nor XDG_CACHE_HOME is set,
    which Taichi does not survive either, HOME is set for this process.
    """
    if arch != "cpu":
        raise ValueError(f"arch is {arch!r}: expected 'cpu'")
    if threads is not None and (
        isinstance(threads, bool) or not isinstance(threads, (int, np.integer)) or threads < 1
    ):
        raise ValueError(f"threads is {threads!r}: expected a positive integer, or None for all")
    if threads is not None:  # Taichi starts every thread it is told of, needed or not
        threads = min(int(threads), os.cpu_count() or 1)
    if _is_running():
        _check_running(arch, threads)
        return
    options = _cache_options()

    import tisfm.kernels  # noqa: F401  (quiets Taichi's import)

    import taichi as ti  # isort: skip

    if threads is not None:
        options["cpu_max_num_threads"] = threads
        cv2.setNumThreads(threads)
    with contextlib.redirect_stdout(io.StringIO()):  # Taichi prints the arch it starts on
        ti.init(
            arch=ti.cpu,
            enable_fallback=False,
            real_matrix_scalarize=False,  # an 8-lane vector is one hardware vector
            log_level=ti.WARN,
            **options,
        )


def lanes() -> int:
    """Return the lane count that suits the running arch, starting the runtime if need be."""
    start()
    import taichi as ti

    return 8 if ti.lang.impl.current_cfg().arch in (ti.x64, ti.arm64) else 1


def threads() -> int:
    """Return the most CPU threads that kernels use, starting the runtime if need be."""
    start()
    import taichi as ti

    return int(ti.lang.impl.current_cfg().cpu_max_num_threads)


def _is_running() -> bool:
    if "taichi" not in sys.modules:
        return False
    import taichi as ti

    return ti.lang.impl.get_runtime().prog is not None


def _check_running(arch: str, threads: int | None) -> None:
    import taichi as ti

    running = ti.lang.impl.current_cfg()
    if running.arch not in (ti.x64, ti.arm64):
        raise RuntimeError(
            f"Taichi already runs on {running.arch}, not on {arch!r}: it was started by the "
            "application; start it with arch=ti.cpu, or not at all"
        )
    if threads is not None and running.cpu_max_num_threads != threads:
        raise RuntimeError(
            f"Taichi already runs with {running.cpu_max_num_threads} threads, asked for "
            f"{threads}: call tisfm.runtime.start before the first interpretation"
        )


def _cache_options() -> dict[str, Any]:
    """Return options for ``ti.init`` that survive a cache folder which cannot be written."""
    if os.name == "nt":
        return {}
    if "HOME" not in os.environ and "XDG_CACHE_HOME" not in os.environ:
        os.environ["HOME"] = os.path.expanduser("~")  # from the user database
    base = os.environ.get("XDG_CACHE_HOME", f"{os.environ.get('HOME')}/.cache")
    folder = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH", f"{base}/taichi/ticache")
    try:
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return {"offline_cache": False, "offline_cache_file_path": tempfile.gettempdir()}
    return {}
