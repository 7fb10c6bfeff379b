"""``tisfm view``: the page on this computer, a page that plays by itself, and what is refused."""

import os
import re
import signal
import subprocess
import sys
import urllib.request
from contextlib import ExitStack

import pytest

from tests.cli.command_line import TISFM, assert_one_line
from tests.view.results import write_reconstruction, write_record_of, write_run
from tests.waiting import PATIENCE, started
from tisfm.cli.command_line import main
from tisfm.folders.result_folder import locked_folder

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")


def test_an_exported_page_has_all_frames(work_folder, capsys):
    write_reconstruction(work_folder / "r")
    assert main(["view", "r", "--html", "view.html", "--html-frames", "3"]) == 0
    text = (work_folder / "view.html").read_text(encoding="utf-8")
    assert text.rstrip().endswith("</html>") and "__VISER_EMBED_DATA__" in text
    out, err = capsys.readouterr()
    assert out == "" and "3 of 5 frames in view.html" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], ["there is no folder nowhere"]),
        (["empty"], ["empty is not a result of tisfm"]),
        (["r", "--frame", "5"], ["--frame is 5", "0 to 4"]),
        (["r", "--frame=-1"], ["--frame is -1"]),
        (["r", "--points", "0"], ["--points is 0"]),
        (["r", "--port", "99999"], ["port is 99999"]),
        (["r", "--host", "192.0.2.1"], ["cannot listen at 192.0.2.1"]),
        (["r", "--html", "no/view.html"], ["there is no folder no"]),
        (["r", "--html", "view.html", "--html-frames", "0"], ["--html-frames is 0"]),
        (["nowhere", "--html", "view.html"], ["there is no folder nowhere"]),
    ],
)
def test_wrong_options_of_view_are_one_line(work_folder, capsys, arguments, words):
    write_reconstruction(work_folder / "r")
    (work_folder / "empty").mkdir()
    code = main(["view", *arguments, "--no-browser"])
    assert_one_line(code, capsys.readouterr().err, *words)
    assert not (work_folder / "view.html").exists()


def test_a_missing_viser_is_one_line(work_folder, capsys, monkeypatch):
    write_reconstruction(work_folder / "r")
    monkeypatch.setitem(sys.modules, "viser", None)
    code = main(["view", "r", "--no-browser"])
    assert_one_line(code, capsys.readouterr().err, "pip install 'tisfm[view]'")


def begun(*arguments):
    """Start the command in a process of its own."""
    return started(
        [*TISFM, "view", *arguments, "--no-browser", "--port", "0"],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )


@pytest.mark.skipif(os.name == "nt", reason="Windows interrupts processes otherwise")
def test_a_growing_run_is_served_until_ctrl_c(work_folder):
    (work_folder / "r").mkdir()
    with locked_folder(work_folder / "r"), begun("r") as process:
        line = process.stderr.readline()
        assert "waits for it" in line
        url = re.search(r"http://127\.0\.0\.1:\d+", line)[0]
        assert_answers(url)
        shot = write_run(work_folder / "r", 2)
        write_record_of(work_folder / "r", shot, [0], "camera")
        assert f"r is shown at {url}" in process.stderr.readline()
        assert_answers(url)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0 and out == "" and err == ""


@pytest.mark.nightly
@pytest.mark.skipif(os.name == "nt", reason="Windows interrupts processes otherwise")
def test_waiting_for_a_run_ends_with_the_run(work_folder):
    (work_folder / "r").mkdir()
    (work_folder / "r" / "reconstruction.begun").touch()
    with ExitStack() as stack:
        with locked_folder(work_folder / "r"):
            process = stack.enter_context(begun("r"))
            assert "no complete reconstruction yet: http" in process.stderr.readline()
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1 and out == "" and "no command writes to it" in err


def assert_answers(url):
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with direct.open(url, timeout=PATIENCE) as answer:
        assert b"<html" in answer.read()


def test_a_page_names_the_frames_that_it_leaves_out(work_folder, capsys):
    write_reconstruction(work_folder / "r")
    (work_folder / "r" / "frames" / "000002.jpg").unlink()
    assert main(["view", "r", "--html", "view.html"]) == 0
    out, err = capsys.readouterr()
    assert out == "" and "4 of 5 frames in view.html" in err
    assert "left out, because it cannot be read: f2:" in err
