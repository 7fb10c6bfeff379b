"""The Taichi runtime. Only this module starts Taichi."""

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
from tisfm.threads import bind_newest_threads, thread_ids

if TYPE_CHECKING:
    from tisfm.kernels.layout.lanes import LaneGrid

__all__ = ["start"]

Arch = Literal["cpu", "cuda", "vulkan", "metal"]
ARCHS = get_args(Arch)
_start_lock = threading.Lock()
# id of the process in which Taichi was started, or was already running
_taichi_process_id: int | None = None
_warned_program_id: int | None = None  # id of the Taichi program that the user was warned about
_AVX_512F = 13  # OpenCV's number of this CPU feature; cv2 in Python has no name for it
_ARCH_REQUIREMENTS = {
    "cuda": "it needs an NVIDIA GPU and its driver (libcuda)",
    "vulkan": "it needs a GPU with a Vulkan driver, and the loader (libvulkan)",
    "metal": "it needs macOS on Apple silicon",
}


class SoftwareVulkanWarning(UserWarning):
    """Vulkan is emulated in software on the CPU, not run on a GPU."""


def start(
    arch: Arch | None = None, *, threads: int | None = None, bind_threads: bool = True
) -> None:
    """Start Taichi, unless it is running already.

    This call is optional: the first interpretation starts Taichi with the defaults. Taichi has one
    runtime per process, so choose arch and threads before the first use. If an application started
    Taichi with its own ``ti.init``, that runtime is used unchanged and never reset.

    Parameters
    ----------
    arch : {"cpu", "cuda", "vulkan", "metal"}, optional
        Where kernels run. By default the arch of a running Taichi, or else the value of
        Taichi's environment variable TI_ARCH, or else "cpu".
    threads : int, optional
        Maximum number of CPU threads. By default, and at most, the number of cores. It does not
        change results.
    bind_threads : bool
        Whether to bind each CPU thread to its own core, on Linux, if there are as many threads as
        cores that this process may use. Kernels on small images become faster. Without effect if
        Taichi is already running.

    Warns
    -----
    UserWarning
        If Vulkan is emulated in software on the CPU, also in a runtime that an application started:
        kernels are then slow, and results may be wrong. If an application started Taichi on the CPU
        without ``real_matrix_scalarize=False``: our kernels may then take minutes to compile.

    Raises
    ------
    ValueError
        If arch is not one of the above, or threads is not a positive integer.
    RuntimeError
        If Taichi is already running with another arch or another number of threads, or cannot run
        on `arch` here: there is no fallback to the CPU. Also if this process was forked from a
        process in which Taichi ran: a fork does not copy Taichi's threads.
    MemoryError
        If a limit of the address space (``ulimit -v``) leaves less than Taichi reserves.

    Notes
    -----
    Taichi keeps compiled kernels in the user's cache folder, and ends the process with a
    segmentation fault if it cannot write to that folder. Taichi is then started without the cache,
    and compiles anew in every process. A lock that a killed process left there is removed after two
    minutes. If neither HOME nor XDG_CACHE_HOME is set, Taichi would crash too; HOME is then set for
    this process.

    Examples
    --------
    >>> import tisfm
    >>> tisfm.runtime.start()  # such as start("cuda"), or start(threads=2)
    >>> tisfm.runtime.start("quantum")
    Traceback (most recent call last):
        ...
    tisfm.errors.InputError: arch is 'quantum': expected one of ...
    """
    global _taichi_process_id
    if arch is not None and arch not in ARCHS:
        raise InputError(f"arch is {arch!r}: expected one of {', '.join(map(repr, ARCHS))}")
    if threads is not None and (
        isinstance(threads, bool) or not isinstance(threads, (int, np.integer)) or threads < 1
    ):
        raise InputError(f"threads is {threads!r}: expected a positive integer, or None for all")
    if threads is not None:  # Taichi would start all these threads, even more than cores
        threads = min(int(threads), os.cpu_count() or 1)
    if _taichi_process_id not in (None, os.getpid()):
        raise RunError(
            "this process was forked from one in which Taichi ran, whose threads have stayed "
            'there: start workers afresh, as multiprocessing.get_context("spawn") does, or fork '
            "before the first interpretation"
        )
    with _start_lock:
        # Set first: the process may fork while this thread starts Taichi.
        _taichi_process_id = os.getpid()
        try:
            _start(arch, threads, bind_threads)
        finally:
            if not _is_running():
                _taichi_process_id = None


def start_worker(arch: Arch | None = None, *, threads: int | None = None) -> None:
    """Start the runtime, as `start` does, in a worker process that does several jobs.

    A runtime that already runs keeps its number of threads, which does not change results.
    """
    keep_freed_memory()
    with warnings.catch_warnings():
        # The main process has already given this warning.
        warnings.simplefilter("ignore", SoftwareVulkanWarning)
        start(arch, threads=None if _is_running() else threads)


def _start(arch: Arch | None, threads: int | None, bind_threads: bool) -> None:
    if _is_running():
        _check_running(arch, threads)
        _warn_of_slow_options()
        return
    arch_name = arch or _environment_arch()
    if arch_name == "vulkan" and (device := software_vulkan()):
        warnings.warn(software_vulkan_message(device), SoftwareVulkanWarning, stacklevel=3)
    require_for_taichi(threads or os.cpu_count() or 1)
    options = cache_options()

    import tisfm.kernels  # noqa: F401  (quiets Taichi's import)

    # If stdout belongs to a notebook, Taichi would print a notice and collect output of kernels.
    with contextlib.redirect_stdout(sys.__stdout__):
        import taichi  # noqa: F401

    if threads is not None:
        options["cpu_max_num_threads"] = threads
        cv2.setNumThreads(threads)
    if arch_name == "cpu":
        options["real_matrix_scalarize"] = False  # keeps all lanes in one or two hardware vectors
    else:
        options["fast_math"] = False  # rounds roots and quotients as a CPU does
    earlier_threads = thread_ids()
    _initialise(arch_name, options)
    if arch_name == "cpu" and bind_threads:
        bind_newest_threads(_max_threads(), earlier_threads)


