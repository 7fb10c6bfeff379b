"""The built wheel, used away from the checkout: it holds every package, and works."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

import tisfm
from tests.imports import sources
from tests.test_api import PUBLIC

ROOT = Path(__file__).parents[1]
BUILD = "from setuptools import build_meta; print(build_meta.build_wheel('dist'))"

# Run without `site`: its .pth files would lead back to the checkout of an editable install.
USE = """
import json, sys
from importlib import import_module, metadata
from pathlib import Path

import tisfm

modules, public = json.loads(sys.argv[1])
assert "taichi" not in sys.modules and "matplotlib" not in sys.modules
for module, names in public.items():
    found = tisfm
    for part in module.split(".")[1:]:
        found = getattr(found, part)
    for name in names:
        getattr(found, name)
missing = []
for name in modules:
    try:
        import_module(name)
    except ModuleNotFoundError as error:
        missing.append(f"{name}: {error}")
assert not missing, missing
installed = Path.cwd() / "installed"
for name, module in list(sys.modules.items()):
    if name.partition(".")[0] == "tisfm":
        assert Path(module.__file__).is_relative_to(installed), module.__file__

pair = tisfm.scenes.two_blocks(24, 32)
settings = tisfm.Settings.preset("fast", pyramid_levels=2)
result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
error = tisfm.metrics.endpoint_error(result.flow, pair.flow)
assert error < 0.5 * tisfm.metrics.endpoint_error(0 * pair.flow, pair.flow), error

(script,) = metadata.distribution("tisfm").entry_points
assert (script.group, script.name) == ("console_scripts", "tisfm")
sys.argv[1:] = ["--help"]
script.load()()
"""


def run(folder, code, *arguments, options=(), **environment):
    command = [sys.executable, *options, "-c", code, *arguments]
    done = subprocess.run(
        command, cwd=folder, env=os.environ | environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel from a copy of the sources, since setuptools writes beside them."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in ("tisfm", "kernels"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    name = run(folder, BUILD).splitlines()[-1]
    assert name.startswith(f"tisfm-{tisfm.__version__}-py3-none-any")
    return folder / "dist" / name


def test_the_wheel_holds_every_module(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    expected = {
        f"{name.replace('.', '/')}{'/__init__' * (path.name == '__init__.py')}.py"
        for name, path in sources().items()
    }
    assert held == expected


def test_the_wheel_works_away_from_the_checkout(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:  # pure Python: unpacking is installing
        archive.extractall(tmp_path / "installed")
    path = [str(tmp_path / "installed"), *map(sysconfig.get_path, ("purelib", "platlib"))]
    listed = json.dumps([list(sources()), PUBLIC])
    text = run(tmp_path, USE, listed, options=["-S"], PYTHONPATH=os.pathsep.join(path))
    assert "usage: tisfm" in text and "run" in text and "eval" in text
