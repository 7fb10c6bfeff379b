"""The Taichi runtime: the only place that starts it."""

import contextlib
import io
from typing import Any

_started: dict[str, Any] = {}


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
        Upper bound on CPU threads; by default all cores. Results do not depend on it.

    Raises
    ------
    ValueError
        If arch is not one of those above or threads is not positive.
    RuntimeError
        If Taichi is already running in another way than the one asked for.
    """
    if arch != "cpu":
        raise ValueError(f"arch is {arch!r}: expected 'cpu'")
    if threads is not None and (not isinstance(threads, int) or threads < 1):
        raise ValueError(f"threads is {threads!r}: expected a positive integer, or None for all")
    if _running_program() is not None:
        _check_running(arch, threads)
        return

    import tisfm.kernels  # noqa: F401  (quiets Taichi's import)

    import taichi as ti  # isort: skip

    options: dict[str, Any] = {} if threads is None else {"cpu_max_num_threads": threads}
    with contextlib.redirect_stdout(io.StringIO()):  # Taichi prints the arch it starts on
        ti.init(
            arch=ti.cpu,
            enable_fallback=False,
            real_matrix_scalarize=False,  # an 8-lane vector is one hardware vector
            log_level=ti.WARN,
            **options,
        )
    _started.update(program=_running_program(), threads=threads)


def lanes() -> int:
    """Return the lane count that suits the running arch, starting the runtime if need be."""
    start()
    import taichi as ti

    return 8 if ti.lang.impl.current_cfg().arch in (ti.x64, ti.arm64) else 1


def _running_program() -> Any:
    import sys

    if "taichi" not in sys.modules:
        return None
    import taichi as ti

    return ti.lang.impl.get_runtime().prog


def _check_running(arch: str, threads: int | None) -> None:
    import taichi as ti

    running = ti.lang.impl.current_cfg().arch
    if running not in (ti.x64, ti.arm64):
        raise RuntimeError(
            f"Taichi already runs on {ti.lang.impl.get_runtime().prog.config().arch}, not on "
            f"{arch!r}: it was started by the application; start it with arch=ti.cpu, or not at all"
        )
    if threads is not None and _started.get("program") is _running_program():
        before = _started["threads"]
        if before != threads:
            raise RuntimeError(
                f"Taichi already runs with threads={before}, asked for {threads}: call "
                "tisfm.runtime.start before the first interpretation"
            )
