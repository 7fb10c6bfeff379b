"""Mistakes in commands, options and values: one line, with what was meant."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.cli.command_line import assert_one_line
from tisfm.cli import foretelling, reconstruct_command
from tisfm.cli.command_line import _parse
from tisfm.cli.foretelling import Foretelling, as_duration, as_size
from tisfm.cli.frame_options import FrameOptions
from tisfm.cli.known_options import known_options
from tisfm.cli.nearest import hint, nearest

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
    "run frames -o out --threads two": ("--threads", "two"),
    "run frames": ("needs -o DIR",),
    "run frames -o": ("-o",),
    "eval flows --layout midlebury": ("did you mean middlebury?",),
    "demo more": ("more", "tisfm demo --help"),
    "reconstruct frames -o out --mesh stl": ("'stl'", "ply, glb"),
    "batch": ("needs LIST",),
}


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize("line", WRONG)
def test_a_mistake_is_one_line(tisfm_run, monkeypatch, capsys, line, encoding):
    """The parser draws frames of other characters where a terminal has no others."""
    import sys

    monkeypatch.setattr(sys.stdout, "reconfigure", lambda **options: None, raising=False)
    monkeypatch.setenv("PYTHONIOENCODING", encoding)
    code, out, err = tisfm_run(*line.split())
    assert out == "" and code == 2
    assert_one_line(code, err, *WRONG[line])


def test_outputs_are_told_the_nearest(tisfm_run, frames):
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--outputs", "depht,npz")
    assert_one_line(code, err, "depht", "did you mean 'depth'?")


def test_a_list_of_videos_is_told_the_nearest(tisfm_run, place):
    (place / "list.csv").write_text("source,output,prest\na.mp4,a,fast\n")
    code, _, err = tisfm_run("batch", "list.csv")
    assert_one_line(code, err, "list.csv, line 2", "did you mean --preset?")


def test_help_is_left_alone(tisfm_run):
    code, out, err = tisfm_run("run", "--help")
    assert code == 0 and "--preset" in out and err == ""


def test_options_are_read_from_the_help():
    known = known_options(_parse)
    assert known.commands[:2] == ("run", "reconstruct") and "doctor" in known.commands
    assert known.options["run"]["--preset"] == ("paper", "fast", "balanced", "accurate")
    assert known.options["run"]["--threads"] == () and known.options["run"]["-o"] == ()
    assert {"--no-report", "--report", "--no-figures"} <= set(known.options["run"])
    assert known.options["reconstruct"]["--mesh"] == ("ply", "glb")
    assert known.options["demo"].keys() >= {"--output", "--height", "--help"}


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.text(max_size=12), st.lists(st.text(max_size=12), max_size=5))
def test_what_is_nearest_is_known(word, known):
    found = nearest(word, known)
    assert found is None or found in known
    assert hint(word, known) == ("" if found is None else f", did you mean {found!r}?")


def test_how_long_it_takes_is_foretold_once(monkeypatch):
    now, told = [100.0], []
    monkeypatch.setattr(foretelling.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(foretelling, "tell", told.append)
    foretold = Foretelling("pairs")
    for count in range(1, 40):
        foretold.done(count, 1000)
        now[0] += 1.0 if count > 1 else 30.0  # kernels are compiled first
    assert told == ["1000 pairs: about 17 min to go, 1 a second"]
    short = Foretelling("pairs")
    for count in range(1, 40):
        short.done(count, 50)
        short.done(count, None)
        now[0] += 1
    assert len(told) == 1


def test_what_a_sequence_takes_is_told_before(frames, capsys, monkeypatch):
    def announced(start=0):
        frames_taken = FrameOptions(start=start)
        reconstruct_command._announce(str(frames), Path("out"), frames_taken, "all")
        return capsys.readouterr().err

    assert announced() == ""
    monkeypatch.setattr(reconstruct_command, "MUCH", 100)  # bytes, fewer than they take
    assert announced() == "about 0 MB for 4 frames in out\n"
    assert "for 2 frames" in announced(start=2)
    usage = SimpleNamespace(free=1e3)
    monkeypatch.setattr(reconstruct_command.shutil, "disk_usage", lambda folder: usage)
    assert announced() == "about 0 MB for 4 frames, but 0 MB are free\n"


@pytest.mark.parametrize("shape", [(1000, 1200), (1000, 1200, 3)])
def test_frames_of_one_channel_count_all_their_pixels(tmp_path, capsys, monkeypatch, shape):
    """And a frame that is damaged, or before the first that is taken, is told where it is read."""
    (tmp_path / "large").mkdir()
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"large/f{k}.png"), np.zeros(shape, np.uint8))
    monkeypatch.setattr(reconstruct_command, "MUCH", 1e6)
    about = (str(tmp_path / "large"), tmp_path / "out", FrameOptions(), "all")
    reconstruct_command._announce(*about)
    said = capsys.readouterr().err
    assert float(said.split()[1]) > reconstruct_command._DEPTH * 3 * 1.2  # MB
    (tmp_path / "large/f0.png").write_bytes(b"none")
    reconstruct_command._announce(*about)
    assert capsys.readouterr().err == ""
    reconstruct_command._announce(*about[:2], FrameOptions(start=1), "all")
    assert "for 2 frames" in capsys.readouterr().err


def test_durations_and_sizes():
    assert [as_duration(s) for s in (61, 600, 7200, 7500)] == [
        "1 min",
        "10 min",
        "2 h",
        "2 h 5 min",
    ]
    assert [as_size(s) for s in (2.5e6, 3.21e9)] == ["2 MB", "3.2 GB"]
