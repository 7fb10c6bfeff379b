"""The Taichi runtime: the only place that starts it."""

import contextlib
import io
import os
import sys
import threading
import warnings
from typing import TYPE_CHECKING, Any, Literal, get_args

import cv2
import numpy as np

from tisfm.errors import InputError, RunError
from tisfm.machine.kernel_cache import cache_options
from tisfm.machine.memory import keep_freed_memory, require_for_taichi
from tisfm.machine.vulkan import software_vulkan
from tisfm.threads import bind_newest, thread_ids

if TYPE_CHECKING:
    from tisfm.kernels.layout.lanes import LaneGrid

__all__ = ["start"]

Arch = Literal["cpu", "cuda", "vulkan", "metal"]
ARCHS = get_args(Arch)
_starting = threading.Lock()
_process: int | None = None  # in which Taichi was started, or found running
_warned_of: int | None = None  # id of the program of Taichi that the user was warned of
_AVX_512F = 13  # OpenCV's number of this feature, which Python has no name for
_NEEDS = {
    "cuda": "it needs an NVIDIA GPU and its driver (libcuda)",
    "vulkan": "it needs a GPU with a Vulkan driver, and the loader (libvulkan)",
    "metal": "it needs macOS on Apple silicon",
}


class SoftwareVulkanWarning(UserWarning):
    """Vulkan runs on software on the CPU, not on a GPU."""


def start(
    arch: Arch | None = None, *, threads: int | None = None, bind_threads: bool = True
) -> None:
    """Start Taichi, unless it is running already.

    Optional: the first interpretation starts it with the defaults. Taichi keeps one runtime per
    process, so arch and threads are chosen before the first use. A runtime that an application
    started with its own ``ti.init`` is used as it is and never reset.

    Parameters
    ----------
    arch : {"cpu", "cuda", "vulkan", "metal"}, optional
        Where kernels run. By default where they run already, or else what Taichi's environment
        variable TI_ARCH says, or else "cpu".
    threads : int, optional
        Upper bound on CPU threads, by default and at most as many as there are cores. Results
        do not depend on it.
    bind_threads : bool
        Whether each of the CPU's threads is bound to a core of its own, on Linux, where there are
        as many as this process may use cores. Kernels on small images are faster by it. Without
        effect where Taichi runs already.

    Warns
    -----
    UserWarning
        If Vulkan runs on software on the CPU, not on a GPU: it is slow, and answers may be wrong.
        An application may have started Taichi on it.
        If an application started Taichi on the CPU without ``real_matrix_scalarize=False``: our
        kernels may then take minutes to compile.

    Raises
    ------
    ValueError
        If arch is not one of those above or threads is not a positive integer.
    RuntimeError
        If Taichi is already running in another way than the one asked for, or cannot run on
        `arch` here. It never falls back to the CPU by itself. If this process was forked from one
        in which Taichi ran: its threads have stayed there.
    MemoryError
        If a limit of the address space (``ulimit -v``) leaves less than Taichi reserves.

    Notes
    -----
    Taichi keeps compiled kernels in the user's cache folder, and ends the process with a
    segmentation fault where there is none that it can write. It is then started without that
    cache, and compiles anew in every process. A lock there that a killed process has left is
    removed after two minutes. Where neither HOME nor XDG_CACHE_HOME is set,
    which Taichi does not survive either, HOME is set for this process.

    Examples
    --------
    >>> import tisfm
    >>> tisfm.runtime.start()  # such as start("cuda"), or start(threads=2)
    >>> tisfm.runtime.start("quantum")
    Traceback (most recent call last):
        ...
    tisfm.errors.InputError: arch is 'quantum': expected one of ...
    """
    global _process
    if arch is not None and arch not in ARCHS:
        raise InputError(f"arch is {arch!r}: expected one of {', '.join(map(repr, ARCHS))}")
    if threads is not None and (
        isinstance(threads, bool) or not isinstance(threads, (int, np.integer)) or threads < 1
    ):
        raise InputError(f"threads is {threads!r}: expected a positive integer, or None for all")
    if threads is not None:  # Taichi starts every thread it is told of, needed or not
        threads = min(int(threads), os.cpu_count() or 1)
    if _process not in (None, os.getpid()):
        raise RunError(
            "this process was forked from one in which Taichi ran, whose threads have stayed "
            'there: start workers afresh, as multiprocessing.get_context("spawn") does, or fork '
            "before the first interpretation"
        )
    with _starting:
        _process = os.getpid()  # known before: a process may fork while another thread starts
        try:
            _start(arch, threads, bind_threads)
        finally:
            if not _is_running():
                _process = None


def start_worker(arch: Arch | None = None, *, threads: int | None = None) -> None:
    """Start the runtime, as `start` does, in a process that outlives what it is asked for.

    Where it already runs it keeps its threads, on which no result depends.
    """
    keep_freed_memory()
    with warnings.catch_warnings():
        # The main process has warned already.
        warnings.simplefilter("ignore", SoftwareVulkanWarning)
        start(arch, threads=None if _is_running() else threads)


