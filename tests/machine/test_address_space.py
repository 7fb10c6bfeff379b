"""Limits of the address space: one clear line, no traceback, no signal."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.draws import nightly_except
from tests.waiting import PATIENCE
from tisfm.cli import command_line
from tisfm.formats import write_png
from tisfm.machine import memory
from tisfm.scenes import two_blocks

COMMAND = "import sys\nfrom tisfm.cli import main\nsys.exit(main())\n"
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="other systems hold nobody to it")


def run(folder, kilobytes, *arguments):
    """Run the command under a limit, as a shell does that was told ``ulimit -v``."""
    script = folder / "tisfm"
    script.write_text(COMMAND, encoding="utf-8")
    shell = ["bash", "-c", f'ulimit -v {kilobytes} && exec "$@"', "bash"]
    return subprocess.run(
        [*shell, sys.executable, str(script), *arguments],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONWARNINGS": "ignore::DeprecationWarning",
            "OPENBLAS_NUM_THREADS": "2",  # each thread reserves more; machines have 2 to 200
        },
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


def frames(folder, height, width):
    scene = two_blocks(height, width)
    write_png(folder / "a.png", scene.frame0)
    write_png(folder / "b.png", scene.frame1)
    return "run", "a.png", "b.png", "-o", "out", "--preset", "fast"


@on_linux
@pytest.mark.parametrize(
    "kilobytes",
    nightly_except(200_000, 900_000, of=(200_000, 400_000, 550_000, 700_000, 900_000, 1_500_000)),
)
def test_too_little_is_one_line(tmp_path, kilobytes):
    """OpenCV crashed, SciPy hung or failed to load, and Taichi complained, in this order."""
    done = run(tmp_path, kilobytes, *frames(tmp_path, 24, 32))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith(
        f"tisfm: the limit of the address space (ulimit -v) is {kilobytes * 1024 / 1e9:.3g} GB"
    )
    assert "raise the limit" in line
    assert not (tmp_path / "out" / "run.json").exists()


@on_linux
@pytest.mark.nightly
def test_too_little_for_the_frames_is_one_line(tmp_path):
    """Where it ends depends on the machine; OpenBLAS ends the process in words of its own."""
    options = ("--no-figures", "--threads", "1")
    done = run(tmp_path, 2_400_000, *frames(tmp_path, 1080, 1920), *options)
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    if done.returncode:
        assert len(done.stderr.strip().splitlines()) == 1
        assert "memory" in done.stderr.lower() or "ulimit" in done.stderr


@pytest.fixture
def limited(monkeypatch):
    monkeypatch.setattr(memory, "address_space_limit", lambda: 3_000_000_000)


@on_linux
def test_frames_that_fit_are_not_refused(monkeypatch):
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    bound = pages * os.sysconf("SC_PAGE_SIZE") + 3e9
    monkeypatch.setattr(memory, "address_space_limit", lambda: bound)
    memory.require_address_space(1e6, "a small thing")
    with pytest.raises(MemoryError, match=r"is .* GB and leaves .* GB, but a large thing reserves"):
        memory.require_address_space(4e9, "a large thing")
    monkeypatch.setattr(memory, "address_space_limit", lambda: None)
    memory.require_address_space(4e15, "a large thing")


def map_failed():
    raise ImportError("libany.so: failed to map segment from shared object")


def no_thread():
    try:
        map_failed()
    except ImportError as error:
        raise RuntimeError("it cannot be loaded") from error


def no_array():
    raise MemoryError("Unable to allocate 1 GiB")


@pytest.mark.parametrize("fail", [map_failed, no_thread, no_array])
def test_libraries_that_run_out_are_one_line(limited, monkeypatch, capsys, fail):
    monkeypatch.setattr(command_line, "parse_command", lambda arguments: fail)
    assert command_line.main(["run"]) == 1
    text = "not enough memory: give smaller frames, or raise the limit of 3 GB (ulimit -v)"
    assert capsys.readouterr().err == f"tisfm: {text}\n"


def test_without_a_limit_a_library_that_fails_is_a_bug(monkeypatch):
    monkeypatch.setattr(memory, "address_space_limit", lambda: None)
    monkeypatch.setattr(command_line, "parse_command", lambda arguments: map_failed)
    with pytest.raises(ImportError):
        command_line.main(["run"])
