"""`tisfm doctor`, on installations that work and on broken ones."""

import json
import os
import shlex
import subprocess
import sys

import pytest

from tests.cli.command_line import TISFM
from tests.doctor.hanging import hasty_trial, write_module_that_hangs
from tests.draws import nightly_except
from tests.waiting import PATIENCE
from tisfm.doctor import examination, trials

# As the installed script does it.
SCRIPT = "import sys; sys.argv[0] = 'tisfm'; from tisfm.cli import main; sys.exit(main())"


def doctor(*options, **environment):
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, "doctor", *options],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONIOENCODING": "utf-8", **environment},
    )


def test_an_installation_that_works():
    done = doctor("--json", TI_ARCH="cpu")
    about = json.loads(done.stdout)
    found = {one["name"]: one for one in about["findings"]}
    for name in ("Python", "Kernels", "Vectors", "Threads", "Cores", "Memory", "Kernel cache",
                 "Address space", "Working folder", "Temporary files", "GPU"):  # fmt: skip
        assert name in found, name
        assert found[name]["verdict"] != "wrong", found[name]
    assert "compiled and run on cpu" in found["Kernels"]["text"]
    assert done.returncode == (0 if about["ok"] else 1)
    assert "doctor" not in found, found["doctor"]  # a look that failed


@pytest.mark.parametrize("module", nightly_except("cv2", of=("cv2", "tyro", "numpy", "taichi")))
def test_a_library_that_cannot_be_imported(tmp_path, module):
    """Not even `import tisfm` works then."""
    (tmp_path / f"{module}.py").write_text("raise ImportError('libGL.so.1 is not there')")
    done = doctor(PYTHONPATH=str(tmp_path))
    assert done.returncode == 1 and done.stderr == ""
    assert "WRONG" in done.stdout and "libGL.so.1 is not there" in done.stdout
    name = "opencv-python-headless" if module == "cv2" else module
    assert f"pip install --force-reinstall '{name}" in done.stdout


@pytest.mark.nightly
def test_the_module_answers_as_the_command_does(tmp_path):
    """Also if `import tisfm` fails."""
    (tmp_path / "cv2.py").write_text("raise ImportError('libGL.so.1 is not there')")
    done = subprocess.run(
        [sys.executable, "-m", "tisfm", "doctor"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONIOENCODING": "utf-8"},
    )
    assert done.returncode == 1 and done.stderr == ""
    assert "libGL.so.1 is not there" in done.stdout


@pytest.mark.nightly
def test_a_crashing_library_leaves_the_others_examined(tmp_path):
    (tmp_path / "cv2.py").write_text("import os; os.abort()")
    done = doctor("--json", PYTHONPATH=str(tmp_path))
    assert done.returncode == 1 and done.stderr == ""
    found = {one["name"]: one for one in json.loads(done.stdout)["findings"]}
    assert found["opencv-python-headless"]["verdict"] == found["tisfm"]["verdict"] == "wrong"
    if os.name != "nt":
        assert "crashed (signal 6)" in found["opencv-python-headless"]["text"]
    for name in ("numpy", "scipy", "matplotlib", "tyro"):
        assert found[name]["verdict"] == "ok", found[name]


@pytest.mark.nightly
def test_a_library_that_hangs_is_not_waited_for(tmp_path, monkeypatch):
    write_module_that_hangs(tmp_path, "cv2")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(trials, "TOTAL_LIMIT", PATIENCE)
    hasty = hasty_trial(tmp_path)
    monkeypatch.setattr(examination, "Trial", hasty)
    monkeypatch.setattr(
        examination, "run_trial", lambda names, limit: trials.collect_results(hasty(names))
    )
    found = {one.name: one for one in examination.examine()}
    assert "did not end within" in found["opencv-python-headless"].text
    assert found["tisfm"].verdict == "wrong" and found["numpy"].verdict == "ok"


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="other systems hold no one to ulimit -v")
@pytest.mark.parametrize("kilobytes", [120_000, 700_000])
def test_an_address_space_that_is_too_small(kilobytes):
    call = shlex.join([sys.executable, "-c", SCRIPT, "doctor", "--json"])
    done = subprocess.run(
        ["sh", "-c", f"ulimit -v {kilobytes}; {call}"], capture_output=True, text=True
    )
    assert done.returncode == 1 and "Traceback" not in done.stderr
    found = {one["name"]: one for one in json.loads(done.stdout)["findings"]}
    assert found["Address space"]["verdict"] == "warning"
    assert "ulimit -v" in found["Kernels"]["advice"]
    assert "force-reinstall" not in done.stdout


@pytest.mark.nightly
def test_a_closed_pipe_prints_no_error():
    call = shlex.join([sys.executable, "-c", SCRIPT, "doctor"])
    done = subprocess.run(["sh", "-c", f"{call} | true"], capture_output=True, text=True)
    assert done.stderr == ""


def test_wrong_options_of_the_doctor_are_one_line(tisfm_run):
    code, _, err = tisfm_run("doctor", "--jsn")
    assert code == 2 and "did you mean --json?" in err


@pytest.mark.nightly
def test_an_arch_that_is_not_there():
    done = doctor(TI_ARCH="nonsense")
    assert done.returncode == 1 and "unset it" in done.stdout


def test_other_commands_keep_their_traceback(tmp_path):
    """Where a library is broken, only the doctor answers instead."""
    (tmp_path / "cv2.py").write_text("raise ImportError('libGL.so.1 is not there')")
    done = subprocess.run(
        [*TISFM, "run", "x", "-o", "y"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 1 and "libGL.so.1 is not there" in done.stderr


def test_a_failed_check_is_a_line(monkeypatch):
    def fail():
        raise RuntimeError("unforeseen")

    monkeypatch.setattr(examination.packages, "requirements", lambda: ({}, {}, ""))
    monkeypatch.setattr(examination.machine, "examine_cores", fail)
    monkeypatch.setattr(examination, "Trial", NoTrial)
    found = examination.examine()
    assert [one.text for one in found if one.name == "doctor"] == ["RuntimeError: unforeseen"]
    assert any(one.name == "Working folder" for one in found)


class NoTrial:
    """A trial of things of which each fails at once."""

    def __init__(self, names, *, limit=0):
        self._names = names

    def poll(self):
        return {name: {"error": "not tried"} for name in self._names}
