"""What shells complete by, in a shell."""

import shutil
import subprocess

import pytest

from tests.cli.command_line import assert_one_line

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
    assert complete("tisfm demo --pre") == []  # an option of other commands
    assert complete("tisfm run fra") == []  # left to the names of files


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


@pytest.mark.parametrize("shells", [[], ["fsh"], ["bash", "zsh"]])
def test_other_shells_are_one_line(tisfm_run, shells):
    code, out, err = tisfm_run("--completion", *shells)
    assert out == ""
    assert_one_line(code, err, "--completion", "bash, zsh, tcsh")
