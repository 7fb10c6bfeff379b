"""The line of a command on the device that ``--arch vulkan`` runs on."""

import pytest

from tisfm import runtime
from tisfm.cli import console
from tisfm.cli.console import start_kernels, tell_device
from tisfm.machine.vulkan import VulkanDevice

LAVAPIPE = VulkanDevice(name="llvmpipe (LLVM 15)", is_software=True, score=400)
CARD = VulkanDevice(name="A card", is_software=False, score=1400)


@pytest.mark.parametrize(
    ("device", "said"),
    [
        (LAVAPIPE, "vulkan runs on llvmpipe (LLVM 15), software on the CPU, not a GPU: it is slow"),
        (CARD, "vulkan runs on A card\n"),
        (None, ""),
    ],
)
def test_the_device_is_printed_once(monkeypatch, capsys, device, said):
    started = []
    monkeypatch.setattr(console, "vulkan_device", lambda: device)
    monkeypatch.setattr(runtime, "start", lambda arch, threads: started.append((arch, threads)))
    start_kernels("vulkan", threads=3)
    err = capsys.readouterr().err
    assert err.startswith(said) and err.count("vulkan runs on") == (device is not None)
    assert started == [("vulkan", 3)]


def test_other_archs_are_not_printed(monkeypatch, capsys):
    monkeypatch.setattr(console, "vulkan_device", lambda: LAVAPIPE)
    monkeypatch.setenv("TI_ARCH", "vulkan")
    tell_device("cpu")
    assert capsys.readouterr().err == ""
    tell_device(None)
    assert "llvmpipe" in capsys.readouterr().err
    monkeypatch.delenv("TI_ARCH")
    tell_device(None)
    assert capsys.readouterr().err == ""