def _start(arch: Arch | None, threads: int | None, bind_threads: bool) -> None:
    if _is_running():
        _check_running(arch, threads)
        _warn_of_application()
        return
    chosen = arch or _arch_of_environment()
    if chosen == "vulkan" and (device := software_vulkan()):
        warnings.warn(software_said(device), SoftwareVulkanWarning, stacklevel=3)
    require_for_taichi(threads or os.cpu_count() or 1)
    options = cache_options()

    import tisfm.kernels  # noqa: F401  (quiets Taichi's import)

    # Where output goes to a notebook, it would say so there, and look for what kernels print.
    with contextlib.redirect_stdout(sys.__stdout__):
        import taichi  # noqa: F401

    if threads is not None:
        options["cpu_max_num_threads"] = threads
        cv2.setNumThreads(threads)
    if chosen == "cpu":
        options["real_matrix_scalarize"] = False  # lanes are one hardware vector, or two
    else:
        options["fast_math"] = False  # roots and quotients rounded as on a CPU
    before = thread_ids()
    _initialise(chosen, options)
    if chosen == "cpu" and bind_threads:
        bind_newest(_most_threads(), before)


def _initialise(arch: str, options: dict[str, Any]) -> None:
    """Start Taichi on an arch, or explain why it cannot be."""
    global _warned_of
    import taichi as ti

    from tisfm.kernels.layout.internals import materialize, program

    overriding = os.environ.pop("TI_ARCH", None)  # would win over what is asked for
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # Taichi prints the arch it starts on
            # Nor is it to complain of each library that it looks for: the error says that.
            ti.init(arch=getattr(ti, arch), enable_fallback=False, log_level=ti.ERROR, **options)
            # Left to the first kernel, it would have to be launched by this very thread.
            materialize()
    except RuntimeError as error:
        raise RunError(
            f"Taichi cannot run on {arch!r} here: {_NEEDS.get(arch, str(error))}"
        ) from error
    finally:
        if overriding is not None:
            os.environ["TI_ARCH"] = overriding
    ti.set_logging_level(ti.WARN)
    _warned_of = id(program())  # no application has started it


def software_said(device: str) -> str:
    """Return the warning for a Vulkan device of this name that is software."""
    return (
        f"vulkan runs on {device}, software on the CPU, not a GPU: it is slow, and answers may "
        'be wrong; take arch="cpu" (--arch cpu)'
    )


def _arch_of_environment() -> str:
    from tisfm.kernels.layout.archs import HOSTS

    arch = os.environ.get("TI_ARCH", "cpu")
    if arch not in (*ARCHS, *HOSTS):
        raise InputError(
            f"the environment variable TI_ARCH is {arch!r}: expected one of "
            f"{', '.join(map(repr, ARCHS))}"
        )
    return "cpu" if arch in HOSTS else arch


def on_gpu() -> bool:
    """Return whether kernels run elsewhere than on the CPU, starting the runtime if need be."""
    start()
    return running_arch() != "cpu"


def running_arch() -> str:
    """Return where the runtime, which must have been started, runs: "cpu", or Taichi's name."""
    from tisfm.kernels.layout import internals

    return internals.arch()


def lanes() -> int:
    """Return the lane count that suits the running arch, starting the runtime if need be."""
    return 1 if on_gpu() else cpu_lanes()


def cpu_lanes() -> int:
    """Return the lane count that suits this CPU: 16 where vectors are as wide (AVX-512), else 8."""
    return 16 if cv2.checkHardwareSupport(_AVX_512F) else 8


def lane_grid(height: int, width: int) -> "LaneGrid":
    """Return a grid whose arrays lie as suits the running arch, and on its device."""
    device = on_gpu()  # before kernels are imported: it starts Taichi
    from tisfm.kernels.layout.lanes import LaneGrid

    try:
        return LaneGrid(height, width, lanes=lanes(), on_device=device)
    except ValueError as error:  # the frames are larger than kernels can index
        raise InputError(str(error)) from None


def threads() -> int:
    """Return the most CPU threads that kernels use, starting the runtime if need be."""
    start()
    return _most_threads()


def _most_threads() -> int:
    from tisfm.kernels.layout import internals

    return int(internals.configuration().cpu_max_num_threads)


def _is_running() -> bool:
    if "taichi" not in sys.modules:
        return False
    from tisfm.kernels.layout import internals

    return internals.is_running()


def _check_running(arch: str | None, threads: int | None) -> None:
    import taichi as ti

    from tisfm.kernels.layout import internals

    running = internals.configuration()
    if running.default_ip != ti.i32:
        raise RunError(
            f"Taichi already runs with default_ip={running.default_ip.to_string()}: its compiler "
            "fails on our kernels then; start it with ti.i32, its default"
        )
    if arch is not None and running_arch() != arch:
        raise RunError(
            f"Taichi already runs on {running_arch()!r}, not on {arch!r}: call "
            "tisfm.runtime.start before the first interpretation, or let the application that "
            "started Taichi choose"
        )
    if threads is not None and running.cpu_max_num_threads != threads:
        raise RunError(
            f"Taichi already runs with {running.cpu_max_num_threads} threads, asked for "
            f"{threads}: call tisfm.runtime.start before the first interpretation"
        )


def _warn_of_application() -> None:
    """Warn, once for each ``ti.init``, if an application started Taichi in a way that is slow.

    Either Taichi takes vectors apart, or Vulkan runs on software.
    """
    global _warned_of
    from tisfm.kernels.layout import internals

    program, arch = id(internals.program()), running_arch()
    if _warned_of == program:
        return
    if arch == "vulkan":
        _warned_of = program  # first: asking the drivers takes time
        if device := software_vulkan():
            warnings.warn(software_said(device), SoftwareVulkanWarning, stacklevel=4)
    if arch == "cpu" and internals.configuration().real_matrix_scalarize:
        _warned_of = program
        warnings.warn(
            "Taichi was started without real_matrix_scalarize=False: kernels may take minutes to "
            "compile, and are slower. Pass it: ti.init(arch=ti.cpu, real_matrix_scalarize=False); "
            "or call tisfm.runtime.start() in place of ti.init",
            stacklevel=4,
        )