def _initialise(arch: str, options: dict[str, Any]) -> None:
    """Start Taichi on an arch, or raise an error that says why this is impossible."""
    global _warned_program_id
    import taichi as ti

    from tisfm.kernels.layout.internals import materialize, program

    environment_arch = os.environ.pop("TI_ARCH", None)  # it would override `arch`
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # Taichi prints the arch it starts on
            # log_level: no line for each library that Taichi does not find; the error is enough.
            ti.init(arch=getattr(ti, arch), enable_fallback=False, log_level=ti.ERROR, **options)
            # Without this, only the present thread could launch the first kernel.
            materialize()
    except RuntimeError as error:
        raise RunError(
            f"Taichi cannot run on {arch!r} here: {_ARCH_REQUIREMENTS.get(arch, str(error))}"
        ) from error
    finally:
        if environment_arch is not None:
            os.environ["TI_ARCH"] = environment_arch
    ti.set_logging_level(ti.WARN)
    _warned_program_id = id(program())  # started here, so no warning about an application's ti.init


def software_vulkan_message(device: str) -> str:
    """Return the warning for a software Vulkan device of this name."""
    return (
        f"vulkan runs on {device}, software on the CPU, not a GPU: it is slow, and results may "
        'be wrong; use arch="cpu" (--arch cpu)'
    )


def _environment_arch() -> str:
    from tisfm.kernels.layout import CPU_ARCHS

    arch = os.environ.get("TI_ARCH", "cpu")
    if arch not in (*ARCHS, *CPU_ARCHS):
        raise InputError(
            f"the environment variable TI_ARCH is {arch!r}: expected one of "
            f"{', '.join(map(repr, ARCHS))}"
        )
    return "cpu" if arch in CPU_ARCHS else arch


def runs_on_gpu() -> bool:
    """Return whether kernels run on a GPU; start the runtime if necessary."""
    start()
    return running_arch() != "cpu"


def running_arch() -> str:
    """Return the arch of the running runtime: "cpu", or Taichi's name of the GPU arch."""
    from tisfm.kernels.layout import internals

    return internals.arch()


def lanes() -> int:
    """Return the lane count for the running arch; start the runtime if necessary."""
    return 1 if runs_on_gpu() else cpu_lanes()


def cpu_lanes() -> int:
    """Return the lane count for this CPU: 16 with vectors of that width (AVX-512), else 8."""
    return 16 if cv2.checkHardwareSupport(_AVX_512F) else 8


def lane_grid(height: int, width: int) -> "LaneGrid":
    """Return a grid whose arrays have the layout for the running arch and lie on its device."""
    is_on_gpu = runs_on_gpu()  # first: it starts Taichi, which must precede the import of kernels
    from tisfm.kernels.layout.lanes import LaneGrid

    try:
        return LaneGrid(height, width, lanes=lanes(), on_device=is_on_gpu)
    except ValueError as error:  # the frames are larger than kernels can index
        raise InputError(str(error)) from None


def threads() -> int:
    """Return the maximum number of CPU threads of kernels; start the runtime if necessary."""
    start()
    return _max_threads()


def _max_threads() -> int:
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

    configuration = internals.configuration()
    if configuration.default_ip != ti.i32:
        raise RunError(
            f"Taichi already runs with default_ip={configuration.default_ip.to_string()}: its "
            "compiler fails on our kernels then; start it with ti.i32, its default"
        )
    if arch is not None and running_arch() != arch:
        raise RunError(
            f"Taichi already runs on {running_arch()!r}, not on {arch!r}: call "
            "tisfm.runtime.start before the first interpretation, or let the application that "
            "started Taichi choose"
        )
    if threads is not None and configuration.cpu_max_num_threads != threads:
        raise RunError(
            f"Taichi already runs with {configuration.cpu_max_num_threads} threads, asked for "
            f"{threads}: call tisfm.runtime.start before the first interpretation"
        )


def _warn_of_slow_options() -> None:
    """Warn, once for each ``ti.init``, if an application started Taichi with slow options.

    The options are splitting of vectors into scalars, or Vulkan that is emulated in software.
    """
    global _warned_program_id
    from tisfm.kernels.layout import internals

    program, arch = id(internals.program()), running_arch()
    if _warned_program_id == program:
        return
    if arch == "vulkan":
        # Set first: the query of the drivers is slow and need not repeat.
        _warned_program_id = program
        if device := software_vulkan():
            warnings.warn(software_vulkan_message(device), SoftwareVulkanWarning, stacklevel=4)
    if arch == "cpu" and internals.configuration().real_matrix_scalarize:
        _warned_program_id = program
        warnings.warn(
            "Taichi was started without real_matrix_scalarize=False: kernels may take minutes to "
            "compile, and are slower. Pass it: ti.init(arch=ti.cpu, real_matrix_scalarize=False); "
            "or call tisfm.runtime.start() in place of ti.init",
            stacklevel=4,
        )
