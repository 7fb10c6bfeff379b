"""Cores, memory, limits, Taichi's cache and GPUs of this machine."""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tisfm.doctor.control_groups import group_limits
from tisfm.doctor.finding import Finding
from tisfm.doctor.trials import TrialResults
from tisfm.machine.kernel_cache import LOCK, STALE_LOCK_AGE, cache_folder
from tisfm.machine.memory import address_space_limit
from tisfm.threads import usable_cores

RAISE_LIMIT = "raise the limit of the address space (ulimit -v) first"
_MIN_ADDRESS_SPACE = 3.0e9  # bytes of address space for a pair of 1920 × 1080 px; measured
_MIN_MEMORY = 2.0e9  # bytes of memory for a pair of 1920 × 1080 px; measured


def examine_cores() -> Finding:
    """Return the finding about the cores that this process may use."""
    total = os.cpu_count() or 1
    usable, reasons = usable_cores(), []
    if usable < total:
        reasons.append(f"bound to {usable} of them")
    group_cores = group_limits().cores
    if group_cores is not None and group_cores < usable:
        reasons.append(f"the control group gives the time of {group_cores:g}")
    text = f"{total} core{'s' * (total != 1)}" + "".join(f", {reason}" for reason in reasons)
    if reasons:
        thread_count = max(1, int(min(usable, group_cores or usable)))
        return Finding(
            "Cores",
            "warning",
            text,
            f"give --threads {thread_count}: by default {total} threads start, and share them",
        )
    return Finding("Cores", "ok", text)


def examine_memory() -> Finding:
    """Return the finding about memory."""
    total, free = _memory()
    group = group_limits().memory
    if total is None:
        return Finding("Memory", "ok", "not known on this system")
    text = f"{total / 1e9:.1f} GB"
    if free is not None:
        text += f", {free / 1e9:.1f} GB of it free"
    if group is not None and group < total:
        text += f"; the control group allows {group / 1e9:.1f} GB"
        free = min(group, free or group)
    if free is not None and free < _MIN_MEMORY:
        return Finding(
            "Memory",
            "warning",
            text,
            "frames of 1920 × 1080 px take 2 GB: give --size 960 for smaller ones",
        )
    return Finding("Memory", "ok", text)


def is_limited() -> bool:
    """Return whether libraries may fail because the address space is limited."""
    max_bytes = address_space_limit()
    return max_bytes is not None and max_bytes < _MIN_ADDRESS_SPACE


def examine_addresses() -> Finding:
    """Return the finding about the limit of the address space."""
    max_bytes = address_space_limit()
    if max_bytes is None:
        return Finding("Address space", "ok", "not limited (ulimit -v)")
    text = f"limited to {max_bytes / 1e9:.2f} GB (ulimit -v)"
    if is_limited():
        return Finding(
            "Address space",
            "warning",
            text,
            "the libraries reserve far more than they use: ulimit -v 3000000 or more",
        )
    return Finding("Address space", "ok", text)


def examine_cache() -> Iterator[Finding]:
    """Yield findings about the folder of compiled kernels and a lock left there."""
    folder = cache_folder()
    if folder is None:
        yield Finding("Kernel cache", "ok", "where Taichi keeps it on Windows")
        return
    if not _is_writable(folder):
        yield Finding(
            "Kernel cache",
            "warning",
            f"{folder} cannot be written to: kernels are compiled anew in every process",
            "set TI_OFFLINE_CACHE_FILE_PATH to a folder of yours",
        )
        return
    size, count = 0, 0
    for path in folder.glob("*.tic"):
        try:
            size, count = size + path.stat().st_size, count + 1
        except OSError:  # another process removes it
            continue
    yield Finding(
        "Kernel cache", "ok", f"{folder}, {count} kernel{'s' * (count != 1)}, {size / 1e6:.0f} MB"
    )
    try:
        age = time.time() - (folder / LOCK).stat().st_mtime
    except OSError:
        return
    if age > STALE_LOCK_AGE:
        yield Finding(
            "Cache lock",
            "warning",
            f"{folder / LOCK} was left by a process that was killed, {age / 60:.0f} min ago",
            "the next command of tisfm removes it",
        )


