"""Starting Taichi for a command, with a line on the device that Vulkan runs on."""

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
        warnings.simplefilter("ignore", runtime.SoftwareVulkanWarning)  # tell_device printed it
        runtime.start(arch, threads=threads)


def tell_device(arch: Arch | None) -> None:
    """Print which device Vulkan runs on, if kernels run on Vulkan."""
    if (arch or os.environ.get("TI_ARCH")) != "vulkan":
        return
    device = vulkan_device()
    if device is not None and device.is_software:
        tell(runtime.software_said(device.name))
    elif device is not None:
        tell(f"vulkan runs on {device.name}")
