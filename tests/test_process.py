"""What the library changes in a process: docs/process.md lists all of it."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "process.md").read_text(encoding="utf-8")
# The one function of Taichi that is replaced, and the release whose function it replaces.
REPLACED = ["taichi.lang.ast.ast_transformer_utils.ASTTransformerContext.get_pos_info"]
STATE = """
import json, os, sys, warnings
sys.argv = ["tisfm", "doctor"]  # as if it were the command: the library must not look at it

def state():
    return {
        "environment": dict(os.environ),
        "finders": [getattr(finder, "__name__", str(finder)) for finder in sys.meta_path],
        "filters": len(warnings.filters),
        "packages": sorted({name.partition(".")[0] for name in sys.modules}),
    }

"""
ALONE = """
before = state()
import tisfm
print(json.dumps([before, state()]))
"""
USED = """
import cv2, numpy, taichi  # what they change themselves is theirs
before = state()
import tisfm
tisfm.runtime.start(threads=1)
import tisfm.solver.coarse_to_fine
print(json.dumps([before, state()]))
"""
TAICHI = """
import importlib, json, pkgutil, sys
import taichi

def functions():
    found = {}
    for module_name, module in list(sys.modules.items()):
        if module_name.partition(".")[0] != "taichi":
            continue
        for name, value in list(vars(module).items()):
            if callable(value):
                found[f"{module_name}.{name}"] = value
            if isinstance(value, type) and value.__module__ == module_name:
                for inner, function in list(vars(value).items()):
                    if callable(function):
                        found[f"{module_name}.{name}.{inner}"] = function
    return found

before = functions()
import tisfm.kernels
for module in pkgutil.walk_packages(tisfm.kernels.__path__, "tisfm.kernels."):
    importlib.import_module(module.name)
after = functions()
print(json.dumps(sorted(name for name in before if before[name] is not after.get(name))))
"""


def printed(code):
    """Run code in a process of its own; return the JSON on its last line."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("TI_")}
    environment.pop("ENABLE_TAICHI_HEADER_PRINT", None)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_import_alone_changes_nothing_but_the_finder_of_the_kernels():
    before, after = printed(STATE + ALONE)
    assert after["environment"] == before["environment"]
    assert after["filters"] == before["filters"]
    assert set(after["finders"]) - set(before["finders"]) <= {"_CheckoutKernelsFinder"}
    foreign = set(after["packages"]) - set(before["packages"]) - set(sys.stdlib_module_names)
    assert foreign == {"tisfm"}


def test_the_page_lists_the_changes_of_the_first_use():
    before, after = printed(STATE + USED)
    changed = {
        name
        for name in before["environment"] | after["environment"]
        if before["environment"].get(name) != after["environment"].get(name)
    }
    assert changed == {"ENABLE_TAICHI_HEADER_PRINT", "TI_SKIP_VERSION_CHECK"}
    assert all(f"`{name}=" in PAGE for name in changed)
    assert set(after["finders"]) - set(before["finders"]) <= {"_CheckoutKernelsFinder"}


def test_one_function_of_taichi_is_replaced_and_the_page_names_it():
    assert printed(TAICHI) == REPLACED
    name = ".".join(REPLACED[0].split(".")[-2:])
    assert f"`{name}`" in PAGE


def test_the_page_is_of_the_release_that_is_pinned():
    pinned = re.search(r'"taichi==([\d.]+)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert f"Taichi {pinned[1]}" in PAGE


@pytest.mark.parametrize("folder", ["tisfm", "kernels"])
def test_one_module_uses_the_inner_names_of_taichi(folder):
    """The probe of the doctor asks Taichi's library which archs it has."""
    known = {"kernels/layout/internals.py", "tisfm/doctor/probe.py"}
    found = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / folder).rglob("*.py")
        if re.search(r"taichi\.(lang|_lib|_snode|_kernels)|\._primal", path.read_text("utf-8"))
    }
    assert found <= known
