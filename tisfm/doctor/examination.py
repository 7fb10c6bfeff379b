"""The examination: all findings, in the order in which they are printed."""

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from tisfm.doctor import machine, packages
from tisfm.doctor.finding import Finding, as_json, as_text, is_well
from tisfm.doctor.trials import Trial, TrialResults, collect_results, run_trial
from tisfm.machine.text import printable

_KERNEL_LIMIT = 45.0  # s, enough for a slow machine to compile; set by hand
_GPU_LIMIT = 20.0  # s, after which a GPU driver counts as hanging; set by hand


def examine() -> list[Finding]:
    """Return the findings of all examinations; it raises nothing."""
    base, extras, requirements_error = packages.requirements()
    modules = [packages.module_of(name) for name in base if name != "taichi"]
    optional = [
        packages.module_of(name)
        for packages_of_extra in extras.values()
        for name in packages_of_extra
    ]
    kernel = Trial(["tisfm", "kernel:default"], limit=_KERNEL_LIMIT)
    imports = Trial([*modules, *optional])
    archs = Trial(["archs", "software_vulkan"], limit=_GPU_LIMIT)
    trial_results = collect_results(imports, kernel, archs)
    gpu_results: TrialResults = {}
    software_vulkan = machine.software_vulkan_name(trial_results)
    for arch in trial_results["archs"].get("archs", []):
        if not (arch == "vulkan" and software_vulkan):
            gpu_results |= run_trial([f"kernel:{arch}"], limit=_GPU_LIMIT)
    # The import of Taichi takes longest, so it is not tried a third time: a kernel that ran has
    # imported it. If no kernel ran, another library may be the reason.
    arch_results = {} if "error" not in trial_results["kernel:default"] else trial_results["archs"]
    trial_results["taichi"] = {key: value for key, value in arch_results.items() if key == "error"}
    examinations: list[Callable[[], Finding | Iterable[Finding]]] = [
        packages.examine_python,
        lambda: packages.examine_tisfm(trial_results, requirements_error),
        lambda: packages.examine_base(base, trial_results),
        packages.examine_opencv,
        lambda: machine.examine_kernel(trial_results),
        machine.examine_cores,
        machine.examine_memory,
        machine.examine_addresses,
        machine.examine_cache,
        lambda: machine.examine_folder(Path.cwd()),
        machine.examine_temporary,
        lambda: machine.examine_gpus(trial_results, gpu_results),
        lambda: packages.examine_extras(extras, trial_results),
    ]
    findings: list[Finding] = []
    for examination in examinations:
        try:
            result = examination()
            findings += [result] if isinstance(result, Finding) else list(result)
        except Exception as error:  # a failed examination is a finding, too
            text = " ".join(str(error).split())
            findings.append(Finding("doctor", "warning", f"{type(error).__name__}: {text}"))
    return findings


def doctor(*, json: bool = False) -> int:
    """Print the findings; return the exit code, 1 if something is broken."""
    findings = examine()
    text = as_json(findings) if json else as_text(findings)
    text = "\n".join(map(printable, text.split("\n")))
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, "replace").decode(encoding), flush=True)
    return 0 if is_well(findings) else 1
