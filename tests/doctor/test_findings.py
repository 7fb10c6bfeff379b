"""What the doctor finds of packages, machines and processes, broken ones too."""

import itertools
import json
import os
import sys
import time
from importlib import metadata
from importlib.util import find_spec
from types import SimpleNamespace

import pytest

from tests.doctor.hanging import hasty_trial, write_module_that_hangs
from tests.waiting import PATIENCE
from tisfm.doctor import machine, packages, trials
from tisfm.doctor.control_groups import GroupLimits, group_limits
from tisfm.doctor.finding import Finding, as_json, as_text, is_well
from tisfm.doctor.trials import Trial, collect_results, run_trial
from tisfm.machine.kernel_cache import LOCK


def test_failed_imports_are_reported(tmp_path, monkeypatch):
    (tmp_path / "breaks.py").write_text("raise OSError('libGL.so.1: no such file')")
    (tmp_path / "crashes.py").write_text("import os; os.kill(os.getpid(), 9)")
    (tmp_path / "prints.py").write_text('print(\'{"name": "json", "error": "no"}\')')
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    tried = run_trial(["json", "breaks", "gone", "prints", "crashes", "csv"])
    assert "error" not in tried["json"] and "error" not in tried["prints"]
    assert tried["breaks"]["error"] == "OSError: libGL.so.1: no such file"
    assert "No module named 'gone'" in tried["gone"]["error"]
    if os.name != "nt":
        assert tried["crashes"]["error"] == "the process crashed (signal 9)"
    assert "error" not in tried["csv"]  # what comes after is tried in another process


def test_a_hanging_library_does_not_block(tmp_path, monkeypatch):
    write_module_that_hangs(tmp_path, "hangs")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(trials, "TOTAL_LIMIT", PATIENCE)
    tried = collect_results(hasty_trial(tmp_path)(["json", "hangs", "csv"]))
    assert tried["hangs"]["error"].startswith("it did not end within")
    assert "error" not in tried["json"] and "error" not in tried["csv"]
    clock = SimpleNamespace(monotonic=itertools.count(0.0, 10.0).__next__)
    monkeypatch.setattr(trials, "time", clock)  # each look counts 10 s, and takes no time
    for limit, in_all in ((35.0, 10 * PATIENCE), (10 * PATIENCE, 35.0)):
        monkeypatch.setattr(trials, "TOTAL_LIMIT", in_all)
        assert "did not end within" in run_trial(["hangs"], limit=limit)["hangs"]["error"]
    tried = run_trial(["hangs", "csv"])
    assert tried["csv"]["error"].startswith(("it was not tried: others took", "it did not end"))


def test_several_are_tried_at_the_same_time(tmp_path, monkeypatch):
    """Each waits for the other one."""
    for name, other in (("one", "two"), ("two", "one")):
        code = f"open({str(tmp_path / name)!r}, 'w').close()\n"
        code += f"while not os.path.exists({str(tmp_path / other)!r}): time.sleep(0.01)"
        (tmp_path / f"{name}.py").write_text(f"import os, time\n{code}")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(trials, "TOTAL_LIMIT", PATIENCE)
    tried = collect_results(
        Trial(["one"], limit=PATIENCE), Trial(["two"], limit=PATIENCE), Trial([])
    )
    assert set(tried) == {"one", "two"} and not any("error" in about for about in tried.values())


def test_no_process_can_be_started(monkeypatch):
    def refuse(*arguments, **options):
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(trials.subprocess, "Popen", refuse)
    found = run_trial(["json", "csv"])
    assert {about["error"] for about in found.values()} == {
        "no process can be started (Cannot allocate memory)"
    }


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
    found = packages.examine_opencv()
    assert found.verdict == "wrong"
    assert "pip uninstall opencv-python opencv-python-headless;" in found.advice
    installed(monkeypatch, opencv_contrib_python="5.0")
    assert packages.examine_opencv().verdict == "warning"
    installed(monkeypatch, opencv_python_headless="5.0")
    assert packages.examine_opencv().verdict == "ok"


def test_versions_and_missing_packages(monkeypatch):
    installed(monkeypatch, numpy="1.26.4", scipy="1.12", pillow="11.0", av="16.0")
    base = {"numpy": ">=2", "scipy": ">=1.11", "pillow": ">=10.1", "rich": ">=13.7"}
    broken = {"scipy": {"error": "ImportError: broken"}, "rich": {"error": "x"}}
    tried = {"numpy": {}, "PIL": {}, **broken}
    found = {one.name: one for one in packages.examine_base(base, tried)}
    assert {name: one.verdict for name, one in found.items()} == {
        "numpy": "wrong", "scipy": "wrong", "pillow": "ok", "rich": "wrong",
    }  # fmt: skip
    assert "requires >=2" in found["numpy"].text
    assert "ImportError: broken" in found["scipy"].text
    assert found["rich"].advice == "pip install 'rich>=13.7'"
    extras = {"video": {"av": ">=17"}, "mesh": {"scikit-image": ">=0.25"}}
    missing = {"av": {}, "skimage": {"error": "no module"}}
    found = {one.name: one for one in packages.examine_extras(extras, missing)}
    assert found["av [video]"].verdict == "warning"
    assert found["scikit-image [mesh]"].verdict == "absent"
    assert "pip install 'tisfm[mesh]'" in found["scikit-image [mesh]"].advice