def examine_folder(folder: Path) -> Finding:
    """Return the finding about the working folder."""
    name = "Working folder"
    if _is_writable(folder, make=False):
        return Finding(name, "ok", f"{folder} can be written to")
    return Finding(
        name,
        "warning",
        f"{folder} cannot be written to",
        "give a folder of yours with -o, or go to one",
    )


def examine_temporary() -> Finding:
    """Return the finding about the folder for temporary files."""
    try:
        return Finding("Temporary files", "ok", f"{tempfile.gettempdir()} can be written to")
    except OSError as error:
        return Finding(
            "Temporary files", "wrong", str(error), "set TMPDIR to a folder that can be written to"
        )


def examine_kernel(results: TrialResults) -> Iterator[Finding]:
    """Yield findings about a kernel that Taichi compiled and ran."""
    result = results["kernel:default"]
    if "error" in result:
        yield Finding(
            "Kernels", "wrong", f"Taichi does not run: {result['error']}", _taichi_advice()
        )
        return
    arch, lanes = result["arch"], result["lanes"]
    yield Finding(
        "Kernels",
        "ok",
        f"one was compiled and run on {arch}, with the import of Taichi in "
        f"{result['seconds']:.1f} s",
    )
    if arch == "cpu":
        width = {16: "16 numbers (AVX-512)", 8: "8 numbers (AVX2, or as NEON has them)"}
        yield Finding("Vectors", "ok", f"of {width.get(lanes, lanes)}")
        yield Finding("Threads", "ok", f"{result['threads']} by default")


def examine_gpus(results: TrialResults, gpu_results: TrialResults) -> Finding:
    """Return the finding about GPUs, none of which is needed."""
    result = results["archs"]
    if "error" in result:
        return Finding(
            "GPU",
            "absent",
            f"not known: {result['error']}",
            "none is needed; give --arch cpu if TI_ARCH names another arch",
        )
    software = software_vulkan_name(results)
    gpus = [arch for arch in result["archs"] if not (arch == "vulkan" and software)]
    working_archs = [arch for arch in gpus if "error" not in gpu_results.get(f"kernel:{arch}", {})]
    failing_archs = [arch for arch in gpus if arch not in working_archs]
    software_note = f"Vulkan here is {software}, software on the CPU, not a GPU"
    if working_archs:
        text = f"kernels run on {', '.join(working_archs)}: --arch {working_archs[0]}"
        if software:
            text += f". {software_note}"
        return Finding("GPU", "ok", text)
    text = "none that Taichi can use"
    if failing_archs:
        error = gpu_results[f"kernel:{failing_archs[0]}"]["error"]
        text = f"{', '.join(failing_archs)} cannot be started ({error})"
    if software:
        text += f". {software_note}"
    return Finding(
        "GPU",
        "absent",
        f"{text}; none is needed",
        "leave out --arch vulkan: the CPU alone is faster" if software else "",
    )


def software_vulkan_name(results: TrialResults) -> str:
    """Return the name of the software device that Vulkan offers in place of a GPU, or ""."""
    name: str = results.get("software_vulkan", {}).get("device", "")
    return name


def _taichi_advice() -> str:
    if is_limited():
        return RAISE_LIMIT
    arch = os.environ.get("TI_ARCH")
    if arch is not None:
        return f"the variable TI_ARCH is {arch!r}: unset it, or give --arch cpu"
    return (
        "first do what the lines above say; if they say nothing: pip install "
        "--force-reinstall taichi"
    )


def _is_writable(folder: Path, *, make: bool = True) -> bool:
    try:
        if make:
            folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _memory() -> tuple[float | None, float | None]:
    """Return the total and the free memory, bytes; None where the system does not say."""
    sizes = {}
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            name, _, value = line.partition(":")
            sizes[name] = 1024.0 * float(value.split()[0])
    except (OSError, ValueError, IndexError):
        pass
    return sizes.get("MemTotal"), sizes.get("MemAvailable")
