"""The command line in a process of its own: streams, signals, versions."""

import os
import re
import subprocess
import sys

import pytest

import tisfm
from tests.cli.command_line import TISFM, files, promised
from tests.waiting import PATIENCE
from tisfm.cli.command_line import main


def test_redirected_output_has_no_banner(frames):
    """Redirected output has no banner and no progress bar; the module is the command."""
    command = ["tisfm", "run", "frames", "-o", "out", "--no-figures", "--preset", "fast"]
    done = subprocess.run(
        [sys.executable, "-m", *command],
        capture_output=True, text=True, env={**os.environ, "PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "")
    assert re.fullmatch(r"3 pairs: [^\n]*\n", done.stderr)
    assert set(files("out")) == promised("f0", "f1", "f2", figures=False)


@pytest.mark.nightly
def test_the_module_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "tisfm", "run"], capture_output=True, text=True, check=False
    )
    command = subprocess.run([*TISFM, "run"], capture_output=True, text=True, check=False)
    assert done.returncode == command.returncode != 0
    assert done.stderr == command.stderr != "" and done.stderr.startswith("tisfm: ")


def test_streams_without_greek_letters():
    done = subprocess.run(
        [*TISFM, "run", "--help"],
        capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert done.returncode == 0 and b"--smoothness" in done.stdout and done.stderr == b""


@pytest.mark.skipif(os.name == "nt", reason="a pipe that breaks is another matter on Windows")
def test_a_reader_that_leaves_early():
    process = subprocess.Popen(
        [*TISFM, "run", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait(timeout=PATIENCE) == 141
    process.stderr.close()


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == tisfm.__version__
