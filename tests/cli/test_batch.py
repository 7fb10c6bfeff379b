"""`tisfm batch`: many videos, none of which stops the others."""

import os
import signal
import subprocess
from pathlib import Path
from unittest import mock

import pytest

from tests.cli.command_line import TISFM, assert_one_line, files
from tests.waiting import PATIENCE, started, wait_for
from tisfm.cli.batch import read_jobs
from tisfm.folders.result_folder import is_locked
from tisfm.running.commands import MAX_ATTEMPTS


@pytest.fixture
def jobs(work_folder):
    def write(text, name="jobs.csv", encoding="utf-8"):
        Path(name).write_text(text, encoding=encoding)
        return name

    return write


def test_a_bad_video_stops_no_other(tisfm_run, frames, jobs):
    text = "source,output,preset,figures,ply\ngone,bad,,,no\nframes,a b,fast,0,yes\n"
    code, out, err = tisfm_run("batch", jobs(text), "--workers", "2")
    assert (code, out) == (1, "")
    first, second, last = err.splitlines()
    assert first.startswith("bad: ") and "gone" in first
    assert second.startswith("a b: 3 pairs: ")
    assert last == "1 of 2 done, 1 failed. Grade poor"
    assert not Path("bad").exists()
    alone = ("run", "frames", "-o", "alone", "--preset", "fast", "--figures", "0", "--ply")
    assert tisfm_run(*alone)[0] == 0
    assert files("a b") == files("alone")


@pytest.mark.nightly
def test_a_list_with_a_bad_video_is_resumed(tisfm_run, frames, jobs):
    name = jobs("source,output,preset\nframes,a,fast\ngone,bad,\n")
    assert tisfm_run("batch", name)[0] == 1
    code, _, err = tisfm_run("batch", name, "--resume")
    assert code == 1 and "median" not in err.splitlines()[0]  # nothing was left to interpret


def test_sequences_are_reconstructed_with_the_options_of_the_list(tisfm_run, frames, jobs):
    Path("rich.py").write_text("raise RuntimeError('a module of the working folder is taken')")
    text = "\ufeffsource , output,depth-of,focal\nframes,out,none,50\n"
    alone = ("reconstruct", "frames", "-o", "out", "--depth-of", "none", "--focal", "50")
    assert tisfm_run(*alone)[0] == 0  # loads the kernels in this process
    code, _, err = tisfm_run("batch", jobs(text), "--command", "reconstruct", "--resume")
    assert "1 of 1 done. Grade no " in err  # no depth or no pose, as the result says
    assert code == 0 and err.startswith("out: out is already complete.")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["no columns source and output"]),
        ("source\nframes\n", ["no columns source and output"]),
        ("source,output\n", ["has no jobs"]),
        ("source,output\nframes,\n", ["line 2 has no output"]),
        ("source,output\nframes,a,b\n", ["line 2 has more cells"]),
        ("source,output\nframes,a\nframes,./a\n", ["lines 2 and 3 have the same output"]),
        ("source,output,colour\nframes,a,red\n", ["line 2", "colour"]),
        ("source,output,preset\nframes,a,slow\n", ["line 2", "slow"]),
        ('source,output\n"frames,a\n', ["is not a CSV file"]),
        ("source,output,focal,focal\nframes,a,1,2\n", ["names the column focal twice"]),
        ("source,output,mask\nframes,a,it's\n", ["line 2: No closing quotation"]),
    ],
)
def test_wrong_lists_are_one_line(tisfm_run, frames, jobs, text, words):
    code, _, err = tisfm_run("batch", jobs(text))
    assert_one_line(code, err, *words)
    assert sorted(path.name for path in Path().iterdir()) == ["frames", "jobs.csv"]


def test_other_errors_are_one_line(tisfm_run, frames, jobs):
    name = jobs("source,output\nframes,a\n")
    for option in ("--workers", "--threads"):
        assert_one_line(*tisfm_run("batch", name, option, "0")[::2], "expected a positive number")
    assert_one_line(*tisfm_run("batch", "gone.csv")[::2], "gone.csv")
    Path("latin.csv").write_bytes(b"source,output\nfr\xe9,a\n")
    assert_one_line(*tisfm_run("batch", "latin.csv")[::2], "is not a CSV file")


@pytest.mark.parametrize("codes", [[-9, -9, 0], [-9] * 3, [-2], [-15], [1]])
@pytest.mark.parametrize("writes", [True, False])
def test_a_job_whose_process_is_killed_is_started_again(
    tisfm_run, frames, jobs, monkeypatch, codes, writes
):
    calls = []

    def popen(command, **options):
        calls.append(command)
        if writes:
            Path("a").mkdir(exist_ok=True)
            Path("a/run.json").write_text(str(len(calls)))
        process = mock.Mock(returncode=codes[len(calls) - 1])
        process.communicate.return_value = b"", b"1 pair: one. Results in a.\nsome advice\n"
        return process

    monkeypatch.setattr(subprocess, "Popen", popen)
    code, _, err = tisfm_run("batch", jobs("source,output\nframes,a\n"))
    assert code == (codes[-1] != 0) and len(calls) == len(codes) <= MAX_ATTEMPTS
    assert err.startswith("a: 1 pair: one. Results in a.\n")
    assert [("--resume" in call) for call in calls] == [False, writes, writes][: len(calls)]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
@pytest.mark.parametrize(
    ("sent", "begun"),
    [
        (signal.SIGTERM, "a"),
        pytest.param(signal.SIGINT, "a/run.json", marks=pytest.mark.nightly),
        pytest.param(signal.SIGTERM, "a/run.json", marks=pytest.mark.nightly),
    ],
)
def test_a_signal_ends_the_jobs_as_well(frames, jobs, sent, begun):
    """The signal goes to the command alone, when a file of its job exists."""
    for k in range(4, 200):
        (frames / f"g{k}.png").write_bytes((frames / "f0.png").read_bytes())
    name = jobs("source,output,preset\nframes,a,accurate\nframes,b,accurate\n")
    command, pipe = [*TISFM, "batch", name], subprocess.PIPE
    with started(command, stdout=pipe, stderr=pipe, text=True) as process:
        wait_for(Path(begun).exists, process)
        process.send_signal(sent)
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130 and err.endswith("tisfm: interrupted\n")
    assert not is_locked("a")  # the job has ended
    assert len(list(Path("a").glob("*.npz"))) < 199 and not Path("b").exists()


def test_cells_are_words_of_the_command_line(jobs):
    text = "source,output,center,resume,poses\nmy video's.mp4,out,3 4,no,'my poses.txt'\n"
    (job,) = read_jobs(Path(jobs(text)))
    assert (job.source, job.output) == ("my video's.mp4", "out")
    assert job.options == ("--center", "3", "4", "--no-resume", "--poses", "my poses.txt")
