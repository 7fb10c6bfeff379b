"""The device that Vulkan offers here, and whether it is a GPU or a program on the CPU.

Mesa's lavapipe (llvmpipe) and SwiftShader are Vulkan drivers without a GPU: they compute on the
CPU, far slower than Taichi's own code for it. They often come with a browser's packages.
"""

import ctypes
import os
import sys
from dataclasses import dataclass

_SUCCESS = 0
_INCOMPLETE = 5  # there are more devices than the array has elements
_INSTANCE_CREATE_INFO = 1  # VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO
_TYPE_SCORES = {1: 500, 2: 1000}  # of integrated and discrete GPUs, as Taichi ranks devices
_CPU_DEVICE_TYPE = 4  # VK_PHYSICAL_DEVICE_TYPE_CPU
_WIDE_LINES_FEATURE = 15  # index of this feature in VkPhysicalDeviceFeatures
_MAX_DEVICES = 64


@dataclass(frozen=True, kw_only=True)
class VulkanDevice:
    """A device that Vulkan offers."""

    name: str  # as its driver calls it
    is_software: bool  # whether it computes on the CPU: no GPU takes part
    score: int  # Taichi takes the device with the highest score, the first one of several


class _InstanceCreateInfo(ctypes.Structure):
    _fields_ = (
        ("sType", ctypes.c_uint32),
        ("pNext", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("pApplicationInfo", ctypes.c_void_p),
        ("enabledLayerCount", ctypes.c_uint32),
        ("ppEnabledLayerNames", ctypes.c_void_p),
        ("enabledExtensionCount", ctypes.c_uint32),
        ("ppEnabledExtensionNames", ctypes.c_void_p),
    )


class _Properties(ctypes.Structure):
    """VkPhysicalDeviceProperties, whose last fields are not read here."""

    _fields_ = (
        ("apiVersion", ctypes.c_uint32),
        ("driverVersion", ctypes.c_uint32),
        ("vendorID", ctypes.c_uint32),
        ("deviceID", ctypes.c_uint32),
        ("deviceType", ctypes.c_uint32),
        ("deviceName", ctypes.c_char * 256),
        ("rest", ctypes.c_uint64 * 256),  # 552 bytes in Vulkan 1.0, here with room to spare
    )


def software_vulkan() -> str:
    """Return the name of the device that ``--arch vulkan`` runs on if it is software, else "".

    It loads the drivers of Vulkan into this process.
    """
    device = vulkan_device()
    return device.name if device is not None and device.is_software else ""


def vulkan_device() -> VulkanDevice | None:
    """Return the device that Taichi takes for Vulkan, None where there is none or it is not known.

    The environment variable TI_VISIBLE_DEVICE chooses one by its number, as it does for Taichi.
    """
    devices = vulkan_devices()
    if not devices:
        return None
    device_number = os.environ.get("TI_VISIBLE_DEVICE", "")
    if device_number.isdecimal() and int(device_number) < len(devices):
        return devices[int(device_number)]
    return max(devices, key=lambda device: device.score)


def vulkan_devices() -> list[VulkanDevice]:
    """Return all devices that Vulkan offers, in the order of the Vulkan loader.

    The list is empty where there is no Vulkan loader, and on macOS, where Taichi brings its own.
    """
    library = _load_vulkan()
    if library is None:
        return []
    instance = ctypes.c_void_p()
    create_info = _InstanceCreateInfo(sType=_INSTANCE_CREATE_INFO)
    if (
        library.vkCreateInstance(ctypes.byref(create_info), None, ctypes.byref(instance))
        != _SUCCESS
    ):
        return []
    try:
        count = ctypes.c_uint32(_MAX_DEVICES)
        handles = (ctypes.c_void_p * _MAX_DEVICES)()
        return_code = library.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
        if return_code not in (_SUCCESS, _INCOMPLETE):
            return []
        return [_describe_device(library, handles[index]) for index in range(count.value)]
    finally:
        library.vkDestroyInstance(instance, None)


def _load_vulkan() -> ctypes.CDLL | None:
    names = {"linux": ("libvulkan.so.1", "libvulkan.so"), "win32": ("vulkan-1.dll",)}
    for name in names.get(sys.platform, ()):
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def _describe_device(library: ctypes.CDLL, handle: int | None) -> VulkanDevice:
    properties, features = _Properties(), (ctypes.c_uint32 * 256)()
    device = ctypes.c_void_p(handle)
    library.vkGetPhysicalDeviceProperties(device, ctypes.byref(properties))
    library.vkGetPhysicalDeviceFeatures(device, features)
    minor = (properties.apiVersion >> 12) & 0x3FF
    return VulkanDevice(
        name=properties.deviceName.decode("utf-8", "replace"),
        is_software=properties.deviceType == _CPU_DEVICE_TYPE,
        score=_TYPE_SCORES.get(properties.deviceType, 0)
        + 100 * minor
        + 100 * bool(features[_WIDE_LINES_FEATURE]),
    )
