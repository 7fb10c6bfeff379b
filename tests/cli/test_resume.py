"""`tisfm run` again: going on after Ctrl-C, with nothing lost and nothing mixed."""

import json
import os
import signal
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

import tisfm
from tests.cli.command_line import (
    ENDINGS,
    FRAMES,
    TISFM,
    assert_one_line,
    files,
    forbid,
    load,
    record,
)
from tests.draws import nightly_except
from tests.waiting import PATIENCE, started, wait_for
from tisfm import interpretation_file, pair, runtime
from tisfm.cli.command_line import main
from tisfm.formats import FormatError, write_png
from tisfm.results.opening import open_result
from tisfm.running import pairs

PLAIN = ("run", "frames", "-o", "out", "--preset", "fast", "--no-figures")


def test_resume_skips_finished_pairs(tisfm_run, frames, monkeypatch):
    assert tisfm_run("run", "frames", "-o", "out", "--figures", "2")[0] == 0
    before = files("out")
    monkeypatch.setattr(pair, "interpret", forbid)
    monkeypatch.setattr(pairs, "horn_schunck", forbid)
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--figures", "2", "--resume")
    assert code == 0 and err.startswith("3 pairs: ") and "median" not in err
    assert files("out") == before


def test_resume_restores_removed_files(tisfm_run, frames):
    run = ("run", "frames", "-o", "out", "--no-figures")
    assert tisfm_run(*run)[0] == 0
    before = files("out")
    for name in ENDINGS - {"_figure.png"}:
        Path(f"out/f1{name}").unlink()
    assert tisfm_run(*run, "--resume")[0] == 0
    assert files("out") == before


def test_resume_without_a_run_before(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures", "--resume")[0] == 0
    assert tisfm_run("run", "frames", "-o", "fresh", "--no-figures")[0] == 0
    assert files("out") == files("fresh")


def test_without_resume_all_pairs_are_interpreted_again(tisfm_run, frames, monkeypatch):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    monkeypatch.setattr(pair, "interpret", forbid)
    with pytest.raises(AssertionError, match="nothing was left"):
        main(["run", "frames", "-o", "out", "--no-figures"])


@pytest.mark.parametrize(
    "options",
    nightly_except(
        ["--focal", "50"], ["--fixed-pixels", "keep"], ["--figures", "2"],
        of=[["--focal", "50"], ["--preset", "fast"], ["--beta", "0.5"], ["--center", "3", "4"],
            ["--distortion", "0.1,0,0,0"], ["--focal", "guess"], ["--figures", "2"], ["--ply"],
            ["--fixed-pixels", "keep"]],
    ),
    ids=" ".join,
)  # fmt: skip
def test_resume_refuses_other_options(tisfm_run, frames, options):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    before = files("out")
    arguments = ["run", "frames", "-o", "out", "--resume"]
    code, _, err = tisfm_run(*arguments, *options, *["--no-figures"] * ("--figures" not in options))
    *before_it, last = err.splitlines(keepends=True)
    assert len(before_it) == ("guess" in options)
    assert_one_line(code, last, "out holds a run with other options", "--resume")
    assert files("out") == before


def test_resume_refuses_another_kind_of_processor(tisfm_run, frames, monkeypatch):
    arguments = ("run", "frames", "-o", "out", "--no-figures")
    assert tisfm_run(*arguments)[0] == 0
    lanes = runtime.lanes()
    monkeypatch.setattr(runtime, "lanes", lambda: 24 - lanes)
    code, _, err = tisfm_run(*arguments, "--resume")
    assert_one_line(code, err, f"lanes was {lanes}, now {24 - lanes}")


def test_a_record_of_another_format_is_refused_everywhere(tisfm_run, frames):
    """Only a run without --resume accepts it, and removes the files that it names."""
    assert tisfm_run(*PLAIN, "--flo")[0] == 0
    path = Path("out", "run.json")
    about = json.loads(path.read_text())
    assert about.pop("format") == 4
    del about["source"]
    path.write_text(json.dumps(about))
    for call in (
        (*PLAIN, "--flo", "--resume"),
        ("report", "out"),
        ("export", "out", "--to", "depth-tiff", "-o", "o"),
    ):
        code, _, err = tisfm_run(*call)
        assert_one_line(code, err, "run.json is of format 1", "reads format 4: run anew")
    with pytest.raises(FormatError, match=r"format 1, .*run anew"):
        open_result(Path("out"))
    assert tisfm_run(*PLAIN)[0] == 0
    assert not list(Path("out").glob("*.flo"))


def test_resume_refuses_other_frames(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    before = files("out")
    again = ("run", "frames", "-o", "out", "--no-figures", "--resume")
    code, _, err = tisfm_run(*again, "--step", "2")
    assert_one_line(code, err, "step was 1, now 2")
    code, _, err = tisfm_run(*again, "--start", "1")
    assert_one_line(code, err, "start was 0, now 1")
    write_png(frames / "f1.png", 255 - FRAMES[1])
    code, _, err = tisfm_run(*again)
    assert_one_line(code, err, "f0 had other frames")
    assert files("out") == before


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "{}", '{"camera": 1}', "null"])
def test_resume_refuses_a_damaged_record(tisfm_run, frames, text):
    Path("out").mkdir()
    Path("out/run.json").write_text(text)
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--resume")
    assert_one_line(code, err, "run.json", "is damaged", "without --resume")


