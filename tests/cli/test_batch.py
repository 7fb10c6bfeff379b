"""`tisfm batch`: many videos, none of which stops the others."""

import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.cli.command_line import assert_one_line, files
from tisfm.cli import batch as module
from tisfm.cli.batch import TRIES, read_jobs


@pytest.fixture
def jobs(place):
    def write(text, name="jobs.csv", encoding="utf-8"):
        Path(name).write_text(text, encoding=encoding)
        return name

    return write


def test_a_bad_video_stops_no_other(tisfm_run, frames, jobs):
    text = "source,output,preset,figures,ply\nframes,a b,fast,0,yes\ngone,bad,,,\nframes,c,,0,no\n"
    code, out, err = tisfm_run("batch", jobs(text), "--workers", "2")
    assert (code, out) == (1, "")
    first, second, third, last = err.splitlines()
    assert first.startswith("a b: 3 pairs: ") and third.startswith("c: 3 pairs: ")
    assert second.startswith("bad: ") and "gone" in second
    assert last == "2 of 3 done, 1 failed"
    assert not Path("bad").exists()
    assert tisfm_run("run", "frames", "-o", "alone", "--preset", "fast", "--figures", "0", "--ply")
    assert files("a b") == files("alone")
    assert "f0.ply" not in files("c")
    code, _, err = tisfm_run("batch", "jobs.csv", "--resume")
    assert code == 1 and "median" not in err.splitlines()[0]  # nothing was left to interpret


def test_sequences_are_reconstructed(tisfm_run, frames, jobs):
    text = "\ufeffsource , output,depth-of,focal\nframes,out,none,50\n"
    code, _, err = tisfm_run("batch", jobs(text), "--command", "reconstruct")
    assert code == 0 and err.endswith("1 of 1 done\n")
    assert Path("out/reconstruction.json").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["no columns source and output"]),
        ("source\nframes\n", ["no columns source and output"]),
        ("source,output\n", ["lists nothing"]),
        ("source,output\nframes,\n", ["line 2 has no output"]),
        ("source,output\nframes,a,b\n", ["line 2 has more cells"]),
        ("source,output\nframes,a\nframes,./a\n", ["lines 2 and 3 have the same output"]),
        ("source,output,colour\nframes,a,red\n", ["line 2", "colour"]),
        ("source,output,preset\nframes,a,slow\n", ["line 2", "slow"]),
        ('source,output\n"frames,a\n', ["is no CSV"]),
    ],
)
def test_what_is_no_list(tisfm_run, frames, jobs, text, words):
    code, _, err = tisfm_run("batch", jobs(text))
    assert_one_line(code, err, *words)
    assert sorted(path.name for path in Path().iterdir()) == ["frames", "jobs.csv"]


def test_other_mistakes(tisfm_run, frames, jobs):
    name = jobs("source,output\nframes,a\n")
    for option in ("--workers", "--threads"):
        assert_one_line(*tisfm_run("batch", name, option, "0")[::2], "expected a positive number")
    assert_one_line(*tisfm_run("batch", "gone.csv")[::2], "gone.csv")
    Path("latin.csv").write_bytes(b"source,output\nfr\xe9,a\n")
    assert_one_line(*tisfm_run("batch", "latin.csv")[::2], "is no CSV")


def test_a_job_whose_process_is_killed_is_begun_again(tisfm_run, frames, jobs, monkeypatch):
    calls = []

    def run(command, **options):
        calls.append(command)
        code = -signal.SIGKILL if len(calls) < TRIES else 0
        return SimpleNamespace(returncode=code, stderr=b"3 pairs: as it should be\n")

    monkeypatch.setattr(module.subprocess, "run", run)
    code, _, err = tisfm_run("batch", jobs("source,output\nframes,a\n"))
    assert (code, err) == (0, "a: 3 pairs: as it should be\n1 of 1 done\n")
    assert [("--resume" in call) for call in calls] == [False, True, True]
    calls.extend([[]] * 3)
    monkeypatch.setattr(
        module.subprocess, "run", lambda *a, **o: SimpleNamespace(returncode=-9, stderr=b"")
    )
    code, _, err = tisfm_run("batch", "jobs.csv")
    assert (code, err) == (1, "a: exit code -9\n0 of 1 done, 1 failed\n")


def test_cells_are_words_of_the_command_line(jobs):
    (job,) = read_jobs(Path(jobs("source,output,center,resume\nmy video.mp4,out,3 4,no\n")))
    assert (job.source, job.output) == ("my video.mp4", "out")
    assert job.options == ("--center", "3", "4", "--no-resume")


def test_the_package_is_a_command():
    done = subprocess.run(
        [sys.executable, "-m", "tisfm.cli", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip()
