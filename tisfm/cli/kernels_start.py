"""Starting Taichi for a command, which says what the kernels run on where that is no CPU."""

import os
import warnings

from tisfm import runtime
from tisfm.cli.console import tell
from tisfm.machine.vulkan import vulkan_device
from tisfm.runtime import Arch


def start_kernels(arch: Arch | None, *, threads: int | None) -> None:
    """Start Taichi as `tisfm.runtime.start` does, and say which device Vulkan runs on."""
    tell_device(arch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", runtime.SoftwareVulkanWarning)  # it was told
        runtime.start(arch, threads=threads)


def tell_device(arch: Arch | None) -> None:
    """Say which device Vulkan runs on, if kernels are to run there; nothing of other archs."""
    if (arch or os.environ.get("TI_ARCH")) != "vulkan":
        return
    device = vulkan_device()
    if device is not None and device.is_software:
        tell(runtime.software_said(device.name))
    elif device is not None:
        tell(f"vulkan runs on {device.name}")