@pytest.mark.parametrize(
    "when",
    nightly_except(
        "interpret", "first", "write_npz",
        of=["interpret", "write_depth_png", "save_figure", "first", "write_npz"],
    ),
)  # fmt: skip
def test_an_interrupted_run_is_resumed_to_the_same_bytes(tisfm_run, frames, monkeypatch, when):
    """Ctrl-C comes at the second pair ("first": at the first one), here or there."""
    options = [] if when == "save_figure" else ["--no-figures"]
    (frames / "f3.png").unlink()
    assert tisfm_run("run", "frames", "-o", "whole", *options)[0] == 0
    module, name = {
        "interpret": (pair, "interpret"),
        "first": (pair, "interpret"),
        "write_depth_png": (tisfm.running.pair_files, "write_depth_png"),
        "save_figure": (tisfm.running.pair_files, "save_figure"),
        "write_npz": (np.lib.format, "write_array_header_1_0"),
    }[when]
    original, calls = getattr(module, name), []

    def interrupted(*arguments, **options):
        calls.append(1)
        # A file of twelve arrays is half written when the twentieth begins.
        if len(calls) == {"first": 1, "write_npz": 20}.get(when, 2):
            raise KeyboardInterrupt
        return original(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(module, name, interrupted)
        code, out, err = tisfm_run("run", "frames", "-o", "out", *options)
    assert (code, out, err) == (130, "", "tisfm: interrupted\n")
    left, whole = files("out"), files("whole")
    assert set(left) <= set(whole)
    assert ("f0.npz" in left) == (when != "first") and "f1.npz" not in left
    for name in set(left) - {"run.json", "run.csv"}:
        assert left[name] == whole[name], name
    assert tisfm_run("run", "frames", "-o", "out", "--resume", *options)[0] == 0
    assert files("out") == whole


@pytest.mark.nightly
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_ctrl_c_ends_a_process(work_folder):
    """The signal comes at any moment, in the middle of a kernel as well."""
    noise = np.random.default_rng(0).integers(0, 256, (120, 200), dtype=np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 1.5)
    os.mkdir("many")
    for k in range(60):
        write_png(f"many/f{k}.png", texture[:, 60 - k : 190 - k])
    command = [*TISFM, "run", "many", "-o", "out", "--preset", "paper", "--no-figures"]
    pipe = subprocess.PIPE
    with started(command, stdout=pipe, stderr=pipe, text=True) as process:
        wait_for(Path("out/f0.npz").exists, process)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out) == (130, "") and "Traceback" not in err
    assert err.splitlines()[-1] == "tisfm: interrupted"  # before it, a slow machine may foretell
    left = set(files("out"))
    finished = record("out")["pairs"]
    assert 1 <= len(finished) < 59
    assert not [name for name in left if name.endswith(".tmp") or name.startswith(".")]
    for name in finished:
        assert load("out", name).rho.any()


def test_overwritten_files_of_an_interrupted_run_are_not_complete(tisfm_run, frames, monkeypatch):
    """Other settings over a finished run, stopped inside the first pair; then the first again."""
    options = ("run", "frames", "-o", "out", "--no-figures")
    assert tisfm_run(*options, "--preset", "fast")[0] == 0
    before = files("out")

    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(interpretation_file, "write_npz", interrupted)
        assert tisfm_run(*options, "--preset", "paper")[0] == 130
    assert files("out")["f0_depth16.png"] != before["f0_depth16.png"]
    assert tisfm_run(*options, "--preset", "fast", "--resume")[0] == 0
    assert files("out") == before
