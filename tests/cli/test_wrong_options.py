"""Mistakes in commands, options and values: one line, with what was meant."""

import os
import re
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import get_args, get_origin

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.cli.command_line import TISFM, assert_one_line
from tests.draws import examples, long_draw_too
from tisfm.checks import find_similar_word, spelling_hint
from tisfm.cli import progress, reconstruct
from tisfm.cli.command_line import COMMANDS, _load_command
from tisfm.cli.options import FrameOptions
from tisfm.cli.parsing import option_types
from tisfm.cli.progress import TimeEstimate

WRONG = {
    "rnu frames -o out": ("no command rnu", "did you mean run?"),
    "recon frames -o out": ("did you mean reconstruct?",),
    "xyz": ("no command xyz;", "run, reconstruct"),
    "": ("a command is missing", "demo"),
    "--verison": ("did you mean --version?",),
    "run frames -o out --prest fast": ("tisfm run has no option --prest", "did you mean --preset?"),
    "run frames -o out --preset=fats": ("--preset is 'fats'", "did you mean fast?"),
    "run frames -o out --motion camra": ("did you mean camera?", "field, camera, objects"),
    "run frames -o out --bad_framez skip": ("did you mean --bad-frames?",),
    "run frames -o out --Preset fast": ("did you mean --preset?",),
    "run frames -o out --threads two": ("--threads is 'two'", "expected a whole number"),
    "run frames -o out --threads=": ("--threads is ''", "expected a whole number"),
    "run frames -o out --start 1 --start two": ("--start is 'two'",),
    "run frames -o out --focal gues": ("did you mean guess?", "a number or guess"),
    "run frames -o out --center 1": ("--center is '1'", "expected 2 numbers"),
    "export walk -o out --to tum --scale 0 b 2": ("--scale is '0 b 2'", "expected 3 numbers"),
    "run frames -o out --report yes": ("does not take yes",),
    "figures a -o out": ("takes 2 frames",),
    "run frames": ("needs -o DIR",),
    "run frames -o": ("-o/--output has no value: expected DIR",),
    "eval flows --layout midlebury": ("did you mean middlebury?",),
    "demo more": ("more", "tisfm demo --help"),
    "reconstruct frames -o out --mesh stl": ("'stl'", "ply, glb"),
    "batch": ("needs LIST",),
}


@pytest.mark.parametrize("line", WRONG)
def test_a_wrong_option_is_one_line(tisfm_run, line):
    code, out, err = tisfm_run(*line.split())
    assert out == "" and code == 2
    assert_one_line(code, err, *WRONG[line])


@pytest.mark.parametrize(
    ("encoding", "line"),
    [
        ("ascii", "run frames -o out --motion camra"),
        *(
            pytest.param(encoding, line, marks=pytest.mark.nightly)
            for encoding in ("utf-8", "cp1252")
            for line in ("run frames -o out --threads two", "run frames")
        ),
    ],
)
def test_a_wrong_option_is_the_same_line_in_ascii(work_folder, line, encoding):
    """The parser draws frames of other characters there."""
    done = subprocess.run(
        [*TISFM, *line.split()],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0", "LC_ALL": "C"},
    )
    assert done.returncode == 2 and done.stdout == b""
    assert_one_line(done.returncode, done.stderr.decode("ascii"), *WRONG[line])


def numbers_of(command):
    """Return the options of a command that take numbers, and how many."""
    found = {}
    for name, kind in option_types(_load_command(command)[0]).items():
        kinds = [one for one in get_args(kind) or (kind,) if one is not type(None)]
        parts = [get_args(one) if get_origin(one) is tuple else (one,) for one in kinds]
        if get_origin(kind) is tuple:
            parts = [get_args(kind)]
        counts = [len(one) for one in parts if set(one) <= {int, float}]
        if counts:
            found[name] = counts[0]
    return found


@pytest.mark.parametrize("command", COMMANDS)
@long_draw_too
def test_a_word_in_place_of_a_number_is_one_line(tisfm_run, command):
    """Of every option that takes numbers; of every sixth in the short command."""
    numeric = dict(list(numbers_of(command).items())[:: examples(6, 1)])
    needed = {"figures": ["a", "b", "-o", "y"], "demo": [], "doctor": [], "batch": ["x"]}
    has_output = "-o" in option_types(_load_command(command)[0])
    words = needed.get(command, ["x", "-o", "y"] if has_output else ["x"])
    for name, count in numeric.items():
        code, out, err = tisfm_run(command, *words, name, *["two"] * count)
        assert out == "" and code == 2, name
        assert_one_line(code, err, f"{name} is 'two", "expected ", "number")
        assert not any(word in err for word in ("INT", "FLOAT", "None", "literal", "type"))
    for name in [*numeric][:2]:
        code, out, err = tisfm_run(command, *words, name)
        assert out == "" and code == 2, name
        assert_one_line(code, err, f"{name} has no value: expected ", "number")


