"""A program that tries items in a process of its own; no module imports this file.

Its arguments are the items. It prints a line of JSON before and after each item, so that the last
line names the item at which it crashed or hung.
"""

import json
import os
import sys
import time
from importlib import import_module
from typing import Any


def report(name: str, **values: Any) -> None:
    """Print a line of JSON."""
    print(json.dumps({"name": name, **values}), file=_OUT, flush=True)


def try_import(name: str) -> None:
    """Import a module."""
    begin = time.perf_counter()
    import_module(name)
    report(name, seconds=time.perf_counter() - begin)


def try_command_line(name: str) -> None:
    """Import all that a command imports first, unless the address space is too small for it."""
    from tisfm.machine.memory import import_libraries

    import_libraries()
    import_module("tisfm.cli.command_line")
    report(name)


def try_kernel(name: str) -> None:
    """Start Taichi as tisfm does, on an arch; compile and run one small kernel."""
    import numpy as np

    from tisfm import runtime

    begin = time.perf_counter()
    arch = name.partition(":")[2]
    runtime.start(None if arch == "default" else arch)  # type: ignore[arg-type]
    import taichi as ti

    @ti.kernel
    def double(values: ti.types.ndarray()):  # type: ignore[no-untyped-def, valid-type]
        for index in values:
            values[index] = 2 * values[index]

    values = np.arange(1024, dtype=np.float32)
    double(values)
    ti.sync()
    if not np.array_equal(values, 2 * np.arange(1024, dtype=np.float32)):
        raise RuntimeError("a kernel that doubles numbers gives others")
    report(
        name,
        arch=runtime.running_arch(),
        lanes=runtime.lanes(),
        threads=runtime.threads(),
        seconds=time.perf_counter() - begin,
    )


def try_archs(name: str) -> None:
    """Ask Taichi's library which GPU archs have what they need here."""
    # Else Taichi's import prints a banner, and starts a thread that asks the network.
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
    os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
    import_module("taichi")
    library = import_module("taichi._lib").core
    archs = [
        arch for arch in ("cuda", "vulkan", "metal") if getattr(library, f"with_{arch}", bool)()
    ]
    report(name, archs=archs)


def try_software_vulkan(name: str) -> None:
    """Ask the Vulkan drivers whether Taichi would run on software instead of a GPU."""
    from tisfm.machine.vulkan import software_vulkan

    report(name, device=software_vulkan())


def main(names: list[str]) -> None:
    """Try the items in order; an error of one does not stop the others."""
    if sys.path[:1] == [""]:
        del sys.path[0]  # modules of the working folder must not replace those of Python
    for name in names:
        report(name, begun=True)
        try:
            if name.startswith("kernel:"):
                try_kernel(name)
            elif name == "archs":
                try_archs(name)
            elif name == "software_vulkan":
                try_software_vulkan(name)
            elif name == "tisfm":
                try_command_line(name)
            else:
                try_import(name)
        except BaseException as error:
            text = " ".join(str(error).split())
            report(name, error=f"{type(error).__name__}: {text}" if text else type(error).__name__)


if __name__ == "__main__":
    # What libraries print on standard output must not mix with ours.
    _OUT = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    main(sys.argv[1:])
