"""The device of Vulkan: found, ranked as Taichi ranks, and recognised as software."""

import re
import shutil
import subprocess

import pytest

from tisfm.machine import vulkan
from tisfm.machine.vulkan import VulkanDevice, software_vulkan, vulkan_device

LAVAPIPE = VulkanDevice(name="llvmpipe", is_software=True, score=400)
INTEGRATED = VulkanDevice(name="integrated", is_software=False, score=900)
DISCRETE = VulkanDevice(name="discrete", is_software=False, score=1400)


def offer(monkeypatch, *devices):
    monkeypatch.delenv("TI_VISIBLE_DEVICE", raising=False)
    monkeypatch.setattr(vulkan, "vulkan_devices", lambda: list(devices))


def test_software_is_distinguished_from_a_gpu(monkeypatch):
    offer(monkeypatch)
    assert vulkan_device() is None and software_vulkan() == ""
    offer(monkeypatch, LAVAPIPE)
    assert vulkan_device() == LAVAPIPE and software_vulkan() == "llvmpipe"
    offer(monkeypatch, LAVAPIPE, INTEGRATED, DISCRETE)
    assert vulkan_device() == DISCRETE and software_vulkan() == ""


@pytest.mark.parametrize(
    ("chosen", "device"), [("0", LAVAPIPE), ("1", INTEGRATED), ("7", INTEGRATED), ("x", INTEGRATED)]
)
def test_the_environment_chooses_a_device_as_for_taichi(monkeypatch, chosen, device):
    offer(monkeypatch, LAVAPIPE, INTEGRATED)
    monkeypatch.setenv("TI_VISIBLE_DEVICE", chosen)
    assert vulkan_device() == device


def test_no_loader_of_vulkan(monkeypatch):
    def refuse(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(vulkan.ctypes, "CDLL", refuse)
    assert vulkan.vulkan_devices() == []


def test_the_devices_are_those_of_vulkaninfo():
    """An independent reader of the same drivers, where it is installed."""
    if shutil.which("vulkaninfo") is None:
        pytest.skip("vulkaninfo is not installed")
    done = subprocess.run(["vulkaninfo", "--summary"], capture_output=True, text=True, check=False)
    names = re.findall(r"deviceName\s*= (.*)", done.stdout)
    kinds = re.findall(r"deviceType\s*= (.*)", done.stdout)
    found = vulkan.vulkan_devices()
    assert [device.name for device in found] == names
    assert [device.is_software for device in found] == [kind.endswith("_CPU") for kind in kinds]