def test_options_that_take_numbers_are_found():
    assert sum(len(numbers_of(command)) for command in COMMANDS) > 90
    assert numbers_of("run")["--stiffness"] == 6 and numbers_of("export")["--scale"] == 3


def test_wrong_outputs_have_a_suggestion(tisfm_run, frames):
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--outputs", "depht,npz")
    assert_one_line(code, err, "depht", "did you mean depth?")


def test_a_wrong_column_of_a_list_has_a_suggestion(tisfm_run, work_folder):
    (work_folder / "list.csv").write_text("source,output,prest\na.mp4,a,fast\n")
    code, _, err = tisfm_run("batch", "list.csv")
    assert_one_line(code, err, "list.csv, line 2", "did you mean --preset?")


def test_help_is_not_changed(tisfm_run):
    code, out, err = tisfm_run("run", "--help")
    assert code == 0 and "--preset" in out and err == ""


def test_the_options_of_a_command_are_those_of_its_help(tisfm_run):
    for command in COMMANDS:
        _, out, _ = tisfm_run(command, "--help")
        of_help = set(re.findall(r"(?<=[ │,])--[a-z][a-z-]*", out))
        types = option_types(_load_command(command)[0])
        assert {name for name in types if name.startswith("--")} <= of_help, command


@given(st.text(max_size=12), st.lists(st.text(max_size=12), max_size=5))
def test_wrong_names_have_suggestions(word, known):
    found = find_similar_word(word, known)
    assert found is None or found in known
    assert spelling_hint(word, known) == ("" if found is None else f", did you mean {found!r}?")


def test_the_time_of_a_run_is_estimated_once(monkeypatch):
    now, told = [100.0], []
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "tell", told.append)
    foretold = TimeEstimate("pairs")
    for count in range(1, 40):
        foretold.update(count, 1000)
        now[0] += 1.0 if count > 1 else 30.0  # kernels are compiled first
    assert told == ["1000 pairs: about 17 min to go, 1 a second"]
    for count in range(40):  # the work begins again
        foretold.update(count, 1000)
        now[0] += 0.5
    assert len(told) == 2 and told[1].endswith("2 a second")
    short = TimeEstimate("pairs")
    for count in range(1, 40):
        short.update(count, 50)
        short.update(count, None)
        now[0] += 1
    assert len(told) == 2


def test_the_time_of_a_sequence_is_estimated(frames, capsys, monkeypatch):
    def announced(start=0):
        frames_taken = FrameOptions(start=start)
        reconstruct._announce(str(frames), Path("out"), frames_taken, "all")
        return capsys.readouterr().err

    assert announced() == ""
    monkeypatch.setattr(reconstruct, "LARGE_OUTPUT", 100)  # bytes, fewer than they take
    assert announced() == "about 0 MB for 4 frames in out\n"
    assert "for 2 frames" in announced(start=2)
    usage = SimpleNamespace(free=1e3)
    monkeypatch.setattr(reconstruct.shutil, "disk_usage", lambda folder: usage)
    assert announced() == "about 0 MB for 4 frames, but 0 MB are free\n"


@pytest.mark.parametrize("shape", [(1000, 1200), (1000, 1200, 3)])
def test_frames_of_one_channel_count_all_their_pixels(tmp_path, capsys, monkeypatch, shape):
    """And a frame that is damaged, or before the first that is taken, is told where it is read."""
    (tmp_path / "large").mkdir()
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"large/f{k}.png"), np.zeros(shape, np.uint8))
    monkeypatch.setattr(reconstruct, "LARGE_OUTPUT", 1e6)
    about = (str(tmp_path / "large"), tmp_path / "out", FrameOptions(), "all")
    reconstruct._announce(*about)
    said = capsys.readouterr().err
    assert float(said.split()[1]) > reconstruct._DEPTH_BYTES * 3 * 1.2  # MB
    (tmp_path / "large/f0.png").write_bytes(b"none")
    reconstruct._announce(*about)
    assert capsys.readouterr().err == ""
    reconstruct._announce(*about[:2], FrameOptions(start=1), "all")
    assert "for 2 frames" in capsys.readouterr().err