def test_requirements_are_read_from_the_metadata():
    base, extras, unread = packages.requirements()
    assert unread == ""
    if not base:
        pytest.skip("tisfm is not installed here")
    assert base["numpy"] == ">=2" and base["taichi"].startswith("==")
    assert set(extras) >= {"video", "mesh", "cluster"} and not set(extras) & {"test", "docs", "dev"}
    assert "av" in extras["video"]


def test_unreadable_files_are_reported(monkeypatch):
    installed(monkeypatch, tisfm="0.1.0")
    monkeypatch.setitem(sys.modules, "packaging.requirements", None)
    base, extras, unread = packages.requirements()
    assert base == extras == {} and "packaging" in unread
    found = list(packages.examine_tisfm({}, unread))
    assert [one.verdict for one in found] == ["ok", "wrong"]
    assert "pip install --force-reinstall packaging" in found[1].advice


def test_used_packages_are_declared():
    base, _, _ = packages.requirements()
    if not base:
        pytest.skip("tisfm is not installed here")
    assert "packaging" in base


def test_a_tisfm_that_cannot_be_imported():
    found, *_ = packages.examine_tisfm({"tisfm": {"error": "ImportError: broken"}})
    if found.text.startswith("not installed"):
        pytest.skip("tisfm is not installed here")
    assert found.verdict == "wrong" and "ImportError: broken" in found.text


def test_a_cache_that_cannot_be_used_and_a_lock_that_was_left(tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(cache))
    if os.name == "nt":
        pytest.skip("Taichi's folder is not known on Windows")
    (found,) = machine.examine_cache()
    assert found.verdict == "ok" and str(cache) in found.text
    lock = cache / LOCK
    lock.touch()
    assert len(list(machine.examine_cache())) == 1  # it may be held
    os.utime(lock, (time.time() - 600,) * 2)
    assert [one.verdict for one in machine.examine_cache()] == ["ok", "warning"]
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(tmp_path / "file"))
    (found,) = machine.examine_cache()
    assert found.verdict == "warning" and "compiled anew" in found.text


def process_in(folder, groups, mounts):
    """Return a folder as that of a process in ``/proc``, with these groups and mounts."""
    process = folder / "proc"
    process.mkdir(exist_ok=True)
    (process / "cgroup").write_text("".join(f"{line}\n" for line in groups))
    lines = ["1 0 0:1 / / rw - ext4 /dev/sda rw", "nonsense", *mounts]
    (process / "mountinfo").write_text("".join(f"{line}\n" for line in lines))
    return process


