"""What shells complete by, in a shell."""

import os
import re
import select
import shutil
import subprocess
import sys
import time
from typing import get_args

import pytest

from tests.cli.command_line import assert_one_line
from tests.waiting import PATIENCE
from tisfm.cli.evaluate import LayoutName
from tisfm.cli.export import FormatName
from tisfm.cli.run import Output
from tisfm.datasets import LAYOUTS, SEQUENCE_LAYOUTS
from tisfm.exports.formats import FORMATS
from tisfm.folders.run_record import ENDINGS

# Asks bash as a user does who presses TAB after the words.
ASK = """
source ./script
read -ra COMP_WORDS <<< "$1"
[[ "$1" == *" " ]] && COMP_WORDS+=("")
COMP_CWORD=$(( ${#COMP_WORDS[@]} - 1 ))
COMP_LINE="$1"
COMP_POINT=${#COMP_LINE}
function=$(complete -p tisfm | sed 's/.*-F \\([^ ]*\\) .*/\\1/')
"$function" tisfm
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def complete(tisfm_run, work_folder):
    """Return what bash completes words to."""
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")
    code, out, err = tisfm_run("--completion", "bash")
    assert code == 0 and err == ""
    (work_folder / "script").write_text(out)

    def asked(words):
        done = subprocess.run(["bash", "-c", ASK, "ask", words], capture_output=True, text=True)
        assert done.returncode == 0 and done.stderr == ""
        return done.stdout.split()

    return asked


def test_bash_completes_commands_options_and_values(complete):
    assert complete("tisfm rec") == ["reconstruct"]
    assert complete("tisfm run --pre") == ["--preset", "--presmoothing"]
    assert complete("tisfm run --preset f") == ["fast"]
    assert complete("tisfm export x --to tum,ki") == ["tum,kitti"]
    assert complete("tisfm demo --pre") == []  # an option of other commands


@pytest.mark.nightly
def test_bash_completes_more(complete):
    assert {"run", "eval", "doctor"} <= set(complete("tisfm "))
    assert complete("tisfm run x -o y --no-fig") == ["--no-figures"]
    assert {"camera", "objects"} <= set(complete("tisfm reconstruct --motion "))
    assert complete("tisfm figures a b --fo") == ["--focal"]  # its help has several lines
    assert complete("tisfm eval --seq") == ["--sequence"]
    assert complete("tisfm export x --to mesh-") == ["mesh-glb", "mesh-ply"]
    assert complete("tisfm export x --to ply --to depth-t") == ["depth-tiff", "depth-tum"]
    assert complete("tisfm run x --outputs np") == ["npz"]
    assert complete("tisfm run x --outputs depth,npz,fl") == ["depth,npz,flow"]
    assert complete("tisfm run --focal g") == ["guess"]
    assert "None" not in complete("tisfm reconstruct --calibrate ")
    assert complete("tisfm --v") == ["--version"]
    assert complete("tisfm --completion ") == ["bash", "fish", "tcsh", "zsh"]


def test_the_names_of_formats_outputs_and_layouts_are_whole():
    assert get_args(FormatName) == tuple(FORMATS)
    assert set(get_args(LayoutName)) == {*LAYOUTS, *SEQUENCE_LAYOUTS}
    assert get_args(Output) == tuple(ENDINGS)


def test_tcsh_needs_a_package(tisfm_run, monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    code, out, err = tisfm_run("--completion", "tcsh")
    assert code == 1 and out == ""
    assert_one_line(code, err, "pip install shtab")


@pytest.fixture
def fish_script(tisfm_run, work_folder):
    """A file with the script for fish."""
    path = work_folder / "tisfm.fish"
    path.write_text(tisfm_run("--completion", "fish")[1])
    return path


def test_fish_gets_a_script(fish_script):
    assert "_tyro_tisfm" in fish_script.read_text()


@pytest.mark.skipif(shutil.which("fish") is None, reason="there is no fish")
@pytest.mark.parametrize(
    "words, expected",
    [
        ("tisfm rec", ["reconstruct"]),
        ("tisfm run --pre", ["--preset", "--presmoothing"]),
        ("tisfm run --preset f", ["fast"]),
        ("tisfm run x -o y --no-fig", ["--no-figures"]),
        ("tisfm reconstruct --motion ", ["camera", "objects"]),
        ("tisfm export x --to mesh-", ["mesh-glb", "mesh-ply"]),
        ("tisfm run x --outputs depth,fl", ["depth,flow"]),
        ("tisfm --v", ["--version"]),
        ("tisfm demo --pre", []),
    ],
)
def test_fish_completes_commands_options_and_values(fish_script, work_folder, words, expected):
    done = subprocess.run(
        ["fish", "--no-config", "-c", f"source '{fish_script}'; complete -C '{words}'"],
        capture_output=True,
        text=True,
        env={**os.environ, "HOME": str(work_folder)},
    )
    assert done.returncode == 0 and done.stderr == ""
    assert sorted(line.split("\t")[0] for line in done.stdout.splitlines()) == expected


@pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh")
@pytest.mark.parametrize(
    "words, expected",
    [
        ("tisfm rec", "tisfm reconstruct"),
        ("tisfm run --preset f", "tisfm run --preset fast"),
        ("tisfm run x -o y --no-fig", "tisfm run x -o y --no-figures"),
    ],
)
def test_zsh_completes_as_somebody_types(tisfm_run, work_folder, words, expected):
    pty = pytest.importorskip("pty")
    (work_folder / "functions").mkdir()
    (work_folder / "functions/_tisfm").write_text(tisfm_run("--completion", "zsh")[1])
    keyboard, terminal = pty.openpty()
    shell = subprocess.Popen(
        ["zsh", "-f", "-i"],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
        env={**os.environ, "HOME": str(work_folder), "TERM": "dumb", "PS1": "", "PROMPT": ""},
    )
    os.close(terminal)
    try:
        os.write(
            keyboard,
            b"unsetopt zle_bracketed_paste; fpath+=$PWD/functions; "
            b"autoload -U compinit; compinit -u; print rea''dy\n",
        )
        assert "ready" in _read_until(keyboard, "ready")
        os.write(keyboard, f"{words}\t".encode())
        assert expected in _read_until(keyboard, expected)
    finally:
        shell.kill()
        shell.wait()
        os.close(keyboard)


def _read_until(terminal, text):
    """Return what comes from a terminal, without codes, up to where a text is in it."""
    said, end = "", time.monotonic() + PATIENCE
    while text not in said and time.monotonic() < end:
        if select.select([terminal], [], [], 0.2)[0]:
            said += os.read(terminal, 4096).decode("utf-8", "replace")
            said = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r|.\x08", "", said)
    return said


@pytest.mark.parametrize("shells", [[], ["fsih"], ["bash", "zsh"]])
def test_other_shells_are_one_line(tisfm_run, shells):
    code, out, err = tisfm_run("--completion", *shells)
    assert out == ""
    assert_one_line(code, err, "--completion", "bash, zsh, fish, tcsh")
