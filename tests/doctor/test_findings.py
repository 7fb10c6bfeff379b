"""What the doctor finds of packages, machines and processes, broken ones too."""

import json
import os
import time
from importlib import metadata
from importlib.util import find_spec

import pytest

from tisfm.doctor import machine, packages
from tisfm.doctor.finding import Finding, as_json, as_text, is_well
from tisfm.doctor.trying import try_out
from tisfm.machine.kernel_cache import LOCK


def test_what_cannot_be_imported_is_told(tmp_path, monkeypatch):
    (tmp_path / "breaks.py").write_text("raise OSError('libGL.so.1: no such file')")
    (tmp_path / "crashes.py").write_text("import os; os.kill(os.getpid(), 9)")
    (tmp_path / "hangs.py").write_text("import time; time.sleep(60)")
    (tmp_path / "prints.py").write_text('print(\'{"name": "json", "error": "no"}\')')
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    tried = try_out(["json", "breaks", "gone", "prints", "crashes", "csv"])
    assert "error" not in tried["json"] and "error" not in tried["prints"]
    assert tried["breaks"]["error"] == "OSError: libGL.so.1: no such file"
    assert "No module named 'gone'" in tried["gone"]["error"]
    if os.name != "nt":
        assert tried["crashes"]["error"] == "the process crashed (signal 9)"
        assert tried["csv"]["error"] == "the process crashed (signal 9)"
    assert "within 2 s" in try_out(["hangs"], limit=2.0)["hangs"]["error"]


def installed(monkeypatch, **versions):
    """Let these distributions, with dashes for underscores, be all that there are."""
    known = {name.replace("_", "-"): version for name, version in versions.items()}

    def version(name):
        if name not in known:
            raise metadata.PackageNotFoundError(name)
        return known[name]

    monkeypatch.setattr(packages.metadata, "version", version)


def test_builds_of_opencv_that_clash(monkeypatch):
    installed(monkeypatch, opencv_python="5.0", opencv_python_headless="4.13")
    found = packages.about_opencv()
    assert found.verdict == "wrong"
    assert "pip uninstall opencv-python opencv-python-headless;" in found.advice
    installed(monkeypatch, opencv_contrib_python="5.0")
    assert packages.about_opencv().verdict == "warning"
    installed(monkeypatch, opencv_python_headless="5.0")
    assert packages.about_opencv().verdict == "ok"


def test_versions_and_what_is_missing(monkeypatch):
    installed(monkeypatch, numpy="1.26.4", scipy="1.12", pillow="11.0", av="16.0")
    base = {"numpy": ">=2", "scipy": ">=1.11", "pillow": ">=10.1", "rich": ">=13.7"}
    broken = {"scipy": {"error": "ImportError: broken"}, "rich": {"error": "x"}}
    tried = {"numpy": {}, "PIL": {}, **broken}
    found = {one.name: one for one in packages.about_base(base, tried)}
    assert {name: one.verdict for name, one in found.items()} == {
        "numpy": "wrong", "scipy": "wrong", "pillow": "ok", "rich": "wrong",
    }  # fmt: skip
    assert "asks for >=2" in found["numpy"].text
    assert "ImportError: broken" in found["scipy"].text
    assert found["rich"].advice == "pip install 'rich>=13.7'"
    extras = {"video": {"av": ">=17"}, "mesh": {"scikit-image": ">=0.25"}}
    missing = {"av": {}, "skimage": {"error": "no module"}}
    found = {one.name: one for one in packages.about_extras(extras, missing)}
    assert found["av [video]"].verdict == "warning"
    assert found["scikit-image [mesh]"].verdict == "absent"
    assert "pip install 'tisfm[mesh]'" in found["scikit-image [mesh]"].advice