def written(folder, **files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(f"{text}\n")


def test_groups_of_version_2_and_those_around_them(tmp_path):
    mount = tmp_path / "with space"
    escaped = str(mount).replace(" ", "\\040")
    process = process_in(
        tmp_path, ["0::/user/app/inner"], [f"31 23 0:28 / {escaped} rw shared:4 - cgroup2 none rw"]
    )
    assert group_limits(process) == GroupLimits(cores=None, memory=None)
    written(mount / "user/app/inner", cpu__max="max 100000", memory__max="max")
    assert group_limits(process) == GroupLimits(cores=None, memory=None)
    written(mount / "user/app", cpu__max="250000 100000", memory__max="3000000000")
    written(mount / "user", cpu__max="400000 100000", memory__max="2000000000")
    written(mount / "elsewhere", cpu__max="1000 100000", memory__max="1000")
    assert group_limits(process) == GroupLimits(cores=2.5, memory=2e9)


def test_groups_of_version_1_have_a_tree_for_each_controller(tmp_path):
    mounts = [
        f"33 31 0:30 / {tmp_path}/cpu rw - cgroup cgroup rw,cpu,cpuacct",
        f"36 31 0:32 / {tmp_path}/memory rw - cgroup cgroup rw,memory",
        f"41 31 0:38 / {tmp_path}/unified rw - cgroup2 cgroup2 rw",
    ]
    groups = ["9:name=systemd:/", "4:memory:/jobs/7", "2:cpu,cpuacct:/slice", "0::/"]
    process = process_in(tmp_path, groups, mounts)
    written(tmp_path / "cpu/slice", cpu__cfs_quota_us=-1, cpu__cfs_period_us=100000)
    written(tmp_path / "memory", memory__limit_in_bytes=9223372036854771712)
    written(tmp_path / "memory/jobs", memory__limit_in_bytes=5000000000)
    written(tmp_path / "memory/jobs/7", memory__limit_in_bytes=9223372036854771712)
    assert group_limits(process) == GroupLimits(cores=None, memory=5e9)
    written(tmp_path / "cpu/slice", cpu__cfs_quota_us=150000)
    assert group_limits(process).cores == 1.5


def test_groups_of_a_container_begin_at_the_mount(tmp_path):
    """Without a namespace, a process has the name of its group as the host knows it."""
    mounts = [f"36 31 0:32 /docker/ab /{tmp_path} rw - cgroup cgroup rw,memory"]
    written(tmp_path, memory__limit_in_bytes=4000000000)
    written(tmp_path / "inner", memory__limit_in_bytes=3000000000)
    for group, expected in (
        ("/docker/ab", 4e9),
        ("/docker/ab/inner", 3e9),
        ("/docker/other", 4e9),
        ("/../outside", 4e9),
    ):
        process = process_in(tmp_path, [f"4:memory:{group}"], mounts)
        assert group_limits(process).memory == expected, group


def test_a_machine_without_groups(tmp_path):
    assert group_limits(tmp_path) == GroupLimits(cores=None, memory=None)
    assert group_limits(process_in(tmp_path, ["", "x", "0::"], ["", "1 2 3 - cgroup"])) is not None


def test_limits_of_control_groups(monkeypatch):
    def limited(cores=None, memory=None):
        found = GroupLimits(cores=cores, memory=memory)
        monkeypatch.setattr(machine, "group_limits", lambda: found)

    limited()
    monkeypatch.setattr(machine.os, "cpu_count", lambda: 8)
    usable = [6]
    monkeypatch.setattr(
        machine.os, "sched_getaffinity", lambda process: set(range(usable[0])), raising=False
    )
    assert machine.examine_cores().text == "8 cores, bound to 6 of them"
    limited(cores=2.5, memory=1e8)
    found = machine.examine_cores()
    assert "time of 2.5" in found.text and "--threads 2" in found.advice
    if machine._memory()[0] is not None:
        found = machine.examine_memory()
        assert found.verdict == "warning" and "allows 0.1 GB" in found.text
    usable[0] = 8
    limited()
    assert machine.examine_cores().verdict == "ok"


def test_kernels_and_gpus():
    broken = {"kernel:default": {"error": "ImportError: no taichi"}, "archs": {"error": "x"}}
    (found,) = machine.examine_kernel(broken)
    assert found.verdict == "wrong" and "no taichi" in found.text
    assert machine.examine_gpus(broken, {}).verdict == "absent"
    archs = {"archs": {"archs": ["cuda", "vulkan"]}}
    half = {"kernel:cuda": {"error": "no device"}, "kernel:vulkan": {"arch": "vulkan"}}
    assert "vulkan: --arch vulkan" in machine.examine_gpus(archs, half).text
    none = {"kernel:cuda": {"error": "no device"}, "kernel:vulkan": {"error": "none"}}
    found = machine.examine_gpus(archs, none)
    assert found.verdict == "absent" and "no device" in found.text


def test_software_vulkan_is_not_a_gpu():
    tried = {"archs": {"archs": ["vulkan"]}, "software_vulkan": {"device": "llvmpipe (LLVM 15)"}}
    found = machine.examine_gpus(tried, {})
    assert found.verdict == "absent" and "none that Taichi can use" in found.text
    assert "llvmpipe (LLVM 15), software on the CPU, not a GPU" in found.text
    assert "leave out --arch vulkan" in found.advice
    beside = {"archs": {"archs": ["cuda", "vulkan"]}, "software_vulkan": {"device": "llvmpipe"}}
    found = machine.examine_gpus(beside, {"kernel:cuda": {"arch": "cuda"}})
    assert found.verdict == "ok" and found.text.startswith("kernels run on cuda: --arch cuda")
    assert "llvmpipe, software" in found.text
    found = machine.examine_gpus(beside, {"kernel:cuda": {"error": "no device"}})
    assert found.verdict == "absent" and "no device" in found.text and "llvmpipe" in found.text
    real = {"archs": {"archs": ["vulkan"]}, "software_vulkan": {"device": ""}}
    assert machine.examine_gpus(real, {"kernel:vulkan": {"arch": "vulkan"}}).verdict == "ok"


def test_text_and_json():
    findings = [
        Finding("A", "ok", "1.0"),
        Finding("Long name", "wrong", "word " * 40, advice="do this"),
        Finding("C", "warning", "", advice="do that"),
    ]
    lines = as_text(findings).splitlines()
    assert lines[0] == "ok       A          1.0" and max(map(len, lines)) <= 100
    assert lines[-1] == "1 is wrong. 1 warning." and any("→ do this" in line for line in lines)
    assert not is_well(findings) and is_well(findings[::2])
    read = json.loads(as_json(findings))
    assert read["ok"] is False
    assert [one["name"] for one in read["findings"]] == ["A", "Long name", "C"]
    assert as_text(findings[:1]).endswith("All is well.")


def test_modules_of_installed_packages_are_found():
    base, extras, _ = packages.requirements()
    for name in {*base, *(name for names in extras.values() for name in names)}:
        try:
            metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
        assert find_spec(packages.module_of(name)) is not None, name


def test_a_module_of_the_working_folder_is_none_of_pythons(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "json.py").write_text("raise SystemExit(3)")
    assert "error" not in run_trial(["numpy"])["numpy"]
