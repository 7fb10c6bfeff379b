"""`tisfm doctor`, on installations that work and on broken ones."""

import json
import os
import subprocess
import sys

import pytest

from tests.cli.command_line import TISFM
from tisfm.doctor import examination

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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("module", ["cv2", "tyro", "numpy"])
def test_a_library_that_cannot_be_imported(tmp_path, module):
    """Not even `import tisfm` works then."""
    (tmp_path / f"{module}.py").write_text("raise ImportError('libGL.so.1 is not there')")
    done = doctor(PYTHONPATH=str(tmp_path))
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "WRONG" in done.stdout and "libGL.so.1 is not there" in done.stdout
    name = "opencv-python-headless" if module == "cv2" else module
    assert f"pip install --force-reinstall '{name}" in done.stdout


@pytest.mark.slow
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


def test_a_look_that_fails_is_a_line(monkeypatch):
    def fail():
        raise RuntimeError("unforeseen")

    monkeypatch.setattr(examination.packages, "requirements", lambda: ({}, {}))
    monkeypatch.setattr(examination.machine, "about_cores", fail)
    monkeypatch.setattr(examination, "Trials", NoTrials)
    found = examination.examine()
    assert [one.text for one in found if one.name == "doctor"] == ["RuntimeError: unforeseen"]
    assert any(one.name == "Working folder" for one in found)


class NoTrials:
    """Trials of which each fails at once."""

    def begin(self, names, *, limit=0):
        return self._Told({name: {"error": "not tried"} for name in names})

    def __enter__(self):
        return self

    def __exit__(self, *about):
        pass

    class _Told(dict):
        def result(self):
            return self
