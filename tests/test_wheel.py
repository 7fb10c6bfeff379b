"""The built wheel, used away from the checkout: it holds every package, and works."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from email import message_from_string
from pathlib import Path

import pytest

import tisfm
from tests.imports import sources
from tests.test_api import PUBLIC

ROOT = Path(__file__).parents[1]
TEMPLATES = ROOT / "tisfm" / "templates"
LARGEST = 2_000_000  # bytes; more would be data that nobody meant to give out
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
    templates = {path.relative_to(ROOT).as_posix() for path in TEMPLATES.glob("[!_]*.*")}
    assert templates and held == expected | templates


def test_the_wheel_has_its_licence_and_metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        about = {name.partition("/")[2]: archive.read(name).decode()
                 for name in archive.namelist() if ".dist-info/" in name}  # fmt: skip
    (licence,) = {"LICENSE", "licenses/LICENSE"} & set(about)  # setuptools before 77, and since
    assert about.pop(licence) == (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert set(about) == {"METADATA", "RECORD", "WHEEL", "entry_points.txt", "top_level.txt"}
    assert about["top_level.txt"].split() == ["tisfm"]

    metadata = message_from_string(about["METADATA"])
    assert metadata["Name"] == "tisfm"
    assert metadata["Version"] == tisfm.__version__
    assert metadata["License"] == "Apache-2.0"
    assert metadata["Requires-Python"] == "<3.14,>=3.10"
    assert metadata["Summary"] in (ROOT / "README.md").read_text(encoding="utf-8")
    assert set(metadata.get_all("Provides-Extra")) >= {"video", "mesh", "test", "dev"}
    needed = metadata.get_all("Requires-Dist")
    always = {re.match(r"[\w-]+", line)[0] for line in needed if "extra ==" not in line}
    assert {"taichi", "numpy", "opencv-python-headless"} <= always
    assert not {"pytest", "evo", "pip-audit", "av"} & always


def test_the_wheel_is_small_and_of_no_machine(wheel):
    assert wheel.stat().st_size < LARGEST
    with zipfile.ZipFile(wheel) as archive:
        for name in archive.namelist():
            assert not name.startswith(("/", "..")) and "\\" not in name
            text = archive.read(name).decode("utf-8")
            for place in (ROOT, wheel.parents[1]):
                assert f"{place}{os.sep}" not in text, (name, place)


@pytest.mark.nightly
def test_pip_installs_it_and_the_command_runs(wheel, tmp_path):
    """Into an environment of its own; what it needs is taken from that of the tests."""
    place = tmp_path / "environment"
    venv.create(place, with_pip=True)
    scripts = place / ("Scripts" if os.name == "nt" else "bin")
    python = scripts / "python"

    def done(*command):
        options = {"cwd": tmp_path, "capture_output": True, "text": True, "check": False}
        variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        found = subprocess.run([*map(str, command)], env=variables, **options)
        assert found.returncode == 0, found.stderr
        return found.stdout.strip()

    done(python, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", wheel)
    site = Path(done(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"))
    ours = dict.fromkeys(map(sysconfig.get_path, ("purelib", "platlib")))
    (site / "of_the_tests.pth").write_text("\n".join(ours) + "\n", encoding="utf-8")
    where = done(
        python, "-c", "import tisfm.kernels; print(tisfm.__file__, tisfm.kernels.__file__)"
    )
    assert all(Path(name).is_relative_to(site) for name in where.split())
    assert done(scripts / "tisfm", "--version") == tisfm.__version__
    done(python, "-m", "pip", "uninstall", "--quiet", "--yes", "tisfm")
    assert not [path for path in site.glob("tisfm*") if any(path.rglob("*.py"))]


def test_the_wheel_works_away_from_the_checkout(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:  # pure Python: unpacking is installing
        archive.extractall(tmp_path / "installed")
    path = [str(tmp_path / "installed"), *map(sysconfig.get_path, ("purelib", "platlib"))]
    listed = json.dumps([list(sources()), PUBLIC])
    text = run(tmp_path, USE, listed, options=["-S"], PYTHONPATH=os.pathsep.join(path))
    assert "usage: tisfm" in text and "run" in text and "eval" in text
