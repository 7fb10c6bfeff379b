"""Where kernels run: the argument, the environment, and software Vulkan."""

import warnings

import pytest

from tests.runtime.programs import answer
from tisfm import runtime


@pytest.mark.parametrize("arch", ["gpu", "x64", "", 1])
def test_unknown_arch(arch):
    with pytest.raises(ValueError, match=r"arch is .*expected one of 'cpu', 'cuda', 'vulkan', "):
        runtime.start(arch)


def test_an_absent_arch_is_refused_and_another_can_be_started():
    code = """
    import os
    from tisfm import runtime
    for arch in ("cuda", "metal", "vulkan"):
        try:
            runtime.start(arch)
            break
        except RuntimeError as error:
            print(error)
    else:
        runtime.start()
    print(runtime.running_arch(), min(runtime.lanes(), 8), "TI_ARCH" in os.environ)
    """
    # Software Vulkan gives a warning.
    *refusals, last = answer(code, TI_ARCH=None, PYTHONWARNINGS="ignore").splitlines()
    for arch, refusal in zip(("cuda", "metal", "vulkan"), refusals, strict=False):
        assert refusal.startswith(f"Taichi cannot run on {arch!r} here: it needs ")
    assert last == ("cpu 8 False" if len(refusals) == 3 else f"{last.split()[0]} 1 False")


def test_another_arch_than_the_running_one_is_refused(monkeypatch):
    monkeypatch.setattr(runtime, "running_arch", lambda: "cpu")
    with pytest.raises(RuntimeError, match="Taichi already runs on 'cpu', not on 'metal'"):
        runtime.start("metal")


STARTED = """
import os
from tisfm import runtime
for variable, arch in {attempts}:
    os.environ["TI_ARCH"] = variable
    try:
        runtime.start(arch)
        print(runtime.running_arch())
    except (RuntimeError, ValueError) as error:
        print(error)
    assert os.environ["TI_ARCH"] == variable
"""


def test_the_environment_names_the_arch():
    assert answer(STARTED.format(attempts=[("x64", None)])) == "cpu"
    # The argument takes precedence.
    unknown, argument = answer(
        STARTED.format(attempts=[("gpu", None), ("cuda", "cpu")])
    ).splitlines()
    assert unknown.startswith(
        "the environment variable TI_ARCH is 'gpu': expected one of 'cpu', 'cuda'"
    )
    assert argument == "cpu"
    printed = answer(STARTED.format(attempts=[("cuda", None)]))
    assert printed.startswith("Taichi cannot run on 'cuda' here") or printed == "cuda"


def test_software_vulkan_gives_a_warning(monkeypatch):
    """It names the driver without a GPU, and the arch to take."""
    monkeypatch.setattr(runtime, "_is_running", lambda: False)
    monkeypatch.setattr(runtime, "_initialise", lambda arch, options: None)
    monkeypatch.setattr(runtime, "software_vulkan", lambda: "llvmpipe (LLVM 15)")
    with pytest.warns(UserWarning, match="vulkan runs on llvmpipe .LLVM 15., software on the CPU"):
        runtime._start("vulkan", None, False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime._start("cuda", None, False)
        monkeypatch.setattr(runtime, "software_vulkan", lambda: "")
        runtime._start("vulkan", None, False)


def test_software_vulkan_that_an_application_started_gives_one_warning(monkeypatch):
    monkeypatch.setattr(runtime, "running_arch", lambda: "vulkan")
    monkeypatch.setattr(runtime, "software_vulkan", lambda: "llvmpipe (LLVM 15)")
    monkeypatch.setattr(runtime, "_warned_program_id", None)
    with pytest.warns(runtime.SoftwareVulkanWarning, match="vulkan runs on llvmpipe"):
        runtime.start()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime.start()
    monkeypatch.setattr(runtime, "_warned_program_id", None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime.start_worker()  # the main process has warned