def test_what_tisfm_asks_for_is_read_from_its_metadata():
    base, extras = packages.requirements()
    if not base:
        pytest.skip("tisfm is not installed here")
    assert base["numpy"] == ">=2" and base["taichi"].startswith("==")
    assert set(extras) >= {"video", "mesh", "cluster"} and not set(extras) & {"test", "docs", "dev"}
    assert "av" in extras["video"]


def test_a_cache_that_cannot_be_used_and_a_lock_that_was_left(tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(cache))
    if os.name == "nt":
        pytest.skip("Taichi's folder is not known on Windows")
    (found,) = machine.about_cache()
    assert found.verdict == "ok" and str(cache) in found.text
    lock = cache / LOCK
    lock.touch()
    assert len(list(machine.about_cache())) == 1  # it may be held
    os.utime(lock, (time.time() - 600,) * 2)
    assert [one.verdict for one in machine.about_cache()] == ["ok", "warning"]
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(tmp_path / "file"))
    (found,) = machine.about_cache()
    assert found.verdict == "warning" and "compiled anew" in found.text


def test_limits_of_control_groups(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "_GROUPS", tmp_path)
    monkeypatch.setattr(machine.os, "cpu_count", lambda: 8)
    usable = [6]
    monkeypatch.setattr(
        machine.os, "sched_getaffinity", lambda process: set(range(usable[0])), raising=False
    )
    (tmp_path / "cpu.max").write_text("max 100000\n")
    assert machine.about_cores().text == "8 cores, bound to 6 of them"
    (tmp_path / "cpu.max").write_text("250000 100000\n")
    found = machine.about_cores()
    assert "time of 2.5" in found.text and "--threads 2" in found.advice
    usable[0] = 8
    (tmp_path / "cpu.max").write_text("nonsense")
    assert machine.about_cores().verdict == "ok"
    (tmp_path / "memory.max").write_text("100000000\n")
    if machine._memory()[0] is not None:
        found = machine.about_memory()
        assert found.verdict == "warning" and "allows 0.1 GB" in found.text


def test_kernels_and_gpus():
    broken = {"kernel:default": {"error": "ImportError: no taichi"}, "archs": {"error": "x"}}
    (found,) = machine.about_kernel(broken)
    assert found.verdict == "wrong" and "no taichi" in found.text
    assert machine.about_gpus(broken, {}).verdict == "absent"
    archs = {"archs": {"archs": ["cuda", "vulkan"]}}
    half = {"kernel:cuda": {"error": "no device"}, "kernel:vulkan": {"arch": "vulkan"}}
    assert "vulkan: --arch vulkan" in machine.about_gpus(archs, half).text
    none = {"kernel:cuda": {"error": "no device"}, "kernel:vulkan": {"error": "none"}}
    found = machine.about_gpus(archs, none)
    assert found.verdict == "absent" and "no device" in found.text


def test_text_and_json():
    findings = [
        Finding(name="A", verdict="ok", text="1.0"),
        Finding(name="Long name", verdict="wrong", text="word " * 40, advice="do this"),
        Finding(name="C", verdict="warning", text="", advice="do that"),
    ]
    lines = as_text(findings).splitlines()
    assert lines[0] == "ok       A          1.0" and max(map(len, lines)) <= 100
    assert lines[-1] == "1 is wrong. 1 warning." and any("→ do this" in line for line in lines)
    assert not is_well(findings) and is_well(findings[::2])
    read = json.loads(as_json(findings))
    assert read["ok"] is False
    assert [one["name"] for one in read["findings"]] == ["A", "Long name", "C"]
    assert as_text(findings[:1]).endswith("All is well.")


def test_modules_of_what_is_installed_are_found():
    base, extras = packages.requirements()
    for name in {*base, *(name for names in extras.values() for name in names)}:
        try:
            metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
        assert find_spec(packages.module_of(name)) is not None, name


def test_a_module_of_the_working_folder_is_none_of_pythons(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "json.py").write_text("raise SystemExit(3)")
    assert "error" not in try_out(["numpy"])["numpy"]
