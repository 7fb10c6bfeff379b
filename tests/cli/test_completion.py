"""What shells complete by, in a shell."""

import os
import re
import select
import shutil
import subprocess
import time

import pytest

from tests.cli.command_line import assert_one_line
from tests.waiting import PATIENCE
from tisfm.cli.command_line import _parse
from tisfm.cli.completion import completion_script
from tisfm.cli.known_options import LISTS, known_options
from tisfm.exports.formats import FORMATS
from tisfm.running.run_record import ENDINGS

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
def complete(tisfm_run, place):
    """Return what bash completes words to."""
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")
    code, out, err = tisfm_run("--completion", "bash")
    assert code == 0 and err == ""
    (place / "script").write_text(out)

    def asked(words):
        done = subprocess.run(["bash", "-c", ASK, "ask", words], capture_output=True, text=True)
        assert done.returncode == 0 and done.stderr == ""
        return done.stdout.split()

    return asked


def test_bash_completes_commands_options_and_values(complete):
    assert complete("tisfm rec") == ["reconstruct"]
    assert {"run", "eval", "doctor", "--version"} <= set(complete("tisfm "))
    assert complete("tisfm run --pre") == ["--preset", "--presmoothing"]
    assert complete("tisfm run x -o y --no-fig") == ["--no-figures"]
    assert complete("tisfm run --preset f") == ["fast"]
    assert complete("tisfm reconstruct --motion ") == ["camera", "objects"]
    assert complete("tisfm run --motion ") == ["field", "camera", "objects"]
    assert complete("tisfm eval --seq") == ["--sequence"]
    assert complete("tisfm --completion z") == ["zsh"]
    assert complete("tisfm export x --to mesh-") == ["mesh-ply", "mesh-glb"]
    assert complete("tisfm export x --to ply,depth-t") == ["ply,depth-tum", "ply,depth-tiff"]
    assert complete("tisfm run x --outputs depth,np") == ["depth,npz"]
    assert complete("tisfm run --preset x,f") == []  # which takes one word
    assert complete("tisfm demo --pre") == []  # an option of other commands
    assert complete("tisfm run fra") == []  # left to the names of files


def test_lists_of_words_are_whole():
    assert LISTS["export"]["--to"] == tuple(FORMATS)
    assert LISTS["run"]["--outputs"] == tuple(ENDINGS)
    known = known_options(_parse)
    assert all(name in known.options[command] for command, one in LISTS.items() for name in one)


def test_zsh_takes_the_script_of_bash(tisfm_run):
    _, bash, _ = tisfm_run("--completion", "bash")
    code, zsh, _ = tisfm_run("--completion", "zsh")
    assert code == 0 and zsh.endswith(bash) and "bashcompinit" in zsh


@pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh")
def test_zsh_reads_it(tisfm_run, place):
    (place / "script").write_text(tisfm_run("--completion", "zsh")[1])
    done = subprocess.run(
        ["zsh", "-f", "-c", "source ./script; whence -w _tisfm"], capture_output=True, text=True
    )
    assert "function" in done.stdout and "error" not in done.stderr.lower()


def test_tcsh_has_a_line_of_its_own(tisfm_run, place):
    code, out, _ = tisfm_run("--completion", "tcsh")
    assert code == 0 and out.startswith("complete tisfm ") and out.count("\n") == 1
    assert "'n/--preset/(paper fast balanced accurate)/'" in out and "'p/1/(run " in out
    if shutil.which("tcsh") is not None:
        (place / "script").write_text(out)
        done = subprocess.run(["tcsh", "-f", "script"], capture_output=True, text=True)
        assert done.returncode == 0 and done.stderr == ""


@pytest.fixture(scope="module")
def fish_script(tmp_path_factory):
    """A file with what fish reads."""
    path = tmp_path_factory.mktemp("fish") / "tisfm.fish"
    path.write_text(completion_script("fish", known_options(_parse)))
    return path


def test_fish_has_a_line_for_every_option(fish_script):
    lines = fish_script.read_text().splitlines()
    of_run = "complete -c tisfm -n '__fish_seen_subcommand_from run'"
    assert f"{of_run} -l preset -x -a 'paper fast balanced accurate'" in lines
    assert f"{of_run} -l threads -x" in lines  # a number, and no file
    assert f"{of_run} -s o -r" in lines and f"{of_run} -l no-figures" in lines
    assert all(line.startswith("complete -c tisfm -n ") for line in lines)


@pytest.mark.skipif(shutil.which("fish") is None, reason="there is no fish")
@pytest.mark.parametrize(
    "words, expected",
    [
        ("tisfm rec", ["reconstruct"]),
        ("tisfm --comp", ["--completion"]),
        ("tisfm --completion z", ["zsh"]),
        ("tisfm run --pre", ["--preset", "--presmoothing"]),
        ("tisfm run --preset f", ["fast"]),
        ("tisfm run x -o y --no-fig", ["--no-figures"]),
        ("tisfm reconstruct --motion ", ["camera", "objects"]),
        ("tisfm export x --to mesh-", ["mesh-glb", "mesh-ply"]),
        ("tisfm run x --outputs depth,np", ["depth,npz"]),
        ("tisfm demo --pre", []),
    ],
)
def test_fish_completes_commands_options_and_values(fish_script, place, words, expected):
    done = subprocess.run(
        ["fish", "--no-config", "-c", f"source '{fish_script}'; complete -C '{words}'"],
        capture_output=True,
        text=True,
        env={**os.environ, "HOME": str(place)},
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
def test_zsh_completes_as_somebody_types(tisfm_run, place, words, expected):
    pty = pytest.importorskip("pty")
    (place / "script").write_text(tisfm_run("--completion", "zsh")[1])
    keyboard, terminal = pty.openpty()
    shell = subprocess.Popen(
        ["zsh", "-f", "-i"],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
        env={**os.environ, "HOME": str(place), "TERM": "dumb", "PS1": "", "PROMPT": ""},
    )
    os.close(terminal)
    try:
        os.write(keyboard, b"unsetopt zle_bracketed_paste; source ./script; print rea''dy\n")
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
